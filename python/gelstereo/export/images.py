"""Compressed images of recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error
from gelstereo.extras import needs

Image = npt.NDArray[np.uint8]


def decoded(data: bytes | memoryview | npt.NDArray[np.uint8]) -> Image:
    """A grey image, (H, W), of a PNG or JPEG file.

    JPEG files are decoded by OpenCV, whose pixels may differ by one level from those that were sensed.

    Raises
    ------
    Error
        If it is no image.
    """
    with needs(__name__):
        import cv2

    file = np.frombuffer(data, dtype=np.uint8)
    image: Any = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE) if file.size else None
    if image is None:
        raise Error("a compressed image of the recording cannot be decoded; it is damaged")
    return np.asarray(image, dtype=np.uint8)


def views_of(image: Image, layout: str) -> tuple[Image, Image]:
    """Split an image of both views, in a layout of `gelstereo.cameras`, into left and right.

    Examples
    --------
    >>> views_of(np.array([[1, 2, 3, 4]], dtype=np.uint8), "side_by_side_swapped")
    (array([[3, 4]], dtype=uint8), array([[1, 2]], dtype=uint8))
    """
    half = image.shape[1] // 2
    first, second = image[:, :half], image[:, half : 2 * half]
    if layout.startswith("interleaved"):
        first, second = image[:, 0::2], image[:, 1::2]
    return (second, first) if layout.endswith("_swapped") else (first, second)
