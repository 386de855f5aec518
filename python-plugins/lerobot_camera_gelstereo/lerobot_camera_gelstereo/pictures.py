"""What LeRobot gets to see of a stereo frame: (height, width, 3) uint8, red green blue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import gelstereo as gs
from gelstereo.live import LiveFrame

Picture = NDArray[np.uint8]


def left_picture(frame: LiveFrame) -> Picture:
    """The left image, grey in all three colours."""
    return _grey(frame.left)


def pair_picture(frame: LiveFrame) -> Picture:
    """Left and right image side by side."""
    return _grey(np.hstack([frame.left, frame.right]))


def _grey(image: Picture) -> Picture:
    return np.repeat(image[:, :, None], 3, axis=2)


class MotionPicture:
    """How markers moved since the first frame; frames whose markers are not found raise `gelstereo.Error`."""

    def __init__(
        self, rig: gs.Rig, params: gs.Params, full_scale_mm: float, size: tuple[int, int] | None = None
    ) -> None:
        self._pipeline = gs.Pipeline(rig, params)
        self._full_scale_mm = full_scale_mm
        self._size = size or rig.size_px
        self._rest_mm: NDArray[np.float64] | None = None

    def __call__(self, frame: LiveFrame) -> Picture:
        """The picture of a frame, of the size (width, height) asked for, or of the images."""
        sensed = self._pipeline.process(frame.left, frame.right)
        if self._rest_mm is None:
            self._rest_mm = sensed.points_mm
        moved_mm = sensed.points_mm - self._rest_mm
        return displacement_picture(moved_mm, (sensed.rows, sensed.cols), self._full_scale_mm, self._size)


def displacement_picture(
    displacement_mm: NDArray[np.float64],
    lattice: tuple[int, int],
    full_scale_mm: float,
    size: tuple[int, int],
) -> Picture:
    """Displacements as colours.

    Parameters
    ----------
    displacement_mm : (rows * cols, 3)
        Sensor frame.
    lattice
        (rows, cols).
    full_scale_mm
        It is 127 levels from 128; more is cut off.
    size
        (width, height) of the picture, pixels. Cells are not blended, so that a value can be read back.
    """
    levels = np.rint(128.0 + 127.0 * np.clip(displacement_mm / full_scale_mm, -1.0, 1.0)).astype(np.uint8)
    rows, cols = lattice
    width, height = size
    cells = levels.reshape(rows, cols, 3)
    row = np.minimum(np.arange(height) * rows // height, rows - 1)
    col = np.minimum(np.arange(width) * cols // width, cols - 1)
    return cells[row[:, None], col[None, :]]
