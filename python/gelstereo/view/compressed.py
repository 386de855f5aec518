"""Compressed images of recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error

Image = npt.NDArray[np.uint8]

_SIDE_BY_SIDE = ("side_by_side", "side_by_side_swapped")


def decoded(data: bytes | memoryview | npt.NDArray[np.uint8]) -> Image:
    """A grey image, (H, W), of a PNG or JPEG file.

    Pixels of a JPEG file are OpenCV's: good for pictures, and a level off here and there from what was sensed.

    Raises
    ------
    Error
        If it is no image.
    """
    import cv2

    image: Any = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise Error("a compressed image of the recording cannot be decoded; it is damaged")
    return np.asarray(image, dtype=np.uint8)


def views_of(image: Image, layout: str) -> tuple[Image, Image]:
    """Left and right view of an image of both.

    Examples
    --------
    >>> views_of(np.array([[1, 2, 3, 4]], dtype=np.uint8), "side_by_side_swapped")
    (array([[3, 4]], dtype=uint8), array([[1, 2]], dtype=uint8))

    Raises
    ------
    Error
        If a compressed image cannot hold two views in this layout.
    """
    if layout not in _SIDE_BY_SIDE:
        raise Error(f"a compressed image has the layout {layout!r}; valid is one of {_SIDE_BY_SIDE}")
    half = image.shape[1] // 2
    first, second = image[:, :half], image[:, half : 2 * half]
    return (first, second) if layout == "side_by_side" else (second, first)
