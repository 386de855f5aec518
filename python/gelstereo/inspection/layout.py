"""Layout of a print, with the row and column of every dot and how a plane print would differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import describe_print

__all__ = ["Layout", "LayoutKind", "layout_of"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
LayoutKind = Literal["square", "rectangular", "hexagonal", "irregular"]


@dataclass(frozen=True)
class Layout:
    """What is known of the arrangement of dots."""

    kind: LayoutKind
    #: Mean length of the steps along rows and along columns, pixels; for a hexagonal print, along rows and
    #: to the nearest dot of the next row. For an irregular print, both are the median distance of
    #: neighbours; NaN for fewer than two dots.
    spacing_px: tuple[float, float]
    #: Angle between both steps, degrees; NaN for an irregular print.
    angle_deg: float
    #: Share of the dots that are on the lattice.
    on_lattice: float
    #: Rows and columns that are seen; 0 where none are known, as in an irregular print.
    rows: int
    cols: int
    #: Share of the places of these rows and columns that show a dot.
    filled: float
    #: Share of the places of the upper row, the lower row, the left column and the right column that show a
    #: dot; a border line that is not whole is seen in part.
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
    found = describe_print(centres)
    across_px, down_px = (float(length) for length in np.linalg.norm(found.steps_px, axis=1))
    on = found.places[:, 0] >= 0
    is_known = found.rows > 0
    bend_px, perspective = (
        _distortion(centres[on], _as_printed(found.places[on], found.kind, centres[on]))
        if is_known
        else (float("nan"), float("nan"))
    )
    return Layout(
        found.kind,
        (across_px, down_px),
        found.angle_deg if is_known else float("nan"),
        found.on_lattice,
        found.rows,
        found.cols,
        found.filled,
        found.borders,
        found.places,
        bend_px,
        perspective,
    )


def _as_printed(places: Integers, kind: LayoutKind, centres: Array) -> Array:
    """Where the dots of these rows and columns stand in the print: (N, 2) column and row, in steps."""
    row, col = places.T.astype(np.float64)
    if kind != "hexagonal":
        return np.column_stack([col, row])
    odd = places[:, 0] % 2 == 1
    # Odd rows are shifted half a step forward or back: the shift with which the dots are a plane print.
    shifts = (np.column_stack([col + half * odd, row * np.sqrt(0.75)]) for half in (0.5, -0.5))
    return min(shifts, key=lambda at: _affine_residual(at, centres))


def _affine_residual(printed: Array, centres: Array) -> float:
    terms = np.column_stack([printed, np.ones(len(printed))])
    fitted = terms @ np.linalg.lstsq(terms, centres, rcond=None)[0]
    return float(np.sum((fitted - centres) ** 2))


def _distortion(centres: Array, printed: Array) -> tuple[float, float]:
    """Residual of a plane lattice in perspective, pixels rms, and the ratio of its longest to its shortest
    step.
    """
    import cv2

    homography = cv2.findHomography(printed, centres)[0] if len(centres) >= 4 else None
    if homography is None:
        return float("nan"), float("nan")

    def seen(points: Array) -> Array:
        mapped = np.asarray(np.column_stack([points, np.ones(len(points))]) @ homography.T, np.float64)
        return np.asarray(mapped[:, :2] / mapped[:, 2:])

    bend_px = float(np.sqrt(np.mean(np.sum((seen(printed) - centres) ** 2, axis=1))))
    areas = np.abs(
        np.linalg.det(
            np.stack(
                [
                    seen(printed + [0.5, 0]) - seen(printed - [0.5, 0]),
                    seen(printed + [0, 0.5]) - seen(printed - [0, 0.5]),
                ],
                axis=1,
            )
        )
    )
    return bend_px, float(np.sqrt(areas.max() / max(float(areas.min()), 1e-9)))
