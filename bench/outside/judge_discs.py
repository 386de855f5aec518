"""Evaluate presets and plain OpenCV on drawn discs: `python -m outside.judge_discs [--seeds N] [--only NAME
...]`.

Columns: markers found (a detection within 1.5 px), those found within 0.5 px, and false detections per
image; centre rms, px per axis; then, for the pipeline over a sequence, failed frames, SEEN markers, and
markers that are SEEN with another identity.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

import gelstereo
from gelstereo.states import MarkerState

from .discs import CONDITIONS, SIDE, Array, Condition, Find, Image, Print, opencv_centres

PRESETS = ("paper", "fast", "balanced", "exact")
NEAR_PX = 1.5
#: A thirtieth of the pitch. Whole markers are found within 0.1 px, so that one farther off is cut.
WHOLE_PX = 0.5
#: Lateral shift along x and y, and depth of a press in the middle, mm.
MOTION = ((0.0, 0.0, 0.0), (0.03, 0.01, 0.1), (0.08, -0.03, 0.3), (0.15, 0.02, 0.6), (0.2, 0.1, 0.8))


@dataclass
class Score:
    """Results of one method under one condition."""

    markers: int = 0
    found: int = 0
    whole: int = 0
    false: int = 0
    images: int = 0
    errors_px: list[Array] = field(default_factory=list)
    frames: int = 0
    failed: list[str] = field(default_factory=list)
    named: int = 0
    seen: int = 0
    wrong: int = 0

    def add_image(self, found_px: Array, true_px: Array) -> None:
        """Compare detections with true centres."""
        self.images += 1
        self.markers += len(true_px)
        if len(found_px) == 0:
            return
        far, which = cKDTree(true_px).query(found_px)
        near = far < NEAR_PX
        self.found += len(np.unique(which[near]))
        self.whole += len(np.unique(which[far < WHOLE_PX]))
        self.false += len(found_px) - len(np.unique(which[near]))
        self.errors_px.append(found_px[near] - true_px[which[near]])

    def add_frame(self, frame: gelstereo.Frame, true_px: tuple[Array, Array], names: Array) -> None:
        """Compare labels with the truth, whose markers have these names; labels of a rotated print may start
        at another corner.
        """
        seen = np.asarray(frame.state).ravel() == MarkerState.SEEN
        self.named += len(seen)
        self.seen += int(seen.sum())
        wrong = np.zeros(len(seen), dtype=bool)
        for px, true in ((frame.left_px, true_px[0]), (frame.right_px, true_px[1])):
            nearest = cKDTree(true).query(np.nan_to_num(np.asarray(px).reshape(-1, 2)))[1]
            wrong |= seen & (nearest != names)
        self.wrong += int(wrong.sum())

    @property
    def found_share(self) -> float:
        """Share of all markers that were found."""
        return self.found / max(1, self.markers)

    @property
    def rms_px(self) -> float:
        """Rms error of the centres per axis."""
        return float(np.sqrt(np.mean(np.concatenate(self.errors_px) ** 2))) if self.errors_px else np.nan

    def row(self, name: str, method: str) -> str:
        """One row of the table."""
        cells = [
            name,
            method,
            f"{100 * self.found_share:.2f}",
            f"{100 * self.whole / max(1, self.markers):.2f}",
            f"{self.false / max(1, self.images):.1f}",
            f"{self.rms_px:.3f}",
        ]
        cells += (
            ["", "", ""]
            if method == "OpenCV"
            else [
                f"{len(self.failed)} of {self.frames}",
                f"{100 * self.seen / max(1, self.named):.1f}",
                f"{self.wrong}",
            ]
        )
        return "| " + " | ".join(cells) + " |"


HEAD = (
    "| condition | method | found, % | within 0.5 px, % | false | centre rms, px | failed frames | SEEN, % "
    "| wrong |\n" + 9 * "|---" + "|"
)


def corner_names(found_px: Array, true_px: Array) -> Array:
    """True marker of each label; the start corner is the one with the smallest error on a square lattice."""
    square = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    turned = [np.rot90(square, quarter).ravel() for quarter in range(4)]
    far = [np.linalg.norm(true_px[names] - found_px, axis=1) for names in turned]
    return turned[int(np.argmin([np.median(distance) for distance in far]))]


def detecting(preset: str, scene: Print) -> Find:
    """A preset's detector of single images."""
    detector = gelstereo.Detector(scene.params(preset))

    def find(image: Image) -> Array:
        try:
            return np.asarray(detector.detect(image).centres_px).reshape(-1, 2)
        except gelstereo.Error:
            return np.empty((0, 2))

    return find


def judged(condition: Condition, seeds: int, presets: tuple[str, ...] = PRESETS) -> dict[str, Score]:
    """Scores of OpenCV and the presets, by name."""
    scores = {name: Score() for name in ("OpenCV", *presets)}
    for seed in range(1, seeds + 1):
        scene = Print(condition, seed)
        finders: dict[str, Find] = {"OpenCV": opencv_centres, **{p: detecting(p, scene) for p in presets}}
        pipelines = {p: gelstereo.Pipeline(scene.rig, scene.params(p)) for p in presets}
        names: dict[str, Array] = {}
        for number, (x, y, press) in enumerate(MOTION):
            points = scene.markers_mm((x, y), press)
            pair, true = scene.pair(points, number), scene.rig.project(points)
            for name, find in finders.items():
                for image, centres in zip(pair, true, strict=True):
                    scores[name].add_image(find(image), centres)
            for preset, pipeline in pipelines.items():
                score = scores[preset]
                score.frames += 1
                try:
                    frame = pipeline.process(*pair)
                except gelstereo.Error as error:
                    score.failed.append(str(error))
                    continue
                if preset not in names:
                    left_px = np.nan_to_num(np.asarray(frame.left_px).reshape(-1, 2))
                    names[preset] = corner_names(left_px, true[0])
                score.add_frame(frame, true, names[preset])
    return scores


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", nargs="*", choices=list(CONDITIONS))
    parser.add_argument("--preset", nargs="*", choices=PRESETS, default=list(PRESETS))
    options = parser.parse_args(arguments)
    print(HEAD)
    for name in options.only or CONDITIONS:
        for method, score in judged(CONDITIONS[name], options.seeds, tuple(options.preset)).items():
            print(score.row(name, method), flush=True)
            for reason in sorted(set(score.failed)):
                print(f"    {reason}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
