"""The simulator's free sides, and the pipeline's law of the skin, compared with a real sensor.

As in `gelstereo_bench.reports.physics`, the markers in contact are prescribed and the others predicted, here
with the images of the loads that give the simulator's layer its free sides (``rim_mm``). The recorded markers
may also be lifted to the skin over them, as by ``lattice.depth_mm``. The thickness is chosen on one part, and
the others judge.

Run ``python -m gelstereo_bench.reports.free_sides`` to fill docs/simulator-physics.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import LayerContact, RestSurface, skin_over
from gelstereo.recordings import CloudRecording, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.physics import Gel, Press, episodes_by_part, of_layer, off, presses, rms

__all__ = ["Sides", "by_depth", "lifted", "main", "of_sides", "rows"]

Array = npt.NDArray[np.float64]

_GELS = [Gel(thickness_mm, 0.5) for thickness_mm in (4.0, 6.0, 9.0, 11.0, 14.0)]
_DEPTHS_MM = (0.0, 0.25, 0.5, 0.75, 1.0)
#: As of the block: the recordings do not document the gel's sides.
_RIM_MM = 3.0
#: Loads of an image over those of the cell, as in the core's ``layer/free_sides.rs``.
_OF_IMAGE = 1.2
#: Solves with the motion by the sides, and the change at which they end, as in the simulator.
_ROUNDS, _TOLERANCE_MM = 6, 1e-4
#: The part on which the thickness is chosen.
_CHOSEN_ON = "two balls"
#: All three components of motion.
_ALL = slice(0, 3)
_COLUMNS = ["part", "moved um", "layer off um", "with free sides, off um", "share, %"]


@dataclass(frozen=True)
class Sides:
    """Motion of a layer's cells by the images of loads beyond its free sides.

    Attributes
    ----------
    influence
        (rows, cols, 3, 3) motion (last: along x, along y, into the layer) around a cell in the middle, under
        a traction along x, one along y and a pressure.
    sums
        Sums of the columns of a cell and its image beyond either side, and of the rows.
    """

    influence: Array
    sums: tuple[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, gel: Gel, shape: tuple[int, int], pitch_mm: float, rim_mm: float) -> Sides:
        """Sides beyond the outermost cells by `rim_mm`, rounded to half a cell."""
        beyond = round(2.0 * rim_mm / pitch_mm)
        rows, cols = ((-beyond, 2 * (count - 1) + beyond) for count in shape)
        reach = max(rows[1], cols[1])
        side = 2 * reach + 1
        layer = LayerContact(
            thickness_mm=gel.thickness_mm,
            poisson_ratio=gel.poisson_ratio,
            rows=side,
            cols=side,
            cell_mm=pitch_mm,
        )
        influence = np.empty((side, side, 3, 3))
        for load in range(3):
            loads = np.zeros((side, side, 3))
            loads[reach, reach, load] = 1.0
            influence[:, :, load] = layer.load(loads[..., 2], loads[..., :2]).motion_mm
        return cls(influence, (cols, rows))

    def motion(self, loads: Array) -> Array:
        """Motion (rows, cols, 3) by the images of loads (rows, cols, 3): tractions, then pressures."""
        rows, cols = loads.shape[:2]
        at_row, at_col = np.mgrid[:rows, :cols]
        middle = self.influence.shape[0] // 2
        moved = np.zeros(loads.shape)
        for row, col in np.argwhere(np.any(loads != 0.0, axis=2)):
            images = [(row, total - col, 0) for total in self.sums[0]]
            images += [(total - row, col, 1) for total in self.sums[1]]
            for image_row, image_col, kept in images:
                # Tractions across the side keep their sign.
                own = -_OF_IMAGE * loads[row, col]
                own[kept] *= -1.0
                effect = self.influence[middle + at_row - image_row, middle + at_col - image_col]
                moved += np.einsum("l,rclk->rck", own, effect)
        return moved


@cache
def _solver(gel: Gel, shape: tuple[int, int], pitch_mm: float, rim_mm: float) -> tuple[LayerContact, Sides]:
    contact = LayerContact(
        thickness_mm=gel.thickness_mm,
        poisson_ratio=gel.poisson_ratio,
        rows=shape[0],
        cols=shape[1],
        cell_mm=pitch_mm,
        friction=1e3,
    )
    return contact, Sides.of(gel, shape, pitch_mm, rim_mm)


def of_sides(press: Press, gel: Gel, pitch_mm: float, rim_mm: float) -> Array:
    """Motion of all markers of a layer with free sides, whose markers in contact move as recorded."""
    rows, cols = press.touches.shape
    contact, sides = _solver(gel, (rows, cols), pitch_mm, rim_mm)
    aside = np.zeros(press.motion_mm.shape)
    for _ in range(1 + _ROUNDS):
        asked = press.motion_mm - aside
        heights = np.where(press.touches, np.minimum(asked[..., 2], gel.thickness_mm), -np.inf)
        found = contact.press(heights, asked[..., :2], tolerance_mm=_TOLERANCE_MM)
        before = aside
        aside = sides.motion(np.concatenate([found.traction, found.pressure[..., None]], axis=2))
        if np.abs(aside - before)[press.touches].max() < _TOLERANCE_MM:
            break
    return np.asarray(found.motion_mm + aside)


def lifted(recording: CloudRecording, depth_mm: float) -> CloudRecording:
    """The skin over a recording's markers that lie so deep below it."""
    if depth_mm == 0.0:
        return recording
    rest, none = RestSurface(recording.rest_mm), np.zeros((len(recording.rest_mm), 3, 3))

    def skin(points_mm: Array) -> Array:
        return np.asarray(skin_over(rest, points_mm, none, cols=recording.cols, depth_mm=depth_mm)[0])

    points_mm = np.array([skin(points) for points in recording.points_mm])
    return replace(recording, points_mm=points_mm, rest_mm=skin(recording.rest_mm))


def skins(recording: CloudRecording, depth_mm: float) -> dict[str, list[Press]]:
    """Frames by part: motion of the skin, with the contacts of the recorded markers."""
    skin = lifted(recording, depth_mm)
    return {name: presses(recording, span, moved=skin) for name, span in episodes_by_part(recording).items()}


def _moved(part: Sequence[Press]) -> float:
    return rms(off(np.zeros_like(p.motion_mm), p, _ALL) for p in part)


def _off(part: Sequence[Press], gel: Gel, pitch_mm: float, *, has_sides: bool) -> float:
    if has_sides:
        return rms(off(of_sides(p, gel, pitch_mm, _RIM_MM), p, _ALL) for p in part)
    return rms(off(of_layer(p, gel, pitch_mm), p, _ALL) for p in part)


def rows(recording: CloudRecording) -> tuple[list[list[str]], dict[str, float]]:
    """Rows of the table, and the thicknesses chosen."""
    frames, pitch_mm = skins(recording, 0.0), recording.pitch_mm

    def best(has_sides: bool) -> Gel:
        chosen_on = frames[_CHOSEN_ON]
        return min(_GELS, key=lambda gel: _off(chosen_on, gel, pitch_mm, has_sides=has_sides))

    layer, sides = best(False), best(True)
    lines = []
    for name, part in frames.items():
        moved = _moved(part)
        endless = _off(part, layer, pitch_mm, has_sides=False)
        ended = _off(part, sides, pitch_mm, has_sides=True)
        values = [f"{1e3 * value:.0f}" for value in (moved, endless, ended)]
        lines.append([name, *values, f"{100 * endless / moved:.0f} to {100 * ended / moved:.0f}"])
    return lines, {"layer": layer.thickness_mm, "with free sides": sides.thickness_mm}


def by_depth(recording: CloudRecording) -> list[list[str]]:
    """Share of the skin's motion that is unexplained, by the depth of the print, of one part."""
    lines = []
    for depth_mm in _DEPTHS_MM:
        part = skins(recording, depth_mm)[_CHOSEN_ON]
        left = min(_off(part, gel, recording.pitch_mm, has_sides=True) for gel in _GELS)
        lines.append([f"{depth_mm:g}", f"{1e3 * _moved(part):.0f}", f"{100 * left / _moved(part):.0f}"])
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/simulator-physics.md"))
    chosen = parser.parse_args(arguments)
    recording = load_pytac3d(pytac3d_example("example_1", "AD2-0065L"))
    lines, thicknesses_mm = rows(recording)
    replace_between(chosen.page, "sides", table(_COLUMNS, lines))
    head = ["depth of the print, mm", "the skin moved, um", "left by the layer with free sides, %"]
    replace_between(chosen.page, "depths", table(head, by_depth(recording)))
    print(f"chosen thicknesses, mm: {thicknesses_mm}")


if __name__ == "__main__":
    main()
