"""Intrinsics and extrinsics from corners: OpenCV's solvers (Zhang 2000), with residuals and uncertainties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from .errors import CalibrationError

__all__ = ["Mono", "Stereo", "board_points_mm", "board_pose", "project", "solve_mono", "solve_stereo"]

Array = npt.NDArray[np.float64]

_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-9)


@dataclass(frozen=True)
class Mono:
    """Calibration of a single camera."""

    #: Camera matrix (3, 3), pixels.
    matrix: Array
    #: k1, k2, p1, p2, k3.
    distortion: Array
    #: Root mean square distance of corners from their projections, pixels.
    rms_px: float
    #: The same for every image, (images,), pixels.
    per_image_px: Array
    #: Standard deviation of the focal length, from the corners' residuals, pixels.
    focal_sigma_px: float


@dataclass(frozen=True)
class Stereo:
    """Joint calibration of two cameras."""

    left_matrix: Array
    left_distortion: Array
    right_matrix: Array
    right_distortion: Array
    #: Rotation (3, 3) and translation (3,) from left to right camera coordinates, millimetres.
    r_right_left: Array
    t_right_left_mm: Array
    #: Root mean square distance of corners from their projections, both views, pixels.
    rms_px: float
    #: The same for every pair and view, (pairs, 2), pixels.
    per_image_px: Array


def board_points_mm(board: tuple[int, int], square_mm: float) -> Array:
    """Corners of the board in its own frame, (columns * rows, 3), row by row, z = 0."""
    cols, rows = board
    y, x = np.mgrid[0:rows, 0:cols]
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(cols * rows)]) * square_mm


def solve_mono(object_mm: Array, corners_px: Sequence[Array], size_px: tuple[int, int]) -> Mono:
    """Calibrate one camera.

    Raises
    ------
    CalibrationError
        OpenCV finds no solution, or one that is not finite.
    """
    objects = [object_mm.astype(np.float32)] * len(corners_px)
    images = [corners.astype(np.float32).reshape(-1, 1, 2) for corners in corners_px]
    try:
        rms, matrix, distortion, _, _, sigma, _, per_image = cv2.calibrateCameraExtended(
            objects, images, size_px, np.eye(3), np.zeros(5), criteria=_CRITERIA
        )
    except cv2.error as error:
        raise CalibrationError(_no_solution(str(error.err))) from error
    mono = Mono(
        np.asarray(matrix, float),
        np.asarray(distortion, float).ravel()[:5],
        float(rms),
        np.asarray(per_image, float).ravel(),
        float(np.max(np.asarray(sigma, float).ravel()[:2])),
    )
    if not (np.isfinite(mono.matrix).all() and np.isfinite(mono.distortion).all() and np.isfinite(rms)):
        raise CalibrationError(_no_solution("the solution is not finite"))
    return mono


def solve_stereo(
    object_mm: Array,
    left_px: Sequence[Array],
    right_px: Sequence[Array],
    size_px: tuple[int, int],
    left: Mono,
    right: Mono,
    refine_intrinsics: bool,
) -> Stereo:
    """Calibrate the pair from two calibrated cameras.

    With ``refine_intrinsics``, all parameters of both cameras are fitted together. This is the maximum-likelihood
    estimate if corner noise is equal in both views.

    Raises
    ------
    CalibrationError
        OpenCV finds no solution, or one that is not finite.
    """
    objects = [object_mm.astype(np.float32)] * len(left_px)
    images = [[c.astype(np.float32).reshape(-1, 1, 2) for c in view] for view in (left_px, right_px)]
    try:
        result = cv2.stereoCalibrateExtended(
            objects,
            images[0],
            images[1],
            left.matrix.copy(),
            left.distortion.copy(),
            right.matrix.copy(),
            right.distortion.copy(),
            size_px,
            np.eye(3),
            np.zeros(3),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS if refine_intrinsics else cv2.CALIB_FIX_INTRINSIC,
            criteria=_CRITERIA,
        )
    except cv2.error as error:
        raise CalibrationError(_no_solution(str(error.err))) from error
    rms = float(result[0])
    k_left, d_left, k_right, d_right, rotation, translation = (np.asarray(a, np.float64) for a in result[1:7])
    if not all(np.isfinite(a).all() for a in (k_left, d_left, k_right, d_right, rotation, translation, rms)):
        raise CalibrationError(_no_solution("the solution is not finite"))
    return Stereo(
        left_matrix=k_left,
        left_distortion=d_left.ravel()[:5],
        right_matrix=k_right,
        right_distortion=d_right.ravel()[:5],
        r_right_left=rotation,
        t_right_left_mm=translation.ravel(),
        rms_px=rms,
        per_image_px=np.asarray(result[-1], np.float64).reshape(-1, 2),
    )


def board_pose(object_mm: Array, corners_px: Array, matrix: Array, distortion: Array) -> tuple[Array, Array]:
    """Pose of the board in the camera's frame: rotation (3, 3) and translation (3,) in millimetres."""
    found, rotation, translation = cv2.solvePnP(object_mm, corners_px, matrix, distortion)
    if not found:
        raise CalibrationError(
            "no pose of the board explains its corners; check that they do not lie on one line"
        )
    return np.asarray(cv2.Rodrigues(rotation)[0], float), np.asarray(translation, float).ravel()


def project(points_mm: Array, matrix: Array, distortion: Array) -> Array:
    """Pixels (N, 2) of points (N, 3) in the camera's frame."""
    pixels, _ = cv2.projectPoints(points_mm, np.zeros(3), np.zeros(3), matrix, distortion)
    return np.asarray(pixels, float).reshape(-1, 2)


def _no_solution(reason: str) -> str:
    return (
        f"no calibration explains the corners ({reason}); take at least ten pairs with the board tilted in several "
        "directions and in all parts of the image"
    )
