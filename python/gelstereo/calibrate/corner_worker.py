"""Corner search in a separate process: OpenCV's search cannot be interrupted, but a process can be terminated.

Reads one JSON request per line from standard input and answers with one JSON line each; see `CornerFinder`.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

#: Half the side of the sub-pixel window, relative to the shortest distance of neighbouring corners. From a quarter on,
#: the window of a tilted board reaches the next corner's edges. Below a tenth it contains too little of its own edges.
WINDOW_SHARE = 0.2


def find_corners(
    image: npt.NDArray[np.uint8], board: tuple[int, int], method: str
) -> npt.NDArray[np.float32] | None:
    """Inner corners (rows * columns, 2) in pixels, row by row, or ``None``; ``method`` is classic or sectors."""
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
    half = int(np.clip(WINDOW_SHARE * shortest_spacing_px(corners, board), 2, 15))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    refined = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), criteria)
    return np.asarray(refined, np.float32).reshape(-1, 2)


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
    cols, rows = request["board"]
    try:
        corners = find_corners(np.asarray(image, np.uint8), (cols, rows), request["method"])
    except cv2.error:  # OpenCV refuses some images instead of finding nothing
        corners = None
    height, width = image.shape[:2]
    return {
        "size_px": [width, height],
        "corners_px": None if corners is None else corners.astype(float).tolist(),
    }


def main() -> None:
    """Serve requests until standard input closes."""
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
