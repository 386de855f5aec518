"""Judge presets on the rendered pairs: `python -m outside.judge [--half w|j] [--preset NAME ...] [--jpeg QUALITY]`.

Figures of every preset:
- missed: markers not SEEN, of all; wrong: SEEN markers that lie nearer to another true centre than to their own;
- centre rms: of SEEN markers that no glint covers, px an axis;
- NSE: their squared depth error over the stated variance, mean (1 is right, less is too cautious); NSE of lateral
  position likewise;
- depth bias and rms, um; F1 of contact, mean over frames in which at least four markers touch.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field

import gelstereo
import numpy as np
import numpy.typing as npt
from gelstereo.states import MarkerState

from .images import Condition, Sequence, names

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

GLINT_LEVEL, GLINT_REACH_PX = 245, 8
PRESETS = ("fast", "balanced", "exact")


@dataclass
class Figures:
    """What one preset did on some sequences."""

    markers: int = 0
    seen: int = 0
    wrong: int = 0
    glint_seen: int = 0
    frames: int = 0
    failed: list[str] = field(default_factory=list)
    centre_errors_px: list[Array] = field(default_factory=list)
    errors_mm: list[Array] = field(default_factory=list)
    squared: list[Array] = field(default_factory=list)
    glint_squared: list[Array] = field(default_factory=list)
    f1: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """One row of the table."""
        if not self.errors_mm:
            return f"| {name} | {len(self.failed)} of {self.frames} | all | | | | | | |"
        centres, errors = np.concatenate(self.centre_errors_px), np.concatenate(self.errors_mm)
        squared = np.concatenate(self.squared)
        glints = np.concatenate(self.glint_squared) if self.glint_squared else np.empty(0)
        cells = (
            name,
            f"{len(self.failed)} of {self.frames}",
            f"{100 * (1 - self.seen / self.markers):.1f}",
            f"{self.wrong}",
            f"{np.sqrt((centres**2).mean()):.3f}",
            f"{squared.mean():.3f} ({np.median(squared):.3f})",
            f"{glints.mean():.2f}" if len(glints) else "",
            f"{1000 * errors.mean():+.1f} / {1000 * np.sqrt((errors**2).mean()):.1f}",
            f"{np.mean(self.f1):.2f}" if self.f1 else "",
        )
        return "| " + " | ".join(cells) + " |"


HEAD = (
    "| preset | failed frames | missed, % | wrong | centre rms, px | NSE, mean (median) | NSE under glints "
    "| depth bias / rms, um | F1 |\n|---|---|---|---|---|---|---|---|---|"
)


def f1(found: Flags, true: Flags) -> float:
    """Harmonic mean of precision and recall."""
    return float(2 * (found & true).sum() / max(1, found.sum() + true.sum()))


def under_glints(sequence: Sequence, index: int) -> Flags:
    """Markers that a light's reflection covers or touches in either view."""
    covered = np.zeros(sequence.truth["left_px"].shape[1], dtype=bool)
    for view in ("left", "right"):
        image = sequence.clean(index, view)
        y, x = np.nonzero(image >= GLINT_LEVEL)
        places = np.stack((x, y), axis=1).astype(float)
        for k, centre in enumerate(sequence.truth[f"{view}_px"][index]):
            covered[k] |= (
                bool((np.abs(places - centre).max(axis=1, initial=0) < GLINT_REACH_PX).any())
                if len(x)
                else False
            )
    return covered


def misnamed(found_px: Array, true_px: Array, seen: Flags) -> int:
    """SEEN markers that are nearest to another marker's true centre."""
    far = np.linalg.norm(found_px[seen][:, None] - true_px[None], axis=2)
    return int((far.argmin(axis=1) != np.flatnonzero(seen)).sum())


def add(figures: Figures, sequence: Sequence, index: int, frame: gelstereo.Frame) -> None:
    """Compare one frame with its truth."""
    true = {key: values[index] for key, values in sequence.truth.items()}
    seen = np.asarray(frame.state).ravel() == MarkerState.SEEN
    left, points = np.asarray(frame.left_px).reshape(-1, 2), np.asarray(frame.points_mm).reshape(-1, 3)
    right = np.asarray(frame.right_px).reshape(-1, 2)
    glint = under_glints(sequence, index)
    clear = seen & ~glint
    figures.markers += int((~glint).sum())
    figures.seen += int(clear.sum())
    figures.wrong += max(misnamed(left, true["left_px"], seen), misnamed(right, true["right_px"], seen))
    figures.centre_errors_px += [(left - true["left_px"])[clear], (right - true["right_px"])[clear]]
    error = points - true["points_mm"]
    figures.errors_mm.append(error[clear, 2])
    covariance = np.asarray(frame.covariance_mm2).reshape(-1, 3, 3)
    for flags, kept in ((clear, figures.squared), (seen & glint, figures.glint_squared)):
        if flags.any():
            solved = np.linalg.solve(covariance[flags], error[flags][..., None])[..., 0]
            kept.append((error[flags] * solved).sum(axis=1) / 3)
    figures.glint_seen += int((seen & glint).sum())
    touching = true["touching"].astype(bool)
    if touching.sum() >= 4:
        figures.f1.append(f1(np.asarray(frame.salient).ravel(), touching))


def judged(
    preset: str, sequences: list[Sequence], condition: Condition, changes: dict[str, object]
) -> Figures:
    """Run a preset on whole sequences, each from its own rest frame."""
    figures = Figures()
    for sequence in sequences:
        params = gelstereo.Params.preset(preset).replace(
            {"lattice.pitch_mm": sequence.about["pitch_mm"], **changes}
        )
        pipeline = gelstereo.Pipeline(gelstereo.Rig.from_toml(sequence.about["rig"]), params)
        for index in range(len(sequence)):
            figures.frames += 1
            try:
                frame = pipeline.process(*sequence.pair(index, condition))
            except gelstereo.Error as error:
                figures.failed.append(f"{sequence.name} {index}: {error}")
                continue
            add(figures, sequence, index, frame)
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
    options = parser.parse_args()
    changes = {"contact.saliency": options.saliency} if options.saliency else {}
    for half in [options.half] if options.half else ["w", "j"]:
        stored = [Sequence.load(name) for name in names(half)]
        for group in [[s] for s in stored] if options.each else [stored]:
            heading = group[0].name if options.each else {"w": "for work", "j": "judged"}[half]
            sys.stdout.write(f"\n{heading}: {sum(map(len, group))} pairs\n\n{HEAD}\n")
            for preset in options.preset:
                figures = judged(preset, group, Condition(jpeg_quality=options.jpeg), changes)
                sys.stdout.write(figures.row(preset) + "\n")
                for failure in figures.failed:
                    sys.stderr.write(f"{preset}: {failure}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
