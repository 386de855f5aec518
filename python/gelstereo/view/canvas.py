"""Anti-aliased drawing on a supersampled canvas, with coordinates of the finished picture."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

Colour = tuple[int, int, int]
Image = npt.NDArray[np.uint8]

#: Blue, green, red, OpenCV's order.
PAPER: Colour = (252, 251, 250)
INK: Colour = (56, 44, 36)
FAINT: Colour = (160, 150, 142)
RULE: Colour = (226, 221, 217)
SEEN: Colour = (196, 158, 60)
HELD: Colour = (40, 168, 246)
LOST: Colour = (66, 62, 214)
SALIENT: Colour = (30, 104, 240)

_SUPERSAMPLING = 2
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates


class Canvas:
    """An unfinished picture; sizes and positions are pixels of the finished one."""

    def __init__(self, width: int, height: int, paper: Colour = PAPER) -> None:
        with needs(__name__):
            import cv2

        self._cv2: Any = cv2
        self.width, self.height = width, height
        shape = (height * _SUPERSAMPLING, width * _SUPERSAMPLING, 3)
        self._pixels: Image = np.full(shape, paper, dtype=np.uint8)

    def finished(self) -> Image:
        """The picture, (height, width, 3), blue green red."""
        size = (self.width, self.height)
        out: Image = self._cv2.resize(self._pixels, size, interpolation=self._cv2.INTER_AREA)
        return out

    def image(self, picture: Image, x: int, y: int, width: int, height: int) -> None:
        """Draw an image into a rectangle."""
        size = (width * _SUPERSAMPLING, height * _SUPERSAMPLING)
        scaled = self._cv2.resize(picture, size, interpolation=self._cv2.INTER_CUBIC)
        if scaled.ndim == 2:
            scaled = self._cv2.cvtColor(scaled, self._cv2.COLOR_GRAY2BGR)
        top, left = y * _SUPERSAMPLING, x * _SUPERSAMPLING
        self._pixels[top : top + size[1], left : left + size[0]] = scaled

    def circle(self, centre: Iterable[float], radius: float, colour: Colour, width: float = 0.0) -> None:
        """Draw a disc, or a ring of the given line width."""
        thickness = max(1, round(width * _SUPERSAMPLING)) if width > 0 else -1
        # OpenCV also fills the pixels on the circle, half a pixel too far out.
        outline = radius * _SUPERSAMPLING - (0.0 if width > 0 else 0.5)
        self._cv2.circle(
            self._pixels,
            self._fixed(centre),
            round(outline * (1 << _SHIFT)),
            colour,
            thickness,
            self._cv2.LINE_AA,
            _SHIFT,
        )

    def line(self, start: Iterable[float], end: Iterable[float], colour: Colour, width: float = 1.0) -> None:
        """Draw a straight line."""
        thickness = max(1, round(width * _SUPERSAMPLING))
        self._cv2.line(
            self._pixels, self._fixed(start), self._fixed(end), colour, thickness, self._cv2.LINE_AA, _SHIFT
        )

    def arrow(self, start: npt.NDArray[np.float64], end: npt.NDArray[np.float64], colour: Colour) -> None:
        """Draw a line with a small head; an arrow too short to show a direction is left out."""
        along = end - start
        length = float(np.hypot(*along))
        if length < 1.5:
            return
        head = min(7.0, 0.6 * length) * along / length
        self.line(start, end - 0.8 * head, colour, 1.2)
        side = np.array([-head[1], head[0]]) * 0.45
        self.polygon(np.stack([end, end - head + side, end - head - side]), colour)

    def polygon(self, corners: npt.NDArray[np.float64], colour: Colour) -> None:
        """Draw a filled convex polygon."""
        fixed = np.round(corners * (_SUPERSAMPLING << _SHIFT)).astype(np.int32)
        self._cv2.fillConvexPoly(self._pixels, fixed, colour, self._cv2.LINE_AA, _SHIFT)

    def text(
        self, text: str, x: float, y: float, size: float = 14.0, colour: Colour = INK, bold: bool = False
    ) -> None:
        """Draw text whose baseline starts at (x, y); `size` is 1.5 times the height of a capital."""
        font = self._cv2.FONT_HERSHEY_DUPLEX if bold else self._cv2.FONT_HERSHEY_SIMPLEX
        origin = (round(x * _SUPERSAMPLING), round(y * _SUPERSAMPLING))
        scale = size * _SUPERSAMPLING / 31.0
        self._cv2.putText(
            self._pixels, text, origin, font, scale, colour, _SUPERSAMPLING - 1 + int(bold), self._cv2.LINE_AA
        )

    def blend(self, other: Canvas, opacity: float, background: Colour) -> None:
        """Copy everything drawn on `other` (all pixels that differ from its background) onto this canvas."""
        drawn = np.any(other._pixels != np.array(background, dtype=np.uint8), axis=2)
        mixed = self._cv2.addWeighted(other._pixels, opacity, self._pixels, 1.0 - opacity, 0.0)
        self._pixels[drawn] = mixed[drawn]

    def _fixed(self, point: Iterable[float]) -> tuple[int, int]:
        # OpenCV's pixel centres have integer coordinates.
        x, y = (round(((v + 0.5) * _SUPERSAMPLING - 0.5) * (1 << _SHIFT)) for v in point)
        return x, y
