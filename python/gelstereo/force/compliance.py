"""Compliance matrix of a finite gel, by finite elements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo._native import Compliance, LayerContact, ParamsError
from gelstereo.extras import needs
from gelstereo.force.background import in_background
from gelstereo.force.block import Quarter, lines, solves

__all__ = ["compute_compliance"]

Array = npt.NDArray[np.float64]

#: Of loads, across the planes of symmetry.
_PARITIES = ((1, 1), (1, -1), (-1, 1), (-1, -1))

#: Elements along the gel are as wide as a pitch, those at the top this share of it high, and each below by
#: `_GROWTH` higher.
_FIRST, _GROWTH = 0.6, 1.5
#: Elements widen in a rim from these many elements on, if there are so many.
_REGULAR, _GRADED = 2, 4
#: Cells around a load in which the error of the mesh is corrected.
_REACH = 4
#: Sides of the block that stands for a gel without an end, in thicknesses beyond these cells.
_WIDE = 6.0
#: Elements widen by this factor beyond them.
_WIDENING = 1.8


def compute_compliance(
    *,
    rows: int,
    cols: int,
    pitch_mm: float,
    thickness_mm: float,
    poisson_ratio: float = 0.48,
    rim_mm: float | Sequence[float],
    elements_per_pitch: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Compliance:
    """Motion of every marker under unit tractions on every cell of a finite gel.

    The gel is a linear elastic block with free sides, bonded at its back, with the lattice in its middle and
    at its surface. Elements are boxes with quadratic displacement. Close to its load, a mesh is off by the
    same amount in every gel. It is corrected by the difference of a wide block and of the exact layer.

    Parameters
    ----------
    rows, cols
        Of the lattice, 2 to 64.
    pitch_mm
        Distance of neighbours; at most the thickness.
    thickness_mm
        Of the gel.
    poisson_ratio
        Of the gel, 0 to 0.4999.
    rim_mm
        Gel beyond the outermost markers up to its sides, along rows and along columns, or one number for
        both. Cells that a side cuts carry their whole load on what is left of them.
    elements_per_pitch
        Of the mesh, 1 to 4. Two take ten times as long as one.
    progress
        Called with the number of finished steps and of all steps. The steps are done by a process of
        their own, which Ctrl-C ends.

    Returns
    -------
    Compliance
        For `ForceEstimator` and `Pipeline`.

    Raises
    ------
    ParamsError
        If a number is out of its range.
    MissingExtra
        Without SciPy.
    ChildProcessError
        If the process of the steps ends, for lack of memory for example.
    """
    along = np.asarray(rim_mm, dtype=float).ravel().tolist()
    along = along * 2 if len(along) == 1 else along
    _check(rows, cols, pitch_mm, thickness_mm, poisson_ratio, along, elements_per_pitch)
    with needs("compute_compliance"):
        import scipy.sparse.linalg  # noqa: F401
    gel = _Gel((cols, rows), pitch_mm, thickness_mm, poisson_ratio, (along[0], along[1]), elements_per_pitch)
    values = in_background(gel.values, progress)
    return Compliance(
        values,
        rows=rows,
        cols=cols,
        pitch_mm=pitch_mm,
        thickness_mm=thickness_mm,
        poisson_ratio=poisson_ratio,
        rim_mm=along,
    )


@dataclass(frozen=True)
class _Gel:
    """x before y."""

    counts: tuple[int, int]
    pitch_mm: float
    thickness_mm: float
    poisson_ratio: float
    rim_mm: tuple[float, float]
    elements_per_pitch: int

    def values(self, progress: Callable[[int, int], None]) -> Array:
        """The argument of `Compliance`."""
        cols, rows = self.counts
        size_mm = self.pitch_mm / self.elements_per_pitch
        quarter = ((cols + 1) // 2, (rows + 1) // 2)
        total = len(_PARITIES) * (solves(3 * quarter[0] * quarter[1]) + solves(3))
        done = 0

        def step() -> None:
            nonlocal done
            done += 1
            progress(done, total)

        progress(0, total)
        halves = [
            0.5 * self.pitch_mm * (count - 1) + rim
            for count, rim in zip(self.counts, self.rim_mm, strict=True)
        ]
        z = self.thickness_mm - lines(_FIRST * size_mm, self.thickness_mm, _GROWTH)[::-1]
        x, y = (_edges(half, rim, size_mm) for half, rim in zip(halves, self.rim_mm, strict=True))
        block = Quarter((x, y, z), self.poisson_ratio, step)
        moved = _Lattice(self.counts, self.pitch_mm, (halves[0], halves[1])).moved(block, quarter)
        missing = self._missing(z, size_mm, step)
        for row, col in np.ndindex(moved.shape[:2]):
            # The cell is in the last quarter of the lattice.
            at_row, at_col = rows // 2 + row, cols // 2 + col
            down, right = np.arange(rows) - at_row, np.arange(cols) - at_col
            near = np.ix_(np.abs(down) <= _REACH, np.abs(right) <= _REACH)
            moved[row, col][near] += missing[
                down[np.abs(down) <= _REACH][:, None] + _REACH, right[np.abs(right) <= _REACH] + _REACH
            ]
        return _by_marker(moved)

    def _missing(self, z_mm: Array, size_mm: float, step: Callable[[], None]) -> Array:
        """(offsets down, offsets right, 3, 3) motion of the exact layer less that of the mesh in a wide
        block.
        """
        few = tuple(count % 2 + 2 * (_REACH + 1) for count in self.counts)
        regular = np.arange(0.0, (_REACH + 2) * self.pitch_mm + size_mm / 2, size_mm)
        wide = lines(1.2 * size_mm, _WIDE * self.thickness_mm, _WIDENING)
        edges = np.concatenate([regular, regular[-1] + wide[1:]])
        block = Quarter((edges, edges, z_mm), self.poisson_ratio, step)
        lattice = _Lattice((few[0], few[1]), self.pitch_mm, (float(edges[-1]), float(edges[-1])))
        found = lattice.moved(block, (1, 1))[0, 0]
        middle = [count // 2 for count in few]
        around = [slice(at - _REACH, at + _REACH + 1) for at in middle]
        return np.asarray(self._layer() - found[around[1], around[0]])

    def _layer(self) -> Array:
        """Motion of the exact layer along x, y and z, which is out of it, around a loaded cell."""
        side = 2 * _REACH + 1
        contact = LayerContact(
            thickness_mm=self.thickness_mm,
            poisson_ratio=self.poisson_ratio,
            rows=side,
            cols=side,
            cell_mm=self.pitch_mm,
        )
        moved = np.empty((side, side, 3, 3))
        for k in range(3):
            pressure, traction = np.zeros((side, side)), np.zeros((side, side, 2))
            if k < 2:
                traction[_REACH, _REACH, k] = 1.0
            else:
                pressure[_REACH, _REACH] = -1.0
            moved[..., k] = contact.load(pressure, traction).motion_mm * (1.0, 1.0, -1.0)
        return moved


def _check(
    rows: int,
    cols: int,
    pitch_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
    rim_mm: list[float],
    elements: int,
) -> None:
    if len(rim_mm) != 2:
        raise ParamsError(
            f"rim_mm has {len(rim_mm)} numbers; valid is one, or one for rows and one for columns"
        )
    for name, found, is_valid, valid in (
        ("rows", rows, 2 <= rows <= 64, "2 to 64"),
        ("cols", cols, 2 <= cols <= 64, "2 to 64"),
        ("thickness_mm", thickness_mm, 0.1 <= thickness_mm <= 1000, "0.1 to 1000 mm"),
        (
            "pitch_mm",
            pitch_mm,
            thickness_mm / 50 <= pitch_mm <= thickness_mm,
            "a fiftieth of the thickness to it",
        ),
        ("elements_per_pitch", elements, 1 <= elements <= 4, "1 to 4"),
        ("poisson_ratio", poisson_ratio, 0 <= poisson_ratio <= 0.4999, "0 to 0.4999"),
        *(
            (
                name,
                rim,
                0.001 <= rim <= 10 * thickness_mm,
                "0.001 mm to ten thicknesses; the layer serves for more",
            )
            for name, rim in zip(("rim_mm along rows", "rim_mm along columns"), rim_mm, strict=True)
        ),
    ):
        if not is_valid:
            raise ParamsError(f"{name} is {found}; valid is {valid}")


def _edges(half_mm: float, rim_mm: float, size_mm: float) -> Array:
    """Edges of elements from the middle to a side: equally apart, and wider in a wide rim."""
    until_mm = half_mm if rim_mm < _GRADED * size_mm else half_mm - rim_mm + _REGULAR * size_mm
    regular = size_mm * np.arange(int((until_mm - 0.25 * size_mm) / size_mm) + 1)
    left = half_mm - regular[-1]
    rest = lines(1.2 * size_mm, left, _GROWTH) if left > 1.5 * size_mm else np.array([0.0, left])
    return np.concatenate([regular, regular[-1] + rest[1:]])


class _Lattice:
    """Loads and markers in the middle of a block; x before y."""

    def __init__(self, counts: tuple[int, int], pitch_mm: float, halves_mm: tuple[float, float]) -> None:
        self.counts, self.pitch_mm, self.halves_mm = counts, pitch_mm, halves_mm

    def _places(self, axis: int, count: int) -> Array:
        """Those beyond the middle."""
        start = 0.0 if self.counts[axis] % 2 else 0.5
        return np.asarray(self.pitch_mm * (start + np.arange(count)))

    def _load(self, block: Quarter, axis: int, place_mm: float) -> Array:
        low, high = place_mm - self.pitch_mm / 2, min(place_mm + self.pitch_mm / 2, self.halves_mm[axis])
        return block.over(axis, max(low, 0.0), high) * (self.pitch_mm / (high - low))

    def moved(self, block: Quarter, cells: tuple[int, ...]) -> Array:
        """(cells down, cells right, rows, columns, 3, 3) motion of all markers along x, y and z under
        tractions along x, y and z on cells of the last quarter, from the middle outwards.
        """
        loads = [
            np.array([self._load(block, axis, place) for place in self._places(axis, cells[axis])])
            for axis in (0, 1)
        ]
        halves = [(count + 1) // 2 for count in self.counts]
        markers = [
            np.array([block.at(axis, place) for place in self._places(axis, halves[axis])]) for axis in (0, 1)
        ]
        on_top = np.einsum("rY,cX->YXrc", loads[1], loads[0])
        moved = np.zeros((cells[1], cells[0], self.counts[1], self.counts[0], 3, 3))
        folded = [self._folded(axis) for axis in (0, 1)]
        for parity in _PARITIES:
            forces = np.zeros((*on_top.shape[:2], 3, *on_top.shape[2:], 3))
            for k in range(3):
                forces[:, :, k, ..., k] = on_top * self._share(parity, k, on_top.shape[2:])
            top = block.top(parity, forces.reshape(-1, 3, int(np.prod(forces.shape[3:]))))
            found = np.einsum(
                "rY,cX,YXkabl->abrckl", markers[1], markers[0], top.reshape(forces.shape), optimize=True
            )
            signs = [np.where(folded[axis][1][:, None], self._signs(parity, axis), 1.0) for axis in (0, 1)]
            both = signs[1][:, None] * signs[0][None]
            moved += found[:, :, folded[1][0][:, None], folded[0][0]] * both[..., None]
        return moved

    @staticmethod
    def _signs(parity: tuple[int, int], axis: int) -> Array:
        """Of motion in a mirror image."""
        return np.array([-parity[axis] if k == axis else parity[axis] for k in range(3)], dtype=float)

    def _folded(self, axis: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Index from the middle of every marker, and whether it is before the middle."""
        count = self.counts[axis]
        index = np.arange(count)
        return np.where(index < count // 2, (count - 1) // 2 - index, index - count // 2), index < count // 2

    def _share(self, parity: tuple[int, int], component: int, shape: tuple[int, ...]) -> Array:
        """Of the load in its part of this parity. A cell in the middle is its own image."""
        share = np.full(shape, 0.25)
        for axis, middle in ((0, np.s_[:, 0]), (1, np.s_[0, :])):
            if self.counts[axis] % 2:
                is_even = self._signs(parity, axis)[component] > 0
                share[middle] *= 2.0 if is_even else 0.0
        return share


def _by_marker(moved: Array) -> Array:
    """The argument of `Compliance`, from motion by cells of the last quarter."""
    down, right, rows, cols = moved.shape[:4]
    # Into the layer, along rows, along columns.
    order, into = [2, 0, 1], np.array([-1.0, 1.0, 1.0])
    moved = moved[..., order, :][..., order] * into[:, None] * into
    values = np.empty((down, right, rows, cols, 3, 3), dtype=np.float32)
    for flips in np.ndindex(2, 2):
        signs = np.array([1.0, -1.0 if flips[1] else 1.0, -1.0 if flips[0] else 1.0])
        image = moved[:, :, :: -1 if flips[0] else 1, :: -1 if flips[1] else 1][:, :, :down, :right]
        image = image * signs[:, None] * signs
        at = [count // 2 + np.arange(half) for count, half in ((rows, down), (cols, right))]
        at = [count - 1 - i if flip else i for count, i, flip in zip((rows, cols), at, flips, strict=True)]
        values[:, :, at[0][:, None], at[1]] = image.transpose(2, 3, 0, 1, 4, 5)
    return np.asarray(values, dtype=np.float64)
