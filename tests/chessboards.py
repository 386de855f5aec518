"""Chessboards whose truth is known: corners by projection, images by drawing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo.calibrate import Chessboard

Array = npt.NDArray[np.float64]

BOARD = (9, 6)
SQUARE_MM = 2.0
SIZE_PX = (640, 480)


@dataclass(frozen=True)
class TrueRig:
    """The rig that the synthetic corners come from."""

    left_matrix: Array
    right_matrix: Array
    left_distortion: Array
    right_distortion: Array
    r_right_left: Array
    t_right_left_mm: Array

    @classmethod
    def typical(cls) -> TrueRig:
        """Like the simulated sensor's cameras, but verged and distorted."""
        return cls(
            np.array([[560.0, 0.0, 322.0], [0.0, 561.0, 241.0], [0.0, 0.0, 1.0]]),
            np.array([[563.0, 0.0, 318.0], [0.0, 563.5, 238.0], [0.0, 0.0, 1.0]]),
            np.array([-0.12, 0.05, 4e-4, -3e-4, 0.0]),
            np.array([-0.11, 0.04, -2e-4, 5e-4, 0.0]),
            np.asarray(cv2.Rodrigues(np.array([0.004, -0.05, 0.01]))[0], float),
            np.array([-8.0, 0.05, 0.2]),
        )

    def views(self, rotation: Array, translation_mm: Array, points_mm: Array) -> tuple[Array, Array]:
        """Pixels of board points in both views."""
        in_left = points_mm @ rotation.T + translation_mm
        in_right = in_left @ self.r_right_left.T + self.t_right_left_mm
        left = cv2.projectPoints(in_left, np.zeros(3), np.zeros(3), self.left_matrix, self.left_distortion)[0]
        right = cv2.projectPoints(
            in_right, np.zeros(3), np.zeros(3), self.right_matrix, self.right_distortion
        )[0]
        return np.asarray(left, float).reshape(-1, 2), np.asarray(right, float).reshape(-1, 2)


def board_poses(count: int, seed: int = 1, tilt_rad: float = 0.5) -> list[tuple[Array, Array]]:
    """Poses of the board before the rig, tilted to all sides, the whole board in both views."""
    random = np.random.default_rng(seed)
    centre_mm = Chessboard(BOARD, SQUARE_MM).points_mm().mean(axis=0)
    poses = []
    for _ in range(count):
        turn = np.append(random.uniform(-tilt_rad, tilt_rad, 2), random.uniform(-0.3, 0.3))
        rotation = np.asarray(cv2.Rodrigues(turn)[0], float)
        where = np.array([random.uniform(0.0, 6.0), random.uniform(-3.0, 3.0), random.uniform(29.0, 36.0)])
        poses.append((rotation, where - rotation @ centre_mm))
    return poses


def corner_views(
    rig: TrueRig, poses: list[tuple[Array, Array]], noise_px: float, seed: int = 2
) -> tuple[list[Array], list[Array]]:
    """Corners of all poses in both views, with Gaussian noise."""
    random = np.random.default_rng(seed)
    points_mm = Chessboard(BOARD, SQUARE_MM).points_mm()
    views: tuple[list[Array], list[Array]] = ([], [])
    for rotation, translation_mm in poses:
        for view, exact in zip(views, rig.views(rotation, translation_mm, points_mm), strict=True):
            view.append(exact + random.normal(0.0, noise_px, exact.shape))
    return views


def draw_pair(
    rig: TrueRig, pose: tuple[Array, Array], board: tuple[int, int] = BOARD
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Images of a board in both views; the squares have straight edges, so use it where a hundredth of a
    pixel in the lens distortion does not matter."""
    cols, rows = board
    images = []
    for view in range(2):
        scale = 4  # drawn larger and averaged: smooth edges
        image = np.full((SIZE_PX[1] * scale, SIZE_PX[0] * scale), 215, np.uint8)
        for row in range(-1, rows):
            for col in range(-1, cols):
                if (row + col) % 2 == 0:
                    continue
                corners = np.array(
                    [[col, row, 0], [col + 1, row, 0], [col + 1, row + 1, 0], [col, row + 1, 0]]
                )
                pixels = rig.views(*pose, corners * SQUARE_MM)[view]
                fixed = np.round(((pixels + 0.5) * scale - 0.5) * 256).astype(np.int32)
                cv2.fillConvexPoly(image, fixed, (40,), lineType=cv2.LINE_AA, shift=8)
        small = cv2.resize(image, SIZE_PX, interpolation=cv2.INTER_AREA)
        images.append(np.asarray(cv2.GaussianBlur(small, (3, 3), 0.7), np.uint8))
    return images[0], images[1]


def write_pairs(folder: Path, rig: TrueRig, count: int) -> tuple[list[Path], list[Path]]:
    """Draws pairs into a folder: left01.png, right01.png and so on."""
    left, right = [], []
    for index, pose in enumerate(board_poses(count), start=1):
        images = draw_pair(rig, pose)
        for paths, view, image in zip((left, right), ("left", "right"), images, strict=True):
            paths.append(folder / f"{view}{index:02}.png")
            cv2.imwrite(str(paths[-1]), image)
    return left, right
