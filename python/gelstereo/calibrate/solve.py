"""Intrinsics and extrinsics from corners: OpenCV's solvers (Zhang 2000), with residuals and uncertainties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

from .errors import CalibrationError

with needs(__name__):
    import cv2

__all__ = ["Mono", "Stereo", "board_pose", "project", "seen", "solve_mono", "solve_stereo"]

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


def seen(*views_px: Array) -> npt.NDArray[np.bool_]:
    """Corners that all of these views see; the others are NaN."""
    return np.asarray(np.all([np.isfinite(view).all(axis=1) for view in views_px], axis=0))


def solve_mono(object_mm: Array, corners_px: Sequence[Array], size_px: tuple[int, int]) -> Mono:
    """Calibrate one camera.

    Raises
    ------
    CalibrationError
        OpenCV finds no solution, or one that is not finite.
    """
    masks = [seen(corners) for corners in corners_px]
    objects = [object_mm[mask].astype(np.float32) for mask in masks]
    images = [_for_opencv(corners[mask]) for corners, mask in zip(corners_px, masks, strict=True)]
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

    With ``refine_intrinsics``, all parameters of both cameras are fitted together. This is the
    maximum-likelihood estimate if corner noise is equal in both views.

    Raises
    ------
    CalibrationError
        OpenCV finds no solution, or one that is not finite.
    """
    masks = [seen(a, b) for a, b in zip(left_px, right_px, strict=True)]
    objects = [object_mm[mask].astype(np.float32) for mask in masks]
    images = [
        [_for_opencv(c[mask]) for c, mask in zip(view, masks, strict=True)] for view in (left_px, right_px)
    ]
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
    mask = seen(corners_px)
    found, rotation, translation = cv2.solvePnP(object_mm[mask], corners_px[mask], matrix, distortion)
    if not found:
        raise CalibrationError(
            "no pose of the board explains its corners; check that they do not lie on one line"
        )
    return np.asarray(cv2.Rodrigues(rotation)[0], float), np.asarray(translation, float).ravel()


def project(points_mm: Array, matrix: Array, distortion: Array) -> Array:
    """Pixels (N, 2) of points (N, 3) in the camera's frame."""
    pixels, _ = cv2.projectPoints(points_mm, np.zeros(3), np.zeros(3), matrix, distortion)
    return np.asarray(pixels, float).reshape(-1, 2)


def _for_opencv(corners_px: Array) -> npt.NDArray[np.float32]:
    return corners_px.astype(np.float32).reshape(-1, 1, 2)


def _no_solution(reason: str) -> str:
    return (
        f"no calibration explains the corners ({reason}); take at least ten pairs with the board tilted in "
        "several directions and in all parts of the image"
    )
