"""A layer with free sides under a skin of another stiffness, compared with a real sensor.

As in `gelstereo_bench.reports.free_sides`, the markers in contact are prescribed and the others predicted.
The print lies under a skin: a thin plate on the layer, which resists stretching and bending (Timoshenko and
Woinowsky-Krieger, "Theory of Plates and Shells", sections 4 and 21). It ends with the lattice. The layer's
thickness, and the skin's thickness and modulus, are chosen on one part, and the others judge.

Run ``python -m gelstereo_bench.reports.stiff_skin`` to fill docs/simulator-physics.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo.progress import progress
from gelstereo.recordings import CloudRecording, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.free_sides import Sides
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.physics import Gel, Press, episodes_by_part, off, presses, rms

__all__ = ["Skin", "bending", "compliance", "main", "predicted", "rows", "stretching"]

Array = npt.NDArray[np.float64]

_THICKNESSES_MM = (8.0, 9.0, 10.0)
_RIM_MM = 3.0
#: The part on which the layer and its skin are chosen.
_CHOSEN_ON = "two balls"
_COLUMNS = ["part", "moved um", "layer with free sides, off um", "with the skin, off um", "share, %"]


@dataclass(frozen=True)
class Skin:
    """A skin, incompressible as the gel; its modulus is over the gel's."""

    thickness_mm: float
    modulus: float

    def stiffness(self, shape: tuple[int, int], pitch_mm: float) -> Array:
        """(3 N, 3 N) forces over the gel's modulus under motion of the nodes, along x, y and z."""
        stretch_mm = self.modulus * self.thickness_mm
        # E t^3 / (12 (1 - nu^2)) for a Poisson's ratio of 0.5.
        bend_mm3 = self.modulus * self.thickness_mm**3 / 9.0
        return stretch_mm * stretching(shape) + bend_mm3 / pitch_mm**2 * bending(shape)


_SKINS = [Skin(thickness_mm, modulus) for thickness_mm in (0.7, 1.0, 1.4, 2.0) for modulus in (0.3, 1.0, 3.0)]


def compliance(gel: Gel, shape: tuple[int, int], pitch_mm: float, rim_mm: float) -> Array:
    """(3 N, 3 N) motion under a unit load on each cell of a layer with free sides: along x, y, into it."""
    sides = Sides.of(gel, shape, pitch_mm, rim_mm)
    middle, count = sides.influence.shape[0] // 2, shape[0] * shape[1]
    at_row, at_col = np.mgrid[: shape[0], : shape[1]]
    found = np.empty((count, 3, count, 3))
    for cell, (row, col) in enumerate(np.ndindex(shape)):
        own = sides.influence[middle + at_row - row, middle + at_col - col]
        for load in range(3):
            loads = np.zeros((*shape, 3))
            loads[row, col, load] = 1.0
            found[:, :, cell, load] = (own[:, :, load] + sides.motion(loads)).reshape(count, 3)
    return found.reshape(3 * count, 3 * count)


def stretching(shape: tuple[int, int]) -> Array:
    """Forces of a plate of unit stiffness E t in its plane: bilinear elements in plane stress."""
    law = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.25]]) / 0.75
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    element = np.zeros((8, 8))
    for point in signs / np.sqrt(3.0):
        rates = 0.5 * signs * (1.0 + (point * signs)[:, ::-1])
        strain = np.zeros((3, 8))
        strain[0, ::2], strain[1, 1::2] = rates.T
        strain[2, ::2], strain[2, 1::2] = rates[:, 1], rates[:, 0]
        element += 0.25 * strain.T @ law @ strain
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    found = np.zeros((3 * number.size, 3 * number.size))
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    for nodes in corners.reshape(-1, 4):
        places = (3 * nodes[:, None] + np.arange(2)).ravel()
        found[np.ix_(places, places)] += element
    return found


def bending(shape: tuple[int, int]) -> Array:
    """Forces across a plate of unit bending stiffness and pitch, whose sides are free of moments."""
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    curvature = np.zeros((number.size, number.size))
    for before, here, after in (
        (number[:-2], number[1:-1], number[2:]),
        (number[:, :-2], number[:, 1:-1], number[:, 2:]),
    ):
        for nodes, weight in ((before, 1.0), (here, -2.0), (after, 1.0)):
            curvature[here.ravel(), nodes.ravel()] += weight
    found = np.zeros((3 * number.size, 3 * number.size))
    found[2::3, 2::3] = curvature.T @ curvature
    return found


def predicted(stiffness: Array, press: Press) -> Array:
    """Motion of all markers of which those in contact move as recorded and no force acts on the others."""
    motion = press.motion_mm.ravel().copy()
    held = np.repeat(press.touches.ravel(), 3)
    free = ~held
    pulled = stiffness[np.ix_(free, held)] @ motion[held]
    motion[free] = np.linalg.solve(stiffness[np.ix_(free, free)], -pulled)
    return np.asarray(motion.reshape(press.motion_mm.shape))


def _off(part: Sequence[Press], stiffness: Array) -> float:
    return rms(off(predicted(stiffness, p), p, slice(0, 3)) for p in part)


def rows(recording: CloudRecording) -> tuple[list[list[str]], float, Skin]:
    """Rows of the table, and the thickness and skin chosen."""
    shape, pitch_mm = (recording.rows, recording.cols), recording.pitch_mm
    parts = {name: presses(recording, span) for name, span in episodes_by_part(recording).items()}
    layers = {}
    for thickness_mm in progress(_THICKNESSES_MM, "solving layers"):
        found = np.linalg.inv(compliance(Gel(thickness_mm, 0.5), shape, pitch_mm, _RIM_MM))
        # Loads of the layer are pressures over the modulus: forces are those times a cell's area.
        layers[thickness_mm] = 0.5 * pitch_mm**2 * (found + found.T)
    bare = min(layers, key=lambda key: _off(parts[_CHOSEN_ON], layers[key]))
    plates = {skin: skin.stiffness(shape, pitch_mm) for skin in _SKINS}
    pairs = [(thickness_mm, skin) for thickness_mm in layers for skin in plates]
    errors = {
        pair: _off(parts[_CHOSEN_ON], layers[pair[0]] + plates[pair[1]])
        for pair in progress(pairs, "trying skins")
    }
    thickness_mm, skin = min(errors, key=errors.__getitem__)
    lines = []
    for name, part in parts.items():
        moved = rms(off(np.zeros_like(p.motion_mm), p, slice(0, 3)) for p in part)
        without, with_skin = (_off(part, k) for k in (layers[bare], layers[thickness_mm] + plates[skin]))
        values = [f"{1e3 * value:.0f}" for value in (moved, without, with_skin)]
        lines.append([name, *values, f"{100 * without / moved:.0f} to {100 * with_skin / moved:.0f}"])
    return lines, thickness_mm, skin


def main(arguments: Sequence[str] | None = None) -> None:
    """Fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/simulator-physics.md"))
    chosen = parser.parse_args(arguments)
    lines, thickness_mm, skin = rows(load_pytac3d(pytac3d_example("example_1", "AD2-0065L")))
    replace_between(chosen.page, "skin", table(_COLUMNS, lines))
    print(f"chosen: a layer of {thickness_mm:g} mm with {skin}")


if __name__ == "__main__":
    main()
