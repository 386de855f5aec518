"""The elastic layer compared with a real sensor: prediction of the gel beside a contact from the gel under
it.

Run ``python -m gelstereo_bench.reports.physics`` to fill docs/simulator-physics.md; it needs the recordings
of the wheel pytac3d (``pip install --no-deps pytac3d==3.3.0.9``).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import LayerContact
from gelstereo.recordings import CloudRecording, contacts, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.recordings import PARTS, SALIENCY_MM, touching

__all__ = ["Beside", "Gel", "Press", "beside", "best", "main", "membrane", "of_layer", "presses", "rows"]

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_THICKNESSES_MM = (2.0, 3.0, 4.0, 6.0, 9.0, 14.0)
_RATIOS = (0.3, 0.4, 0.45, 0.5)
_FITS = [
    "part",
    "frames",
    "moved um",
    "layer off um",
    "thickness mm",
    "Poisson",
    "height um",
    "layer off",
    "membrane off",
    "its l mm",
]
_SHOWN_MM = (4.0, 6.0, 9.0, 11.0, 14.0)
_FIGURES = [
    "part",
    "beside the contact",
    "recorded (least to most)",
    *(f"layer of {t:g} mm" for t in _SHOWN_MM),
]
_LENGTHS_MM = (0.2, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)


@dataclass(frozen=True)
class Gel:
    """Parameters of a gel layer."""

    thickness_mm: float
    poisson_ratio: float


@dataclass(frozen=True)
class Press:
    """One frame: motion of the markers, and a mask of those in contact."""

    motion_mm: Array
    touches: Bools
    #: Free markers used for comparison: all except the outermost, at which the gel ends.
    free: Bools


@dataclass(frozen=True)
class Beside:
    """Measured or simulated heights and lateral motion of the markers beside the contact in a frame."""

    rise_mm: float
    sideways_mm: float
    #: Motion along the direction in which the part dragged the gel, relative to the part's motion.
    carried: float


def presses(
    recording: CloudRecording, episode: range, every: int = 6, moved: CloudRecording | None = None
) -> list[Press]:
    """Frames of an episode, with axes along the lattice and heights positive into the gel.

    `moved` has other points of the gel, one for each marker, whose motion is given in place of the markers'.
    """
    heights = recording.indentation_mm()
    moved = recording if moved is None else moved
    lifts = moved.indentation_mm()
    shape = (recording.rows, recording.cols)
    rest = recording.rest_mm.reshape(*shape, 3)
    # Unit vectors from a column to the next and from a row to the next.
    axes = np.array([np.diff(rest, axis=axis).mean(axis=(0, 1))[:2] for axis in (1, 0)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    inner = np.zeros(shape, bool)
    inner[2:-2, 2:-2] = True
    found = []
    for frame in range(episode.start, episode.stop, every):
        motion = moved.points_mm[frame] - moved.rest_mm
        motion = np.column_stack((motion[:, :2] @ axes.T, lifts[frame])).reshape(*shape, 3)
        touches = np.zeros(shape, bool)
        for contact in contacts(heights[frame], *shape, SALIENCY_MM):
            touches.ravel()[contact.core] = True
        if touches.sum() >= 8:
            found.append(Press(motion, touches, inner & ~touches))
    return found


@cache
def _contact(gel: Gel, rows: int, cols: int, pitch_mm: float) -> LayerContact:
    return LayerContact(
        thickness_mm=gel.thickness_mm,
        poisson_ratio=gel.poisson_ratio,
        rows=rows,
        cols=cols,
        cell_mm=pitch_mm,
        friction=1e3,
    )


def of_layer(press: Press, gel: Gel, pitch_mm: float) -> Array:
    """Motion of all markers of a layer whose markers in contact move as recorded."""
    layer = _contact(gel, *press.touches.shape, pitch_mm)
    heights = np.where(press.touches, np.minimum(press.motion_mm[..., 2], gel.thickness_mm), -np.inf)
    return np.asarray(layer.press(heights, press.motion_mm[..., :2], tolerance_mm=1e-4).motion_mm)


def membrane(press: Press, length_mm: float, pitch_mm: float) -> Array:
    """Heights of the membrane of the effect ``shoulder``, prescribed at the markers in contact."""
    held = press.touches
    heights = np.where(held, press.motion_mm[..., 2], 0.0)
    weight = (length_mm / pitch_mm) ** 2
    for _ in range(int(40 * max(1.0, weight))):
        padded = np.pad(heights, 1, mode="edge")
        ring = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        heights = np.where(held, heights, weight * ring / (1.0 + 4.0 * weight))
    return np.asarray(heights)


def beside(motion_mm: Array, press: Press) -> Beside:
    """Heights and motion of the free markers in a frame."""
    free = motion_mm[press.free]
    carried = press.motion_mm[press.touches][:, :2].mean(axis=0)
    length = float(np.linalg.norm(carried))
    along = free[:, :2] @ carried / max(length, 1e-9) ** 2
    near = np.argsort(-free[:, 2])[: len(free) // 4]
    return Beside(
        rise_mm=float(-np.quantile(free[:, 2], 0.02)),
        sideways_mm=float(np.quantile(np.linalg.norm(free[:, :2], axis=1), 0.98)),
        carried=float(np.median(along[near])),
    )


def off(found: Array, press: Press, axes: slice) -> float:
    """Rms difference of the free markers, mm."""
    apart = (found - press.motion_mm)[press.free][:, axes]
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def rms(values: Iterable[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(list(values)))))


def best(frames: Sequence[Press], pitch_mm: float) -> tuple[Gel, float]:
    """Find the layer whose free markers are nearest to the recorded ones, and their rms difference, mm."""
    gels = [Gel(thickness, ratio) for thickness in _THICKNESSES_MM for ratio in _RATIOS]
    found = [rms(off(of_layer(p, gel, pitch_mm), p, slice(0, 3)) for p in frames) for gel in gels]
    return gels[int(np.argmin(found))], min(found)


def fit(frames: Sequence[Press], pitch_mm: float) -> list[str]:
    """Fit layer and membrane to the frames of a part; returns a table row without the name."""
    gel, all_mm = best(frames, pitch_mm)
    heights = slice(2, 3)

    def off_membrane(length: float) -> float:
        found = (p.motion_mm.copy() for p in frames)
        lifted = []
        for p, motion in zip(frames, found, strict=True):
            motion[..., 2] = membrane(p, length, pitch_mm)
            lifted.append(off(motion, p, heights))
        return rms(lifted)

    membranes = [off_membrane(length) for length in _LENGTHS_MM]
    moved = rms(off(np.zeros_like(p.motion_mm), p, slice(0, 3)) for p in frames)
    layered = rms(off(of_layer(p, gel, pitch_mm), p, heights) for p in frames)
    flat = rms(off(np.zeros_like(p.motion_mm), p, heights) for p in frames)
    lengths = [1e3 * length for length in (moved, all_mm, flat, layered, min(membranes))]
    moved_um, all_um, flat_um, layered_um, membrane_um = (f"{length:.0f}" for length in lengths)
    length = f"{_LENGTHS_MM[int(np.argmin(membranes))]:g}"
    row = [str(len(frames)), moved_um, all_um, f"{gel.thickness_mm:g}", f"{gel.poisson_ratio:g}"]
    return [*row, flat_um, layered_um, membrane_um, length]


def figures(frames: Sequence[Press], pitch_mm: float) -> dict[str, list[str]]:
    """Medians for the gel beside the contact and for incompressible layers; for recordings also the range."""
    groups = [[beside(p.motion_mm, p) for p in frames]]
    groups += [[beside(of_layer(p, Gel(t, 0.5), pitch_mm), p) for p in frames] for t in _SHOWN_MM]

    def median(of: Callable[[Beside], float], form: str) -> list[str]:
        recorded = [of(b) for b in groups[0]]
        medians = [format(float(np.median([of(b) for b in group])), form) for group in groups]
        medians[0] += f" ({min(recorded):{form}} to {max(recorded):{form}})"
        return medians

    return {
        "rise, um": median(lambda b: 1e3 * b.rise_mm, ".0f"),
        "sideways, um": median(lambda b: 1e3 * b.sideways_mm, ".0f"),
        "carried along, share": median(lambda b: b.carried, ".2f"),
    }


def rows(recording: CloudRecording) -> tuple[list[list[str]], list[list[str]]]:
    """Compare every episode: rows of both tables."""
    fits, beside_them = [], []
    for name, episode in episodes_by_part(recording).items():
        frames = presses(recording, episode)
        fits.append([name, *fit(frames, recording.pitch_mm)])
        found = figures(frames, recording.pitch_mm)
        beside_them += [[name, what, *values] for what, values in found.items()]
    return fits, beside_them


def episodes_by_part(recording: CloudRecording) -> dict[str, range]:
    """Find the runs of frames with contact, by part."""
    touched = [bool(found) for found in touching(recording)]
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.asarray(touched, int), [0]))))
    runs = [range(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= 8]
    names: dict[int, str] = {}
    for part in PARTS:
        names[part.episode] = part.name if part.together == 1 else "two balls"
    return {names[i]: run for i, run in enumerate(runs) if i in names}


def main(arguments: Sequence[str] | None = None) -> None:
    """Fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/simulator-physics.md"))
    chosen = parser.parse_args(arguments)
    recording = load_pytac3d(pytac3d_example("example_1", "AD2-0065L"))
    fits, beside_them = rows(recording)
    replace_between(chosen.page, "fits", table(_FITS, fits))
    replace_between(chosen.page, "figures", table(_FIGURES, beside_them))


if __name__ == "__main__":
    main()
