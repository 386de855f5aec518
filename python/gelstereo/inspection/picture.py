"""A picture of an inspection."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from . import Inspection

__all__ = ["draw_inspection"]

Image = npt.NDArray[np.uint8]

#: Blue, green, red.
_ON_LATTICE, _OFF_LATTICE, _STEP = (80, 190, 60), (60, 60, 220), (200, 150, 60)


def draw_inspection(image: Image, found: Inspection) -> Image:
    """The image in colour, with a ring around each dot and lines along rows and columns.

    Dots on the lattice are green, others red.
    """
    import cv2

    out = np.array(image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    shift, scale = 4, 16

    def fixed(point: npt.NDArray[np.float64]) -> tuple[int, int]:
        return round(float(point[0]) * scale), round(float(point[1]) * scale)

    places = found.layout.places
    at = {(int(row), int(col)): index for index, (row, col) in enumerate(places) if row >= 0}
    for (row, col), index in at.items():
        for neighbour in ((row, col + 1), (row + 1, col)):
            if neighbour in at:
                ends = fixed(found.dots_px[index]), fixed(found.dots_px[at[neighbour]])
                cv2.line(out, *ends, _STEP, 1, cv2.LINE_AA, shift)
    radius = round((0.5 * found.dot_px + 2.0) * scale) if len(found.dots_px) else 0
    for place, dot in zip(places, found.dots_px, strict=True):
        cv2.circle(
            out, fixed(dot), radius, _ON_LATTICE if place[0] >= 0 else _OFF_LATTICE, 1, cv2.LINE_AA, shift
        )
    return out
