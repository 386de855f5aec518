"""Corner search in a separate process: OpenCV's search cannot be interrupted, but a process can be
terminated.

Reads one JSON request per line from standard input and answers with one JSON line each; see `CornerFinder`.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo.calibrate.boards import determines_pose, families_in, from_request

#: Half the side of the sub-pixel window, relative to the shortest distance of neighbouring corners.
WINDOW_SHARE = 0.2
#: Least and greatest half side of that window, pixels. Half sides of 2 to 7 were tried on drawn boards with
#: squares of 9 to 33 px, blurred by 0.5 and 1 px, with noise of 3 and 8 levels. Corners of noise 3 are off by
#: 0.2 to 0.5 px with 2, 0.07 to 0.10 with 3, and 0.05 to 0.06 with 5, whatever the square.
MIN_HALF_PX, MAX_HALF_PX = 5, 15
#: The floor does not exceed this share of the shortest distance: at 0.7 the window contains the next corner's
#: edges, and corners are off by 0.3 px.
MAX_SHARE = 0.45


def find_corners(
    image: npt.NDArray[np.uint8], board: tuple[int, int], method: str
) -> npt.NDArray[np.float32] | None:
    """Inner corners (rows * columns, 2) in pixels, row by row, or ``None``; ``method`` is classic
    or sectors.
    """
    if min(board) < 2 or min(image.shape) < 8:
        return None
    if method == "sectors":
        found, corners = cv2.findChessboardCornersSB(image, board)
    else:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(image, board, flags=flags)
    if not found or corners is None:
        return None
    corners = np.asarray(corners, np.float32).reshape(-1, 1, 2)
    half = window_half_px(shortest_spacing_px(corners, board))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    refined = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), criteria)
    return np.asarray(refined, np.float32).reshape(-1, 2)


def window_half_px(spacing_px: float) -> int:
    """Half the side of the sub-pixel window for corners at this distance."""
    floor = min(MIN_HALF_PX, max(int(MAX_SHARE * spacing_px), 2))
    return int(np.clip(WINDOW_SHARE * spacing_px, floor, MAX_HALF_PX))


def shortest_spacing_px(corners: npt.NDArray[np.float32], board: tuple[int, int]) -> float:
    """Shortest distance of neighbouring corners."""
    grid = corners.reshape(board[1], board[0], 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
    return float(min(steps))


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Answer one request: the image's size and its corners, each possibly ``None``."""
    image = cv2.imread(request["path"], cv2.IMREAD_GRAYSCALE)
    if image is None:
        return {"size_px": None, "corners_px": None}
    height, width = image.shape[:2]
    if request["method"] == "families":
        return {"size_px": [width, height], "families": families_in(np.asarray(image, np.uint8))}
    try:
        corners = _search(np.asarray(image, np.uint8), request)
    except cv2.error:  # OpenCV refuses some images instead of finding nothing
        corners = None
    return {
        "size_px": [width, height],
        "corners_px": None if corners is None else corners.astype(float).tolist(),
    }


def _search(image: npt.NDArray[np.uint8], request: dict[str, Any]) -> npt.NDArray[Any] | None:
    if request["method"] == "tags":
        corners = from_request(request["board"]).find(image)
        return corners if determines_pose(corners) else None
    cols, rows = request["board"]
    return find_corners(image, (cols, rows), request["method"])


def main() -> None:
    """Serve requests until standard input closes."""
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
