"""Consistency checks between pairs, and hints on missing coverage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .boards import Board
from .errors import MismatchedPairsError, SwappedViewsError
from .report import HeldOut
from .solve import Mono, Stereo, board_pose, project, seen, solve_mono, solve_stereo

__all__ = ["coverage_hints", "held_out_errors", "outlying", "refuse_contradictions"]

Array = npt.NDArray[np.float64]

#: A pair contradicts the others if the rig from the other pairs misses its corners by this factor over the
#: usual error, and by at least this many pixels. Usual errors are below a few pixels. A pair from different
#: moments is off by tens of pixels.
_CONTRADICTION_RATIO = 10.0
_CONTRADICTION_PX = 5.0
#: An image is an outlier when its error exceeds this many times its view's median.
_OUTLIER_RATIO = 2.5
_FOLDS = 4
_MIN_TILT_SPREAD_RAD = np.deg2rad(15.0)
_MIN_PAIRS_ADVISED = 10
_CELLS = 3
#: The paper's calibration through gel has 0.64 px.
_POOR_RMS_PX = 1.0


def refuse_contradictions(
    object_mm: Array,
    left_px: Sequence[Array],
    right_px: Sequence[Array],
    left: Mono,
    right: Mono,
    names: Sequence[str],
) -> None:
    """Refuse swapped views, swapped pairs, and pairs whose two images show different moments.

    The two board poses of a pair determine the pose of the right camera. The pose that explains most pairs is
    taken as the rig's. Every pair is compared with it.
    """
    poses = [_relative_pose(object_mm, a, b, left, right) for a, b in zip(left_px, right_px, strict=True)]
    boards = [board_pose(object_mm, corners, left.matrix, left.distortion) for corners in left_px]
    errors = np.array(
        [
            [
                _transfer_px(object_mm, at, corners, pose, right)
                for at, corners in zip(boards, right_px, strict=True)
            ]
            for pose in poses
        ]
    )
    consensus = poses[int(np.argmin(np.median(errors, axis=1)))]
    found = errors[int(np.argmin(np.median(errors, axis=1)))]
    _refuse_swapped_views(consensus)
    limit = max(_CONTRADICTION_PX, _CONTRADICTION_RATIO * float(np.median(found)))
    wrong = [index for index in range(len(names)) if found[index] > limit]
    swapped = []
    for index in wrong:
        board = board_pose(object_mm, right_px[index], left.matrix, left.distortion)
        if _transfer_px(object_mm, board, left_px[index], consensus, right) <= limit:
            swapped.append(index)
    mismatched = [index for index in wrong if index not in swapped]
    if wrong:
        parts = []
        if swapped:
            parts.append(f"left and right are exchanged in {', '.join(names[i] for i in swapped)}")
        if mismatched:
            listed = ", ".join(f"{names[i]} ({found[i]:.0f} px off)" for i in mismatched)
            parts.append(f"the two images were not taken at the same moment in {listed}")
        message = "; ".join(parts) + "; correct or remove these pairs"
        raise MismatchedPairsError(message, [names[i] for i in swapped], [names[i] for i in mismatched])


def _relative_pose(
    object_mm: Array, left_px: Array, right_px: Array, left: Mono, right: Mono
) -> tuple[Array, Array]:
    r_left, t_left = board_pose(object_mm, left_px, left.matrix, left.distortion)
    r_right, t_right = board_pose(object_mm, right_px, right.matrix, right.distortion)
    rotation = r_right @ r_left.T
    return rotation, t_right - rotation @ t_left


def _transfer_px(
    object_mm: Array, board: tuple[Array, Array], right_px: Array, pose: tuple[Array, Array], right: Mono
) -> float:
    """Rms distance of the right view's corners from the projection of the board located in the left view."""
    mask = seen(right_px)
    in_left = object_mm[mask] @ board[0].T + board[1]
    in_right = in_left @ pose[0].T + pose[1]
    if in_right[:, 2].min() <= 0.0:
        return 1e6  # behind the camera: a large finite error, so that it stays comparable
    difference = project(in_right, right.matrix, right.distortion) - right_px[mask]
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def _refuse_swapped_views(pose: tuple[Array, Array]) -> None:
    right_camera_mm = -pose[0].T @ pose[1]
    if right_camera_mm[0] < -0.5 * np.linalg.norm(right_camera_mm):
        x, y, z = right_camera_mm
        raise SwappedViewsError(
            f"according to the images, the right camera is at ({x:.2f}, {y:.2f}, {z:.2f}) mm in the left "
            "camera's frame, which is to its left; exchange the left and the right images, whatever their "
            "names say (cameras that are mounted upside down see each other exchanged)"
        )


def outlying(per_image_px: Array) -> npt.NDArray[np.bool_]:
    """Outlier mask (pairs, 2): images whose error exceeds the others of their view."""
    stands_out = per_image_px > _OUTLIER_RATIO * np.median(per_image_px, axis=0)
    return np.asarray(stands_out.any(axis=1))


def held_out_errors(
    left_px: Sequence[Array],
    right_px: Sequence[Array],
    size_px: tuple[int, int],
    board: Board,
    refine_intrinsics: bool,
) -> HeldOut | None:
    """Errors of a four-fold cross-validation over pairs, or ``None`` with fewer than eight pairs."""
    count, object_mm = len(left_px), board.points_mm()
    if count < 2 * _FOLDS:
        return None
    squared_px: list[float] = []
    sides_mm: list[Array] = []
    for fold in range(_FOLDS):
        kept = [i for i in range(count) if i % _FOLDS != fold]
        lefts, rights = [left_px[i] for i in kept], [right_px[i] for i in kept]
        left, right = solve_mono(object_mm, lefts, size_px), solve_mono(object_mm, rights, size_px)
        stereo = solve_stereo(object_mm, lefts, rights, size_px, left, right, refine_intrinsics)
        pose = (stereo.r_right_left, stereo.t_right_left_mm)
        view = Mono(stereo.right_matrix, stereo.right_distortion, 0.0, np.zeros(0), 0.0)
        for i in range(fold, count, _FOLDS):
            located = board_pose(object_mm, left_px[i], stereo.left_matrix, stereo.left_distortion)
            squared_px.append(_transfer_px(object_mm, located, right_px[i], pose, view) ** 2)
            sides_mm.append(_sides_mm(_triangulate(left_px[i], right_px[i], stereo), board))
    error_mm = np.concatenate(sides_mm) - board.side_mm
    return HeldOut(
        transfer_px=float(np.sqrt(np.mean(squared_px))),
        square_mm=float(np.sqrt(np.mean(error_mm**2))),
        square_bias_mm=float(np.mean(error_mm)),
    )


def _triangulate(left_px: Array, right_px: Array, stereo: Stereo) -> Array:
    """Points (N, 3) in the left camera's frame: linear triangulation of undistorted rays; NaN
    where not seen.
    """
    import cv2

    mask = seen(left_px, right_px)
    left = cv2.undistortPoints(left_px[mask].reshape(-1, 1, 2), stereo.left_matrix, stereo.left_distortion)
    right = cv2.undistortPoints(
        right_px[mask].reshape(-1, 1, 2), stereo.right_matrix, stereo.right_distortion
    )
    projection = np.column_stack([stereo.r_right_left, stereo.t_right_left_mm])
    points = cv2.triangulatePoints(np.eye(3, 4), projection, left.reshape(-1, 2).T, right.reshape(-1, 2).T)
    found = np.full((len(left_px), 3), np.nan)
    found[mask] = (points[:3] / points[3]).T
    return found


def _sides_mm(points_mm: Array, board: Board) -> Array:
    """Distances of neighbouring corners of which both were seen."""
    one, other = board.edges().T
    sides = np.linalg.norm(points_mm[one] - points_mm[other], axis=-1)
    return np.asarray(sides[np.isfinite(sides)])


def coverage_hints(
    object_mm: Array,
    left_px: Sequence[Array],
    right_px: Sequence[Array],
    size_px: tuple[int, int],
    left: Mono,
    right: Mono,
    rms_px: float,
) -> list[str]:
    """Report missing coverage: parts of the images, tilts of the board, uncertain focal lengths."""
    hints = []
    if rms_px > _POOR_RMS_PX:
        hints.append(
            f"the rms error of {rms_px:.2f} px is large: is the board flat, held still and of the right size?"
        )
    if len(left_px) < _MIN_PAIRS_ADVISED:
        hints.append(f"only {len(left_px)} pairs; {_MIN_PAIRS_ADVISED} or more average corner noise better")
    for view, corners in (("left", left_px), ("right", right_px)):
        together = np.concatenate(list(corners))
        empty = _empty_cells(together[seen(together)], size_px)
        if empty:
            hints.append(
                f"no corner in the {view} view's {', '.join(empty)}: distortion there is extrapolated"
            )
    spread = _tilt_spread_rad([board_pose(object_mm, c, left.matrix, left.distortion)[0] for c in left_px])
    if spread < _MIN_TILT_SPREAD_RAD:
        hints.append(
            f"the board's tilts differ by at most {np.rad2deg(spread):.0f} deg: focal length and distance "
            "can hardly be told apart; tilt the board by 30 deg in several directions"
        )
    for view, mono in (("left", left), ("right", right)):
        share = mono.focal_sigma_px / mono.matrix[0, 0]
        if share > 0.005:
            hints.append(
                f"the {view} focal length is uncertain by {100 * share:.1f} % (one standard deviation)"
            )
    return hints


def _empty_cells(corners_px: Array, size_px: tuple[int, int]) -> list[str]:
    """Names of the ninths of the image without a corner."""
    columns = ("left", "centre", "right")
    rows = ("upper", "middle", "lower")
    cells = np.clip((corners_px * _CELLS / np.array(size_px)).astype(int), 0, _CELLS - 1)
    filled = {(int(x), int(y)) for x, y in cells}
    return [f"{rows[y]} {columns[x]}" for y in range(_CELLS) for x in range(_CELLS) if (x, y) not in filled]


def _tilt_spread_rad(rotations: Sequence[Array]) -> float:
    """Largest angle between the normals of two boards."""
    normals = np.array([rotation[:, 2] for rotation in rotations])
    normals *= np.sign(normals[:, 2:])  # a board numbered from its other end is the same board
    return float(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))
