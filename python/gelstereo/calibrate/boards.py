"""Boards whose corners have known places: chessboards, ChArUco boards and grids of AprilTags.

The corners of boards with tags carry numbers, so such a board may reach beyond the image. A corner that is
not seen is NaN in every array of corners.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

from .errors import CalibrationError

with needs(__name__):
    import cv2

__all__ = ["AprilTagBoard", "Board", "CharucoBoard", "Chessboard", "TagBoard", "board_of"]

Array = npt.NDArray[np.float64]

#: Fewest corners from which a pose of the board is found. Four determine one; two more show a false one.
MIN_CORNERS = 6
#: Corners on one line determine no pose: their narrower spread must be at least this share of the wider one.
_MIN_SPREAD = 0.05
#: OpenCV's AprilTag refinement has the corner of the first pixel at (0, 0); here its centre is.
_APRILTAG_OFFSET_PX = 0.5


@dataclass(frozen=True)
class Chessboard:
    """A chessboard; the whole of it must be visible."""

    #: Inner corners (columns, rows); a board of 10x7 squares has 9x6.
    corners: tuple[int, int]
    square_mm: float

    def __post_init__(self) -> None:
        if min(self.corners) < 3:
            raise CalibrationError(
                f"board is {self.corners[0]}x{self.corners[1]}; valid is at least 3x3 inner corners"
            )
        _check_length("square_mm", self.square_mm)

    def __str__(self) -> str:
        return f"board {self.corners[0]}x{self.corners[1]}, squares {self.square_mm:g} mm"

    @property
    def side_mm(self) -> float:
        """Distance of the corners that `edges` joins."""
        return self.square_mm

    def points_mm(self) -> Array:
        """Corners in the board's frame, (N, 3), row by row, z = 0."""
        return _grid_mm(self.corners, self.square_mm)

    def edges(self) -> npt.NDArray[np.int64]:
        """Indices of neighbouring corners, (M, 2)."""
        return _grid_edges(self.corners)


@dataclass(frozen=True)
class CharucoBoard:
    """A ChArUco board of OpenCV: a chessboard with a marker in each of its white squares."""

    #: Squares (columns, rows), as OpenCV counts them: not the inner corners.
    squares: tuple[int, int]
    square_mm: float
    #: Side of a marker, mm.
    marker_mm: float
    #: Dictionary of the markers: ``"4x4_50"``, ``"5x5_100"``, ``"apriltag_36h11"`` and so on.
    dictionary: str = "4x4_50"

    def __post_init__(self) -> None:
        if min(self.squares) < 3:
            raise CalibrationError(f"squares is {self.squares[0]}x{self.squares[1]}; valid is at least 3x3")
        _check_length("square_mm", self.square_mm)
        _check_length("marker_mm", self.marker_mm)
        if not self.marker_mm < self.square_mm:
            raise CalibrationError(
                f"marker_mm is {self.marker_mm}; valid is below square_mm, {self.square_mm} mm"
            )
        _check_tags(self.dictionary, self.squares[0] * self.squares[1] // 2)

    def __str__(self) -> str:
        cols, rows = self.squares
        return f"ChArUco board of {cols}x{rows} squares of {self.square_mm:g} mm, markers {self.dictionary}"

    @property
    def side_mm(self) -> float:
        """Distance of the corners that `edges` joins."""
        return self.square_mm

    @property
    def _corners(self) -> tuple[int, int]:
        return self.squares[0] - 1, self.squares[1] - 1

    def points_mm(self) -> Array:
        """Inner corners in the board's frame, (N, 3), row by row, z = 0."""
        return _grid_mm(self._corners, self.square_mm)

    def edges(self) -> npt.NDArray[np.int64]:
        """Indices of neighbouring corners, (M, 2)."""
        return _grid_edges(self._corners)

    def find(self, image: npt.NDArray[np.uint8]) -> Array:
        """Corners (N, 2) in an image, NaN where not seen."""
        found = np.full((self._corners[0] * self._corners[1], 2), np.nan)
        # Boards with an even number of rows had another first square before OpenCV 4.6, and still have it
        # elsewhere.
        for legacy in (False, True):
            board = cv2.aruco.CharucoBoard(
                self.squares, self.square_mm, self.marker_mm, _dictionary(self.dictionary)
            )
            board.setLegacyPattern(legacy)
            corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
            if numbers is not None and len(numbers) > np.isfinite(found[:, 0]).sum():
                found[:] = np.nan
                found[np.ravel(numbers)] = np.reshape(corners, (-1, 2))
        return found


@dataclass(frozen=True)
class AprilTagBoard:
    """A grid of AprilTags, numbered row by row from the upper left, as OpenCV's GridBoard draws it."""

    #: Tags (columns, rows).
    tags: tuple[int, int]
    #: Side of a tag's black square, mm.
    tag_mm: float
    #: Distance between the black squares of neighbouring tags, mm.
    gap_mm: float
    #: ``"16h5"``, ``"25h9"``, ``"36h10"`` or ``"36h11"``.
    family: str = "36h11"
    #: Number of the upper left tag.
    first_id: int = 0

    def __post_init__(self) -> None:
        if min(self.tags) < 1 or self.tags[0] * self.tags[1] < 2:
            raise CalibrationError(f"tags is {self.tags[0]}x{self.tags[1]}; valid is two tags or more")
        _check_length("tag_mm", self.tag_mm)
        _check_length("gap_mm", self.gap_mm)
        _check_tags(f"apriltag_{self.family}", self.tags[0] * self.tags[1] + self.first_id)

    def __str__(self) -> str:
        return f"{self.tags[0]}x{self.tags[1]} AprilTags {self.family} of {self.tag_mm:g} mm"

    @property
    def side_mm(self) -> float:
        """Distance of the corners that `edges` joins."""
        return self.tag_mm

    def points_mm(self) -> Array:
        """Corners in the board's frame, (N, 3), tag by tag, clockwise from the upper left, z = 0."""
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float) * self.tag_mm
        return np.asarray(
            (_grid_mm(self.tags, self.tag_mm + self.gap_mm)[:, None] + corners).reshape(-1, 3), np.float64
        )

    def edges(self) -> npt.NDArray[np.int64]:
        """Indices of both corners of every side of a tag, (M, 2)."""
        side = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
        return np.concatenate([side + 4 * tag for tag in range(self.tags[0] * self.tags[1])])

    def find(self, image: npt.NDArray[np.uint8]) -> Array:
        """Corners (N, 2) in an image, NaN where not seen."""
        count = self.tags[0] * self.tags[1]
        found = np.full((count, 4, 2), np.nan)
        settings = cv2.aruco.DetectorParameters()
        # Lines fitted to the sides. The sub-pixel window, made for saddles, places the corner of a square
        # inside it: by 0.25 px on drawn boards.
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
        detector = cv2.aruco.ArucoDetector(_dictionary(f"apriltag_{self.family}"), settings)
        corners, numbers, _ = detector.detectMarkers(image)
        for number, quad in zip(np.ravel(numbers) if numbers is not None else (), corners, strict=True):
            if 0 <= number - self.first_id < count:
                found[number - self.first_id] = np.reshape(quad, (4, 2)) - _APRILTAG_OFFSET_PX
        return found.reshape(-1, 2)


TagBoard: TypeAlias = "CharucoBoard | AprilTagBoard"
Board: TypeAlias = "Chessboard | CharucoBoard | AprilTagBoard"


def board_of(board: tuple[int, int] | Board, square_mm: float | None) -> Board:
    """The board of both arguments: inner corners and the side of a square, or a board that states its
    lengths.
    """
    if isinstance(board, tuple):
        if square_mm is None:
            raise CalibrationError(
                "square_mm is missing; valid is the side of a square of the chessboard, mm"
            )
        return Chessboard(board, square_mm)
    if square_mm is not None:
        raise CalibrationError(f"square_mm is {square_mm}, but {type(board).__name__} states its own lengths")
    return board


def to_request(board: TagBoard) -> dict[str, Any]:
    """The board as a dictionary that JSON can hold."""
    return {"kind": type(board).__name__, **asdict(board)}


def from_request(request: dict[str, Any]) -> TagBoard:
    """The board of `to_request`."""
    values: dict[str, Any] = {
        key: tuple(v) if isinstance(v, list) else v for key, v in request.items() if key != "kind"
    }
    return CharucoBoard(**values) if request["kind"] == "CharucoBoard" else AprilTagBoard(**values)


def families_in(image: npt.NDArray[np.uint8]) -> list[str]:
    """Dictionaries of which an image shows markers, the one with most markers first."""
    counts: dict[str, int] = {}
    for name, value in _dictionaries().items():
        # A dictionary of fewer markers is the beginning of the largest of its size.
        if name.endswith(("_50", "_100", "_250")):
            continue
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(value))
        numbers = detector.detectMarkers(image)[1]
        # One marker may be a chance pattern.
        if numbers is not None and len(numbers) >= 2:
            counts[name.replace("_1000", f"_{_smallest(int(np.max(numbers)))}")] = len(numbers)
    return sorted(counts, key=lambda name: -counts[name])


def _smallest(number: int) -> int:
    return next(size for size in (50, 100, 250, 1000) if number < size)


def determines_pose(corners_px: Array) -> bool:
    """Whether enough corners are seen, and not all on one line."""
    seen = corners_px[np.isfinite(corners_px[:, 0])]
    if len(seen) < MIN_CORNERS:
        return False
    wide, narrow = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
    return bool(narrow > _MIN_SPREAD * wide)


def _grid_mm(size: tuple[int, int], step_mm: float) -> Array:
    cols, rows = size
    y, x = np.mgrid[0:rows, 0:cols]
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(cols * rows)]) * step_mm


def _grid_edges(size: tuple[int, int]) -> npt.NDArray[np.int64]:
    at = np.arange(size[0] * size[1]).reshape(size[1], size[0])
    across = np.column_stack([at[:, :-1].ravel(), at[:, 1:].ravel()])
    return np.concatenate([across, np.column_stack([at[:-1].ravel(), at[1:].ravel()])])


def _check_length(name: str, value_mm: float) -> None:
    if not (value_mm > 0.0 and np.isfinite(value_mm)):
        raise CalibrationError(f"{name} is {value_mm}; valid is a finite length above 0 mm")


def _dictionaries() -> dict[str, int]:
    """OpenCV's dictionaries by their names here: ``4x4_50``, ``apriltag_36h11``."""
    names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    return {name.removeprefix("DICT_").lower(): getattr(cv2.aruco, name) for name in names}


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(_dictionaries()[name.lower()])


def _check_tags(dictionary: str, needed: int) -> None:
    known = _dictionaries()
    if dictionary.lower() not in known:
        raise CalibrationError(
            f"the dictionary is {dictionary!r}; valid is one of {', '.join(sorted(known))}"
        )
    has = len(_dictionary(dictionary).bytesList)
    if needed > has:
        raise CalibrationError(f"the board has {needed} tags; {dictionary} has {has}")
