"""Boards as people write them: ``9x6``, ``charuco:8x6``, ``apriltag:6x4``, and lengths by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from .boards import AprilTagBoard, Board, CharucoBoard, Chessboard
from .errors import CalibrationError

__all__ = ["BoardKind"]


@dataclass(frozen=True)
class BoardKind:
    """Kind of a board, and its columns and rows."""

    #: What a board may need besides.
    OPTIONS: ClassVar = ("square_mm", "marker_mm", "gap_mm", "dictionary")
    _NEEDS: ClassVar = {
        "chessboard": ("square_mm",),
        "charuco": ("square_mm", "marker_mm"),
        "apriltag": ("marker_mm", "gap_mm"),
    }

    kind: str
    size: tuple[int, int]

    @classmethod
    def parse(cls, text: str) -> BoardKind:
        """Of ``9x6`` (inner corners), ``charuco:8x6`` (squares) or ``apriltag:6x4`` (tags).

        Raises
        ------
        CalibrationError
            The text names no board.
        """
        kind, colon, size = text.lower().rpartition(":")
        if kind not in ("charuco", "apriltag") and colon:
            raise CalibrationError(f"{kind!r} is not a kind of board; valid are charuco and apriltag")
        parts = size.split("x")
        if len(parts) != 2 or not all(part.isdigit() for part in parts):
            raise CalibrationError(f"{size!r} is not a board; write inner corners as 9x6")
        return cls(kind or "chessboard", (int(parts[0]), int(parts[1])))

    def board(self, options: Mapping[str, Any], spell: Callable[[str], str] = str) -> Board:
        """The board with these options, of which some may be ``None``; `spell` writes an option in messages.

        Raises
        ------
        CalibrationError
            An option that this kind needs is missing, or one is given that it does not have.
        """
        given: dict[str, Any] = {name: options.get(name) for name in self.OPTIONS}
        for name, value in given.items():
            is_needed = name in self._NEEDS[self.kind]
            if is_needed and value is None:
                raise CalibrationError(f"{spell(name)} is missing; a board of kind {self.kind} needs it")
            if value is not None and not is_needed and (name != "dictionary" or self.kind == "chessboard"):
                raise CalibrationError(f"{spell(name)} is given, but a board of kind {self.kind} has none")
        square_mm, marker_mm, gap_mm, dictionary = (given[name] for name in self.OPTIONS)
        if self.kind == "chessboard":
            return Chessboard(self.size, square_mm)
        if self.kind == "charuco":
            return CharucoBoard(self.size, square_mm, marker_mm, dictionary or "4x4_50")
        return AprilTagBoard(self.size, marker_mm, gap_mm, dictionary or "36h11")
