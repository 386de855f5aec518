"""Evaluate presets on the rendered pairs: `python -m outside.judge [--half w|j] [--preset NAME ...] [--jpeg
QUALITY]`.

Markers under glints count only in their own column. For the others:
- missed: not SEEN; wrong: SEEN, and nearest to another marker's true centre;
- centres: error of SEEN centres, px rms an axis, and its square over the variance that the frame states: NSE,
  1 is right, less is too cautious; then the NSE of a detector on each image alone, which cannot see folds;
  strays: detections beyond 2 px of every centre, for each image;
- points: NSE of triangulated points (3 directions); depth bias and rms;
- F1 of contact, mean over frames in which four markers or more touch.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

import gelstereo
from gelstereo.states import MarkerState

from .images import Condition, Sequence, names

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

GLINT_LEVEL, GLINT_REACH_PX = 245, 12
PRESETS = ("fast", "balanced", "exact")


@dataclass
class Figures:
    """Results of one preset on some sequences."""

    markers: int = 0
    seen: int = 0
    wrong: int = 0
    frames: int = 0
    failed: list[str] = field(default_factory=list)
    strays: int = 0
    centre_errors_px: list[Array] = field(default_factory=list)
    centre_squared: list[Array] = field(default_factory=list)
    alone_squared: list[Array] = field(default_factory=list)
    errors_mm: list[Array] = field(default_factory=list)
    squared: list[Array] = field(default_factory=list)
    glint_squared: list[Array] = field(default_factory=list)
    f1: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """One row of the table."""
        if not self.errors_mm:
            return f"| {name} | {len(self.failed)} of {self.frames} | all |" + 9 * " |"
        centres, errors = np.concatenate(self.centre_errors_px), np.concatenate(self.errors_mm)
        cells = (
            name,
            f"{len(self.failed)} of {self.frames}",
            f"{100 * (1 - self.seen / self.markers):.1f}",
            f"{self.wrong}",
            f"{np.sqrt((centres**2).mean()):.3f}",
            mean_and_median(self.centre_squared),
            mean_and_median(self.alone_squared),
            f"{self.strays / (2 * self.frames):.1f}",
            mean_and_median(self.squared),
            mean_and_median(self.glint_squared),
            f"{1000 * errors.mean():+.1f} / {1000 * np.sqrt((errors**2).mean()):.1f}",
            f"{np.mean(self.f1):.2f}" if self.f1 else "",
        )
        return "| " + " | ".join(cells) + " |"


def mean_and_median(parts: list[Array]) -> str:
    """Mean and median of all values, as text; empty without values."""
    values = np.concatenate(parts) if parts else np.empty(0)
    return f"{values.mean():.3f} ({np.median(values):.3f})" if len(values) else ""


HEAD = (
    "| preset | failed frames | missed, % | wrong | centre rms, px | centre NSE, mean (median) "
    "| of one image alone | strays "
    "| point NSE, mean (median) | the same under glints | depth bias / rms, um | F1 |\n" + 12 * "|---" + "|"
)


def normalised(error: Array, covariance: Array) -> Array:
    """Squared errors over their covariance, per axis."""
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray((error * solved).sum(axis=1) / error.shape[1])


def f1(found: Flags, true: Flags) -> float:
    """Harmonic mean of precision and recall."""
    return float(2 * (found & true).sum() / max(1, found.sum() + true.sum()))


def under_glints(sequence: Sequence, index: int) -> Flags:
    """Mask of markers covered or touched by a reflection in either view."""
    covered = np.zeros(sequence.truth["left_px"].shape[1], dtype=bool)
    for view in ("left", "right"):
        glints = sequence.clean(index, view) >= GLINT_LEVEL
        summed = cv2.integral(glints.astype(np.uint8))
        # Pixels nearer than the reach along both axes.
        centres, size = sequence.truth[f"{view}_px"][index], np.array(glints.shape[::-1])
        (left, top) = np.clip(np.floor(centres - GLINT_REACH_PX).astype(int) + 1, 0, size).T
        (right, bottom) = np.clip(np.ceil(centres + GLINT_REACH_PX).astype(int), 0, size).T
        number = summed[bottom, right] - summed[top, right] - summed[bottom, left] + summed[top, left]
        covered |= number > 0
    return covered


def misnamed(found_px: Array, true_px: Array, seen: Flags) -> int:
    """SEEN markers that are nearest to another marker's true centre."""
    far = np.linalg.norm(found_px[seen][:, None] - true_px[None], axis=2)
    return int((far.argmin(axis=1) != np.flatnonzero(seen)).sum())


def add(
    figures: Figures, sequence: Sequence, index: int, pipeline: gelstereo.Pipeline, frame: gelstereo.Frame
) -> None:
    """Compare the pipeline's last frame with its truth."""
    true = {key: values[index] for key, values in sequence.truth.items()}
    seen = np.asarray(frame.state).ravel() == MarkerState.SEEN
    left, points = np.asarray(frame.left_px).reshape(-1, 2), np.asarray(frame.points_mm).reshape(-1, 3)
    right = np.asarray(frame.right_px).reshape(-1, 2)
    glint = under_glints(sequence, index)
    clear = seen & ~glint
    figures.markers += int((~glint).sum())
    figures.seen += int(clear.sum())
    figures.wrong += max(misnamed(left, true["left_px"], seen), misnamed(right, true["right_px"], seen))
    stated = pipeline.centre_covariances_px2(frame)
    for view, centres, covariance in zip(("left", "right"), (left, right), stated, strict=True):
        off = (centres - true[f"{view}_px"])[clear]
        figures.centre_errors_px.append(off)
        figures.centre_squared.append(normalised(off, covariance[clear]))
    error = points - true["points_mm"]
    figures.errors_mm.append(error[clear, 2])
    covariance = np.asarray(frame.covariance_mm2).reshape(-1, 3, 3)
    for flags, kept in ((clear, figures.squared), (seen & glint, figures.glint_squared)):
        if flags.any():
            kept.append(normalised(error[flags], covariance[flags]))
    touching = true["touching"].astype(bool)
    if touching.sum() >= 4:
        figures.f1.append(f1(np.asarray(frame.salient).ravel(), touching))


def add_detections(
    figures: Figures, detector: gelstereo.Detector, image: npt.NDArray[np.uint8], true_px: Array, glint: Flags
) -> None:
    """Compare a detector's centres in one image with the markers' true centres."""
    found = detector.detect(image)
    far = np.linalg.norm(found.centres_px[:, None] - true_px[None], axis=2)
    nearest, close = far.argmin(axis=1), far.min(axis=1) < 2.0
    figures.strays += int((~close).sum())
    kept = close & ~glint[nearest]
    error = (found.centres_px - true_px[nearest])[kept]
    covariance = found.covariance_px2.reshape(-1, 2, 2)[kept]
    figures.alone_squared.append(normalised(error, covariance))


def judged(
    preset: str, sequences: list[Sequence], condition: Condition, changes: dict[str, object]
) -> Figures:
    """Run a preset on complete sequences, each from its own rest frame."""
    figures = Figures()
    for sequence in sequences:
        params = gelstereo.Params.preset(preset).replace(
            {"lattice.pitch_mm": sequence.about["pitch_mm"], **changes}
        )
        pipeline = gelstereo.Pipeline(gelstereo.Rig.from_toml(sequence.about["rig"]), params)
        detector = gelstereo.Detector(params)
        for index in range(len(sequence)):
            figures.frames += 1
            pair, glint = sequence.pair(index, condition), under_glints(sequence, index)
            for image, view in zip(pair, ("left_px", "right_px"), strict=True):
                add_detections(figures, detector, image, sequence.truth[view][index], glint)
            try:
                frame = pipeline.process(*pair)
            except gelstereo.Error as error:
                figures.failed.append(f"{sequence.name} {index}: {error}")
                continue
            add(figures, sequence, index, pipeline, frame)
    return figures


def main() -> int:
    """Print a table for each half."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--half", choices=("w", "j"), help="w: for work, j: judged; without, both, apart")
    parser.add_argument("--preset", nargs="*", default=PRESETS)
    parser.add_argument("--jpeg", type=int, help="quality of JPEG; none without")
    parser.add_argument("--saliency", choices=("pressure", "depth"), help="instead of the preset's")
    parser.add_argument("--each", action="store_true", help="a table for each sequence")
    parser.add_argument(
        "--bare", action="store_true", help="overwrite everything round the markers with plain print"
    )
    options = parser.parse_args()
    condition = Condition(jpeg_quality=options.jpeg, bare=options.bare)
    changes = {"contact.saliency": options.saliency} if options.saliency else {}
    for half in [options.half] if options.half else ["w", "j"]:
        stored = [Sequence.load(name) for name in names(half)]
        for group in [[s] for s in stored] if options.each else [stored]:
            heading = group[0].name if options.each else {"w": "for work", "j": "judged"}[half]
            sys.stdout.write(f"\n{heading}: {sum(map(len, group))} pairs\n\n{HEAD}\n")
            for preset in options.preset:
                figures = judged(preset, group, condition, changes)
                sys.stdout.write(figures.row(preset) + "\n")
                for failure in figures.failed:
                    sys.stderr.write(f"{preset}: {failure}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
