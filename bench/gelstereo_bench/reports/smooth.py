"""How smooth a real gel's motion is: each free marker interpolated from the markers around it.

A law that predicts the free markers from those in contact leaves an error of the law, noise, and what is not
smooth. Interpolation needs no law, and sees the markers around the predicted one. What it leaves is an upper
bound of noise and roughness together. The same interpolation of the layer's own motion, with the recording's
noise added, shows how far it is off where there is no other error.

Run ``python -m gelstereo_bench.reports.smooth`` to fill docs/simulator-physics.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo.recordings import CloudRecording, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.free_sides import of_sides
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.physics import Gel, Press, episodes_by_part, presses, rms
from gelstereo_bench.reports.radii import sharpen
from gelstereo_bench.reports.recordings import SALIENCY_MM

__all__ = ["Spline", "left", "main", "rows"]

Array = npt.NDArray[np.float64]

#: The layer that reports/free_sides.py chooses, and its rim.
_GEL, _RIM_MM = Gel(9.0, 0.5), 3.0
#: Markers left out on each side of the predicted one.
_REACHES = (0, 1, 2)
_COLUMNS = [
    "part",
    "noise, %",
    *(f"{what}, {2 * reach + 1} x {2 * reach + 1}" for what in ("left out", "layer") for reach in _REACHES),
]


@dataclass(frozen=True)
class Spline:
    """Thin-plate splines through the nodes of a lattice.

    Attributes
    ----------
    weights
        (N, N) weights of the radial functions for values at the nodes, row by row.
    shape
    """

    weights: Array
    shape: tuple[int, int]

    @classmethod
    def of(cls, shape: tuple[int, int]) -> Spline:
        """Through a square lattice."""
        places = np.indices(shape).reshape(2, -1).T.astype(float)
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        radial = apart**2 * np.log(np.where(apart > 0.0, apart, 1.0))
        plane = np.column_stack([np.ones(len(places)), places])
        system = np.block([[radial, plane], [plane.T, np.zeros((3, 3))]])
        return cls(np.linalg.inv(system)[: len(places), : len(places)], shape)

    def misses(self, values: Array, chosen: npt.NDArray[np.bool_], reach: int) -> Array:
        """Values (rows, cols, k) of the chosen nodes, less the spline through all nodes farther than `reach`
        rows or columns: (chosen, k).

        In closed form from one inverse, as leave-one-out of radial functions (Rippa 1999, Advances in
        Computational Mathematics 11, equation 12), here for blocks.
        """
        flat = values.reshape(-1, values.shape[-1])
        sums = self.weights @ flat
        number = np.arange(len(flat)).reshape(self.shape)
        found = []
        for row, col in np.argwhere(chosen):
            block = number[
                max(row - reach, 0) : row + reach + 1, max(col - reach, 0) : col + reach + 1
            ].ravel()
            left = np.linalg.solve(self.weights[np.ix_(block, block)], sums[block])
            found.append(left[block == number[row, col]][0])
        return np.array(found)


def left(spline: Spline, part: Sequence[Press], motions: Sequence[Array], reach: int) -> float:
    """Share of the free markers' motion that interpolation of `motions` leaves, all three components.

    `motions` has one array for each press. The share is of the presses' own motion.
    """
    found = rms(
        _length(spline.misses(motion, p.free, reach)) for p, motion in zip(part, motions, strict=True)
    )
    return found / rms(_length(p.motion_mm[p.free]) for p in part)


def _length(moved_mm: Array) -> float:
    return float(np.sqrt((moved_mm**2).sum(axis=1).mean()))


def rows(recording: CloudRecording) -> list[list[str]]:
    """Rows of the table."""
    sigma_mm, rng = sharpen(recording, SALIENCY_MM).noise_mm, np.random.default_rng(20211)
    spline = Spline.of((recording.rows, recording.cols))
    lines = []
    for name, episode in episodes_by_part(recording).items():
        part = presses(recording, episode)
        recorded = [p.motion_mm for p in part]
        layer = [of_sides(p, _GEL, recording.pitch_mm, _RIM_MM) for p in part]
        noisy = [motion + sigma_mm * rng.standard_normal(motion.shape) for motion in layer]
        noise = float(np.linalg.norm(sigma_mm)) / rms(_length(p.motion_mm[p.free]) for p in part)
        shares = [left(spline, part, motions, reach) for motions in (recorded, noisy) for reach in _REACHES]
        lines.append([name, f"{100 * noise:.1f}", *(f"{100 * share:.0f}" for share in shares)])
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/simulator-physics.md"))
    chosen = parser.parse_args(arguments)
    recording = load_pytac3d(pytac3d_example("example_1", "AD2-0065L"))
    replace_between(chosen.page, "smooth", table(_COLUMNS, rows(recording)))


if __name__ == "__main__":
    main()
