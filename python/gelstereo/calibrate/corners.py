"""Chessboard corners of many images, each search under a time limit."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal

import numpy as np
import numpy.typing as npt

from .boards import TagBoard, to_request
from .errors import CalibrationError, ImageError

__all__ = ["CornerFinder", "Corners", "Method", "neighbouring_boards"]

#: ``classic`` grows quadrilaterals. ``sectors`` (OpenCV's "SB") matches corner templates; it is slower, and
#: can report false corners on a board of another size.
Method = Literal["classic", "sectors"]

_START_LIMIT_S = 60.0
_LONGEST_LIMIT_S = 86400.0


@dataclass(frozen=True)
class Corners:
    """Result of the search in one image."""

    #: Width and height.
    size_px: tuple[int, int]
    #: Corners (N, 2) in the board's order, NaN where not seen, or ``None`` when the board was not found.
    corners_px: npt.NDArray[np.float64] | None
    #: Whether the search was ended at its time limit.
    timed_out: bool = False


class CornerFinder:
    """Searches for boards in a worker process, which is terminated and replaced when a search takes too long.

    Use it as a context manager.
    """

    def __init__(self, time_limit_s: float = 10.0) -> None:
        if not 0.0 < time_limit_s <= _LONGEST_LIMIT_S:
            raise CalibrationError(
                f"time_limit_s is {time_limit_s}; valid is above 0, at most {_LONGEST_LIMIT_S:.0f} s"
            )
        self.time_limit_s = time_limit_s
        self._worker: _Worker | None = None
        self._sizes: dict[Path, tuple[int, int]] = {}

    def __enter__(self) -> CornerFinder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the worker."""
        if self._worker is not None:
            self._worker.end()
            self._worker = None

    def find(self, path: Path, board: tuple[int, int], method: Method = "classic") -> Corners:
        """Search ``board``, inner corners (columns, rows), in one image.

        Raises
        ------
        ImageError
            The file cannot be read as an image, or the search crashed on it.
        """
        return self._find({"path": str(path), "board": board, "method": method}, path)

    def find_tags(self, path: Path, board: TagBoard) -> Corners:
        """Search a board with tags in one image; errors as `find`."""
        return self._find({"path": str(path), "board": to_request(board), "method": "tags"}, path)

    def families(self, path: Path) -> list[str]:
        """Dictionaries of which an image shows markers, the one with most markers first."""
        reply = self._ask({"path": str(path), "method": "families"}, path)
        return list(reply.get("families", [])) if reply is not None else []

    def _ask(self, request: dict[str, Any], path: Path) -> dict[str, Any] | None:
        if self._worker is None:
            self._worker = _Worker()
        try:
            return self._worker.ask(request, self.time_limit_s)
        except (CalibrationError, BrokenPipeError) as error:
            self.close()
            raise ImageError(f"the corner search ended while processing {path}: {error}", path) from error

    def _find(self, request: dict[str, Any], path: Path) -> Corners:
        reply = self._ask(request, path)
        if reply is None:
            self.close()
            return Corners(self._size_px(path), None, timed_out=True)
        if reply["size_px"] is None:
            found = "is not an image that OpenCV can read" if path.is_file() else "does not exist"
            raise ImageError(f"{path} {found}", path)
        width, height = reply["size_px"]
        corners = reply["corners_px"]
        return Corners((width, height), None if corners is None else np.array(corners, np.float64))

    def _size_px(self, path: Path) -> tuple[int, int]:
        import cv2

        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ImageError(
                f"{path} is not an image that OpenCV can read within {self.time_limit_s} s", path
            )
        return int(image.shape[1]), int(image.shape[0])


class _Worker:
    """A worker process, and a thread that reads its answers so that waiting can time out."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "gelstereo.calibrate.corner_worker"]
        # In its own session: Ctrl-C reaches only the calling process, which then ends the worker without
        # output.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            start_new_session=True,
        )
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        assert self._process.stdin is not None and self._process.stdout is not None
        self._stdin: IO[str] = self._process.stdin
        self._thread = threading.Thread(target=self._read, args=(self._process.stdout,), daemon=True)
        self._thread.start()
        # The time limit is for searching, not for importing OpenCV.
        if self._next_line(_START_LIMIT_S) is None:
            self.end()
            raise CalibrationError(f"the corner search did not start within {_START_LIMIT_S:.0f} s")

    def _read(self, stdout: IO[str]) -> None:
        for line in stdout:
            self._lines.put(line)
        self._lines.put("")

    def _next_line(self, limit_s: float) -> str | None:
        try:
            line = self._lines.get(timeout=limit_s)
        except queue.Empty:
            return None
        if not line:
            code = self._process.wait()
            raise CalibrationError(f"the corner search ended unexpectedly (exit code {code}); see its output")
        return line

    def ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any] | None:
        """Return the worker's answer, or ``None`` at the time limit."""
        self._stdin.write(json.dumps(request) + "\n")
        self._stdin.flush()
        line = self._next_line(limit_s)
        if line is None:
            return None
        reply: dict[str, Any] = json.loads(line)
        return reply

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.join()
        with suppress(BrokenPipeError):  # unsent data is no longer needed
            self._stdin.close()
        if self._process.stdout is not None:
            self._process.stdout.close()


def neighbouring_boards(board: tuple[int, int]) -> list[tuple[int, int]]:
    """List board sizes that are easily confused with ``board``, the likeliest first.

    First squares counted instead of corners and the reverse, then one or two rows or columns more or fewer.
    """
    cols, rows = board
    likely = [(-1, -1), (1, 1)]
    steps = range(-2, 3)
    rest = sorted(((a, b) for a in steps for b in steps), key=lambda s: (abs(s[0]) + abs(s[1]), s))
    sizes: list[tuple[int, int]] = []
    seen = {tuple(sorted(board))}  # a board turned by a quarter is the same board
    for a, b in likely + rest:
        size = (cols + a, rows + b)
        key = tuple(sorted(size))
        if min(size) >= 3 and key not in seen:
            seen.add(key)
            sizes.append(size)
    return sizes
