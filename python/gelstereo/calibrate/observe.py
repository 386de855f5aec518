"""Finds the board in every pair of images, with the same corner numbering in both views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .boards import MIN_CORNERS, TagBoard, determines_pose
from .corners import CornerFinder, Corners, neighbouring_boards
from .errors import BoardNotFoundError, ImageError
from .pairs import ImagePair
from .solve import seen

__all__ = ["Observation", "Progress", "align", "observe", "observe_tags"]

Points = npt.NDArray[np.float64]
#: Called with the steps done, the total steps, and a description of the step.
Progress = Callable[[int, int, str], None]

_HINT_IMAGES = 2


@dataclass(frozen=True)
class Observation:
    """Corners found in one pair."""

    pair: ImagePair
    left: Corners
    right: Corners

    @property
    def problem(self) -> str | None:
        """Reason why the pair cannot be used, or ``None``."""
        reasons = []
        for view, corners in (("left", self.left), ("right", self.right)):
            if corners.timed_out:
                reasons.append(f"{view}: corner search reached its time limit")
            elif corners.corners_px is None:
                reasons.append(f"{view}: board not found")
        return "; ".join(reasons) or self._too_few_shared()

    def _too_few_shared(self) -> str | None:
        left, right = self.left.corners_px, self.right.corners_px
        if left is None or right is None:
            return None
        shared = seen(left, right)
        if determines_pose(np.where(shared[:, None], left, np.nan)):
            return None
        return f"only {int(shared.sum())} corners are seen by both views, or all on one line"


def observe(
    pairs: Sequence[ImagePair], board: tuple[int, int], finder: CornerFinder, progress: Progress
) -> list[Observation]:
    """Find the board, inner corners (columns, rows), in every pair.

    If the classic search fails, the sector search is tried. It is not tried if the classic search finds a
    board of another size, because it would then invent or omit corners.

    Raises
    ------
    ImageError
        A file cannot be read, or the sizes within one camera differ.
    BoardNotFoundError
        No image shows the board. The message states the size found instead, if any.
    """
    paths = [path for pair in pairs for path in (pair.left, pair.right)]
    found: dict[Path, Corners] = {}
    for done, path in enumerate(paths):
        progress(done, len(paths), f"corners of {path.name}")
        found[path] = finder.find(path, board)
    _check_sizes([(pair.left, found[pair.left]) for pair in pairs])
    _check_sizes([(pair.right, found[pair.right]) for pair in pairs])
    missing = [path for path in paths if found[path].corners_px is None and not found[path].timed_out]
    _refuse_other_board(missing, len(paths), board, finder)
    for done, path in enumerate(missing):
        progress(done, len(missing), f"second search in {path.name}")
        found[path] = finder.find(path, board, "sectors")
    if _count(found) == 0:
        timed_out = sum(corners.timed_out for corners in found.values())
        raise BoardNotFoundError(
            _not_found_message(board, len(paths), len(paths), timed_out, None, None), board, None
        )
    return [align(Observation(pair, found[pair.left], found[pair.right]), board) for pair in pairs]


def observe_tags(
    pairs: Sequence[ImagePair], board: TagBoard, finder: CornerFinder, progress: Progress
) -> list[Observation]:
    """Find the corners of a board with tags in every pair; errors as `observe`."""
    paths = [path for pair in pairs for path in (pair.left, pair.right)]
    found: dict[Path, Corners] = {}
    for done, path in enumerate(paths):
        progress(done, len(paths), f"tags of {path.name}")
        found[path] = finder.find_tags(path, board)
    _check_sizes([(pair.left, found[pair.left]) for pair in pairs])
    _check_sizes([(pair.right, found[pair.right]) for pair in pairs])
    if _count(found) == 0:
        shown = [(path, names[0]) for path in paths[:_HINT_IMAGES] if (names := finder.families(path))]
        hint = f"; {shown[0][0].name} shows markers of {shown[0][1]}" if shown else "; no tags are visible"
        raise BoardNotFoundError(
            f"{len(paths)} of {len(paths)} images show fewer than {MIN_CORNERS} corners of the {board}{hint}",
            board,
            None,
        )
    return [Observation(pair, found[pair.left], found[pair.right]) for pair in pairs]


def _count(found: dict[Path, Corners]) -> int:
    return sum(corners.corners_px is not None for corners in found.values())


def _check_sizes(images: Sequence[tuple[Path, Corners]]) -> None:
    first_path, first = images[0]
    for path, corners in images:
        if corners.size_px != first.size_px:
            message = (
                f"{path.name} is {corners.size_px[0]}x{corners.size_px[1]} px but {first_path.name} is "
                f"{first.size_px[0]}x{first.size_px[1]} px; all images of one camera must have the same size"
            )
            raise ImageError(message, path)


def _refuse_other_board(
    missing: Sequence[Path], images: int, board: tuple[int, int], finder: CornerFinder
) -> None:
    """Raise an error if images without the board show one of a similar size.

    A smaller board in a few images is one cut off by the border. A larger board, or any other size in most
    images, is the real one. Searching it for a smaller board would number different parts in different
    images.
    """
    for path in missing[:_HINT_IMAGES]:
        sizes = [
            size for size in neighbouring_boards(board) if finder.find(path, size).corners_px is not None
        ]
        if not sizes:
            continue
        size = max(sizes, key=_corners_of)
        if _corners_of(size) > _corners_of(board) or 2 * len(missing) >= images:
            raise BoardNotFoundError(
                _not_found_message(board, len(missing), images, 0, size, path), board, size
            )


def _corners_of(board: tuple[int, int]) -> int:
    return board[0] * board[1]


def _not_found_message(
    board: tuple[int, int],
    missing: int,
    images: int,
    timed_out: int,
    found: tuple[int, int] | None,
    path: Path | None,
) -> str:
    message = f"{missing} of {images} images show no board with {board[0]}x{board[1]} inner corners"
    if found is not None and path is not None:
        return f"{message}, but {path.name} shows {found[0]}x{found[1]}: try {found[0]}x{found[1]}?"
    if timed_out:
        message += f" ({timed_out} searches reached the time limit: use smaller images or a longer limit)"
    return (
        f"{message}, nor one of a neighbouring size; the whole board with a white margin must be visible, "
        "sharp and evenly lit (count inner corners, not squares)"
    )


def align(observation: Observation, board: tuple[int, int]) -> Observation:
    """Give the right view's corners the left view's numbering.

    A chessboard is symmetric under half a turn (a square one under a quarter), and the search may start at
    either end. The numbering is chosen whose corners are nearest to the left view's, both relative to their
    centroids. It is right if the roll between the views is less than 90 (45) degrees.
    """
    left, right = observation.left.corners_px, observation.right.corners_px
    if left is None or right is None:
        return observation
    cols, rows = board
    grid = right.reshape(rows, cols, 2)
    turns = range(4) if rows == cols else (0, 2)
    candidates = [np.rot90(grid, turn).reshape(-1, 2) for turn in turns]
    best = min(candidates, key=lambda c: float(np.sum((c - c.mean(0) - (left - left.mean(0))) ** 2)))
    return replace(observation, right=replace(observation.right, corners_px=np.ascontiguousarray(best)))
