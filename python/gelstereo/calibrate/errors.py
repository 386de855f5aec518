"""Errors of calibration; each states what was found and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gelstereo import Error

__all__ = [
    "BoardNotFoundError",
    "CalibrationError",
    "ImageError",
    "MismatchedPairsError",
    "SwappedViewsError",
    "TooFewPairsError",
    "UndeterminedLayersError",
    "UnpairedImagesError",
]


class CalibrationError(Error):
    """Calibration failed."""


class UnpairedImagesError(CalibrationError):
    """Some left images have no right image, or the other way round.

    Attributes: ``left_only`` and ``right_only``, the files without a partner.
    """

    def __init__(self, message: str, left_only: Sequence[Path], right_only: Sequence[Path]) -> None:
        super().__init__(message)
        self.left_only = tuple(left_only)
        self.right_only = tuple(right_only)


class ImageError(CalibrationError):
    """A file cannot be read as an image, or its size differs from that of its camera's other images.

    Attribute: ``path``.
    """

    def __init__(self, message: str, path: Path) -> None:
        super().__init__(message)
        self.path = path


class BoardNotFoundError(CalibrationError):
    """No image shows the requested board.

    Attributes: ``board``, requested inner corners (columns, rows) or board with tags; ``found``, the size
    found instead in the first images, or ``None``.
    """

    def __init__(self, message: str, board: object, found: tuple[int, int] | None) -> None:
        super().__init__(message)
        self.board = board
        self.found = found


class TooFewPairsError(CalibrationError):
    """Too few pairs show the whole board in both views.

    Attributes: ``usable``, ``minimum``, numbers of pairs.
    """

    def __init__(self, message: str, usable: int, minimum: int) -> None:
        super().__init__(message)
        self.usable = usable
        self.minimum = minimum


class SwappedViewsError(CalibrationError):
    """The files given as left come from the right camera."""


class MismatchedPairsError(CalibrationError):
    """Some pairs contradict all others: taken at different moments, or with their two files exchanged.

    Attributes: ``swapped`` and ``mismatched``, names of the pairs.
    """

    def __init__(self, message: str, swapped: Sequence[str], mismatched: Sequence[str]) -> None:
        super().__init__(message)
        self.swapped = tuple(swapped)
        self.mismatched = tuple(mismatched)


class UndeterminedLayersError(CalibrationError):
    """Frames and priors do not determine all parameters of the layers.

    Attribute: ``combinations``, those that are not determined (`gelstereo.calibrate.layers.Combination`).
    """

    def __init__(self, message: str, combinations: Sequence[object]) -> None:
        super().__init__(message)
        self.combinations = tuple(combinations)
