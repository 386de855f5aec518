"""Layout of a print: square, rectangular, hexagonal or irregular, with the row and column of every dot.

Nothing is taken for granted but that neighbouring dots lie on one lattice: steps from dot to dot are compared
with those beside them, so that perspective, a bent gel and a turned camera do not matter.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

__all__ = ["Layout", "LayoutKind", "layout_of"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
LayoutKind = Literal["square", "rectangular", "hexagonal", "irregular"]

#: Neighbours of which steps are taken: those of a hexagonal print, and the diagonals of a square one.
_NEIGHBOURS = 8
#: Fewest dots of which a layout is stated.
MIN_DOTS = 9
#: A dot is where a step leads if it is nearer than this share of the step.
_REACH = 0.3
#: Of the dots, this share must be on the lattice; random dots are below a third.
_MIN_ON_LATTICE = 0.6
#: Angle between the two shortest steps: 60 degrees for hexagonal prints, 90 for the others. Half-way between.
_HEXAGONAL_BELOW_DEG = 75.0
#: Sides that differ by more are rectangular. A square print seen at 30 degrees has 1.15.
_SQUARE_RATIO = 1.15


@dataclass(frozen=True)
class Layout:
    """What is known of the arrangement of dots."""

    kind: LayoutKind
    #: Median length of the steps along rows and along columns, pixels; for a hexagonal print, along rows and
    #: to the nearest dot of the next row. NaN for an irregular print: then both are the median distance of
    #: neighbours.
    spacing_px: tuple[float, float]
    #: Angle between both steps, degrees.
    angle_deg: float
    #: Share of the dots that are on the lattice.
    on_lattice: float
    #: Rows and columns that are seen; 0 for an irregular print.
    rows: int
    cols: int
    #: Share of the places of these rows and columns that show a dot.
    filled: float
    #: Share of the places of the four border lines that show a dot; a border line that is not whole is seen
    #: in part.
    borders: tuple[float, float, float, float]
    #: Row and column of every dot (N, 2); -1 for dots that are not on the lattice.
    places: Integers
    #: Root mean square distance of the dots from a plane lattice seen in perspective, pixels.
    bend_px: float
    #: Longest over shortest step after the lattice was fitted, along the picture.
    perspective: float

    @property
    def is_whole(self) -> bool:
        """Whether rows and columns end inside the picture."""
        return self.kind != "irregular" and min(self.borders) >= 0.8 and self.filled >= 0.8


def layout_of(centres_px: Array) -> Layout:
    """The layout of dots (N, 2)."""
    centres = np.asarray(centres_px, np.float64)
    if len(centres) < MIN_DOTS:
        return _irregular(centres, float("nan"))
    near = _nearest(centres)
    nearest_px = np.linalg.norm(centres[near[:, 0]] - centres, axis=1)
    # What is beside a dot counts: the distances of its neighbours vary less than those of the whole picture.
    local_px = np.maximum(np.median(nearest_px[near[:, :4]], axis=1), 1e-6)
    steps = _basic_steps(centres, near, local_px)
    if steps is None:
        return _irregular(centres, float(np.median(nearest_px)))
    places = _places(centres, near, local_px, steps)
    on_lattice = float((places[:, 0] > _OFF).mean())
    if on_lattice < _MIN_ON_LATTICE:
        return _irregular(centres, float(np.median(nearest_px)), on_lattice)
    return _described(centres, places, on_lattice)


def _irregular(centres: Array, spacing_px: float, on_lattice: float = 0.0) -> Layout:
    nowhere = np.full((len(centres), 2), -1)
    whole = (0.0, 0.0, 0.0, 0.0)
    none = float("nan")
    return Layout(
        "irregular", (spacing_px, spacing_px), none, on_lattice, 0, 0, 0.0, whole, nowhere, none, none
    )


def _nearest(centres: Array) -> Integers:
    """Indices (N, K) of the nearest other dots, nearest first."""
    count = min(_NEIGHBOURS, len(centres) - 1)
    found = np.empty((len(centres), count), np.int64)
    squares = np.sum(centres**2, axis=1)
    for start in range(0, len(centres), 512):
        part = slice(start, start + 512)
        away = squares[part, None] + squares[None] - 2.0 * centres[part] @ centres.T
        rows = np.arange(len(away))
        away[rows, rows + start] = np.inf
        best = np.argpartition(away, count - 1, axis=1)[:, :count]
        order = np.argsort(np.take_along_axis(away, best, axis=1), axis=1)
        found[part] = np.take_along_axis(best, order, axis=1)
    return found


#: Place of dots that no step reached.
_OFF = np.iinfo(np.int64).min


def _basic_steps(centres: Array, near: Integers, local_px: Array) -> Array | None:
    """The two shortest independent steps (2, 2) that most dots share, in units of the local spacing.

    The densest places of all steps to neighbours, of which one of every opposite pair is kept.
    """
    steps = (centres[near] - centres[:, None]) / local_px[:, None, None]
    steps = steps.reshape(-1, 2)
    steps = steps[np.linalg.norm(steps, axis=1) < 2.6]
    both = np.concatenate([steps, -steps])
    cell, half = 0.1, 30
    bins = np.round(both / cell).astype(int) + half
    inside = ((bins >= 0) & (bins <= 2 * half)).all(axis=1)
    counts = np.zeros((2 * half + 1, 2 * half + 1))
    np.add.at(counts, (bins[inside, 1], bins[inside, 0]), 1.0)
    smooth = _smoothed(counts)
    peaks: list[tuple[float, Array]] = []
    for _ in range(12):
        y, x = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
        height = float(smooth[y, x])
        if height < 0.25 * (peaks[0][0] if peaks else height) or height <= 0.0:
            break
        at = (np.array([x, y]) - half) * cell
        close = np.linalg.norm(both - at, axis=1) < 0.25
        peaks.append((height, both[close].mean(axis=0)))
        smooth[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4] = 0.0
    ways = sorted(
        (step for _, step in peaks if np.linalg.norm(step) > 0.5), key=lambda s: float(np.linalg.norm(s))
    )
    for second in ways[1:]:
        sine = abs(ways[0][0] * second[1] - ways[0][1] * second[0])
        if sine > 0.5 * np.linalg.norm(ways[0]) * np.linalg.norm(second):
            return _as_rows_and_columns(ways[0], second)
    return None


def _smoothed(counts: Array) -> Array:
    for axis in (0, 1):
        counts = counts + np.roll(counts, 1, axis) + np.roll(counts, -1, axis)
    return counts


def _as_rows_and_columns(one: Array, other: Array) -> Array:
    """Row step to the right, column step downwards."""
    across, down = sorted((one, other), key=lambda step: -abs(step[0]) / float(np.linalg.norm(step)))
    across = across if across[0] > 0.0 else -across
    down = down if down[1] > 0.0 else -down
    return np.array([across, down])


def _places(centres: Array, near: Integers, local_px: Array, steps: Array) -> Integers:
    """Row and column (N, 2) of the dots that steps reach from the best-surrounded dot on; `_OFF` elsewhere.

    Every dot has its own steps: those that led to it, half of each renewed by what was found.
    """
    moves = [(0, 1), (1, 0), (0, -1), (-1, 0)]
    best = np.full((len(centres), 2), _OFF)
    left = np.ones(len(centres), bool)
    while left.any() and 2 * left.sum() > (best[:, 0] > _OFF).sum():
        seed = int(np.flatnonzero(left)[np.argmin(_unlike(centres, near, local_px, steps)[left])])
        places = np.full((len(centres), 2), _OFF)
        own = np.tile(steps[None], (len(centres), 1, 1)) * local_px[:, None, None]
        taken = {(0, 0): seed}
        places[seed] = 0
        queue = deque([seed])
        while queue:
            at = queue.popleft()
            row, col = places[at]
            for down, right in moves:
                place = (int(row) + down, int(col) + right)
                step = down * own[at, 1] + right * own[at, 0]
                away = np.linalg.norm(centres[near[at]] - centres[at] - step, axis=1)
                nearest = int(np.argmin(away))
                to = int(near[at, nearest])
                if place in taken or places[to, 0] > _OFF or away[nearest] > _REACH * np.linalg.norm(step):
                    continue
                places[to], taken[place] = place, to
                found = (centres[to] - centres[at]) * (down + right)
                own[to] = own[at]
                which = 0 if right else 1
                own[to, which] = 0.5 * (own[at, which] + found)
                queue.append(to)
        reached = places[:, 0] > _OFF
        if reached.sum() > (best[:, 0] > _OFF).sum():
            best = places
        left &= ~reached
        left[seed] = False
        if (best[:, 0] > _OFF).mean() > 0.5:
            break
    return best


def _unlike(centres: Array, near: Integers, local_px: Array, steps: Array) -> Array:
    """How far the four steps from each dot miss their nearest dots, summed, in units of the local spacing."""
    away = (centres[near] - centres[:, None]) / local_px[:, None, None]
    wanted = np.array([steps[0], -steps[0], steps[1], -steps[1]])
    return np.asarray(np.linalg.norm(away[:, :, None] - wanted, axis=-1).min(axis=1).sum(axis=1))


def _described(centres: Array, places: Integers, on_lattice: float) -> Layout:
    on = places[:, 0] > _OFF
    across_px, down_px = _median_steps(centres[on], places[on])
    lengths = (float(np.linalg.norm(across_px)), float(np.linalg.norm(down_px)))
    cosine = float(across_px @ down_px) / (lengths[0] * lengths[1])
    angle_deg = float(np.degrees(np.arccos(np.clip(abs(cosine), 0.0, 1.0))))
    ratio = max(lengths) / min(lengths)
    kind: LayoutKind = "square" if ratio < _SQUARE_RATIO else "rectangular"
    lattice = places[on]
    bend_px, perspective = _distortion(centres[on], lattice)
    if angle_deg < _HEXAGONAL_BELOW_DEG:
        kind = "hexagonal"
        shown, whole = _hexagonal(lattice, across_px, down_px)
    else:
        shown, whole = _trimmed(lattice)
    out = np.full((len(centres), 2), -1)
    at = np.flatnonzero(on)
    out[at[whole]] = shown[whole]
    kept = shown[whole]
    rows, cols = (int(side) for side in kept.max(axis=0) + 1)
    borders = (
        float((kept[:, 0] == 0).sum()) / cols,
        float((kept[:, 0] == rows - 1).sum()) / cols,
        float((kept[:, 1] == 0).sum()) / rows,
        float((kept[:, 1] == cols - 1).sum()) / rows,
    )
    filled = len(kept) / (rows * cols)
    return Layout(
        kind, lengths, angle_deg, on_lattice, rows, cols, filled, borders, out, bend_px, perspective
    )


def _hexagonal(places: Integers, across_px: Array, down_px: Array) -> tuple[Integers, npt.NDArray[np.bool_]]:
    """Rows and columns of a hexagonal print, of which every second row is shifted by half a step.

    A hexagonal lattice has three directions of rows. Those of the print fill a rectangle.
    """
    row, col = places.T
    lean = 1 if across_px @ down_px > 0.0 else -1
    # Along the third direction, `down - lean * across`, the other two steps lead from row to row.
    ways = [
        (row, col, lean, across_px),
        (col, row, lean, down_px),
        (col + lean * row, row, -1 if lean > 0 else 1, down_px - lean * across_px),
    ]
    best: tuple[float, Integers, npt.NDArray[np.bool_]] | None = None
    for line, along, leaning, step in ways:
        for shift in (0, 1):
            found = np.column_stack([line, along + leaning * np.floor_divide(line + shift, 2)])
            found, keep = _trimmed(found)
            kept = found[keep]
            filled = len(kept) / float(np.prod(kept.max(axis=0) + 1))
            if best is None or filled > best[0] + 1e-9:
                # Lines that run down the picture are columns.
                turned = abs(step[0]) < abs(step[1])
                best = filled, found[:, ::-1] if turned else found, keep
    assert best is not None
    return best[1], best[2]


def _trimmed(places: Integers) -> tuple[Integers, npt.NDArray[np.bool_]]:
    """Places without border lines of one or two stray dots, from 0, and which dots are kept."""
    keep = np.ones(len(places), bool)
    changed = True
    while changed:
        changed = False
        for axis in (0, 1):
            for end in (places[keep].min(axis=0)[axis], places[keep].max(axis=0)[axis]):
                line = keep & (places[:, axis] == end)
                longest = np.ptp(places[keep][:, 1 - axis]) + 1
                if 5 * line.sum() < longest and keep.sum() > line.sum():
                    keep &= ~line
                    changed = True
    return places - places[keep].min(axis=0), keep


def _median_steps(centres: Array, places: Integers) -> tuple[Array, Array]:
    """Median steps along rows and along columns, pixels."""
    at = {(int(row), int(col)): index for index, (row, col) in enumerate(places)}
    steps: list[Array] = []
    for down, right in ((0, 1), (1, 0)):
        pairs = [
            (index, at[row + down, col + right])
            for (row, col), index in at.items()
            if (row + down, col + right) in at
        ]
        one, other = np.array(pairs).T if pairs else (np.zeros(1, int), np.zeros(1, int))
        steps.append(np.median(centres[other] - centres[one], axis=0))
    return steps[0], steps[1]


def _distortion(centres: Array, places: Integers) -> tuple[float, float]:
    """Residual of a plane lattice in perspective, pixels rms, and the ratio of its longest to its shortest
    step.
    """
    import cv2

    homography = (
        cv2.findHomography(places[:, ::-1].astype(np.float64), centres)[0] if len(centres) >= 4 else None
    )
    if homography is None:
        return float("nan"), float("nan")

    def seen(points: Array) -> Array:
        mapped = np.asarray(np.column_stack([points, np.ones(len(points))]) @ homography.T, np.float64)
        return np.asarray(mapped[:, :2] / mapped[:, 2:])

    at = places[:, ::-1].astype(np.float64)
    bend_px = float(np.sqrt(np.mean(np.sum((seen(at) - centres) ** 2, axis=1))))
    areas = np.abs(
        np.linalg.det(
            np.stack(
                [seen(at + [0.5, 0]) - seen(at - [0.5, 0]), seen(at + [0, 0.5]) - seen(at - [0, 0.5])], axis=1
            )
        )
    )
    return bend_px, float(np.sqrt(areas.max() / max(float(areas.min()), 1e-9)))
