"""From stereo images of a chessboard to a rig.

The board is flat and is held still while both cameras take a picture; ten or more poses, tilted in several directions
and covering the whole image, make a good calibration. For a gel sensor the board is printed on a gel of its own
(section II of the paper), because gel and acrylic bend light.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from .checks import coverage_hints, held_out_errors, outlying, refuse_contradictions
from .corners import CornerFinder
from .errors import (
    BoardNotFoundError,
    CalibrationError,
    ImageError,
    MismatchedPairsError,
    SwappedViewsError,
    TooFewPairsError,
    UndeterminedLayersError,
    UnpairedImagesError,
)
from .layers import Combination, Doubt, LayersCalibration, SeatedFrame, calibrate_layers
from .observe import Observation, Progress, observe
from .pairs import ImagePair, pair_images
from .report import HeldOut, PairReport, Rectification, StereoCalibration
from .solve import Mono, Stereo, board_points_mm, solve_mono, solve_stereo

__all__ = [
    "BoardNotFoundError",
    "CalibrationError",
    "Combination",
    "Doubt",
    "HeldOut",
    "ImageError",
    "ImagePair",
    "LayersCalibration",
    "MismatchedPairsError",
    "Mono",
    "PairReport",
    "Rectification",
    "SeatedFrame",
    "Stereo",
    "StereoCalibration",
    "SwappedViewsError",
    "TooFewPairsError",
    "UndeterminedLayersError",
    "UnpairedImagesError",
    "calibrate_corners",
    "calibrate_layers",
    "calibrate_stereo",
    "pair_images",
]

Array = npt.NDArray[np.float64]

#: Three poses determine a camera (Zhang 2000); fewer do not.
MIN_PAIRS = 3


def calibrate_stereo(
    left_paths: Iterable[str | Path],
    right_paths: Iterable[str | Path],
    *,
    board: tuple[int, int],
    square_mm: float,
    time_limit_s: float = 10.0,
    drop_outliers: bool = False,
    refine_intrinsics: bool = True,
    progress: Progress | None = None,
) -> StereoCalibration:
    """Calibrate a stereo pair from images of a chessboard.

    Parameters
    ----------
    left_paths
        Images of the left camera; paired with the right ones by the number in their names.
    right_paths
        Images of the right camera.
    board
        Inner corners (columns, rows); a board of 10x7 squares has 9x6.
    square_mm
        Side of a square.
    time_limit_s
        Longest corner search in one image; the image is then left out, and named.
    drop_outliers
        Whether pairs whose error stands out are left out of a second calibration. They are named
        either way.
    refine_intrinsics
        Whether the cameras' own parameters are fitted again together with the pair's.
    progress
        Called with (steps done, steps in all, what is being done).

    Raises
    ------
    CalibrationError
        No calibration explains the corners; its subclasses name what is wrong with files, boards and pairs:
        `UnpairedImagesError`, `ImageError`, `BoardNotFoundError`, `TooFewPairsError`, `SwappedViewsError` and
        `MismatchedPairsError`.
    """
    _check_board(board, square_mm)
    report = progress or (lambda done, total, what: None)
    pairs = pair_images(left_paths, right_paths)
    if len(pairs) < MIN_PAIRS:
        raise _too_few(len(pairs), [])
    with CornerFinder(time_limit_s) as finder:
        observations = observe(pairs, board, finder, report)
    used = [o for o in observations if o.problem is None]
    if len(used) < MIN_PAIRS:
        raise _too_few(len(used), [o for o in observations if o.problem is not None])
    if used[0].left.size_px != used[0].right.size_px:
        raise ImageError(
            f"{used[0].pair.left.name} is {used[0].left.size_px} px but {used[0].pair.right.name} is "
            f"{used[0].right.size_px} px; both cameras must have the same size",
            used[0].pair.right,
        )
    calibration = calibrate_corners(
        [o.left.corners_px for o in used if o.left.corners_px is not None],
        [o.right.corners_px for o in used if o.right.corners_px is not None],
        size_px=used[0].left.size_px,
        board=board,
        square_mm=square_mm,
        names=[o.pair.name for o in used],
        drop_outliers=drop_outliers,
        refine_intrinsics=refine_intrinsics,
        progress=report,
    )
    return _with_unused(calibration, observations)


def calibrate_corners(
    left_px: Sequence[Array],
    right_px: Sequence[Array],
    *,
    size_px: tuple[int, int],
    board: tuple[int, int],
    square_mm: float,
    names: Sequence[str] | None = None,
    drop_outliers: bool = False,
    refine_intrinsics: bool = True,
    progress: Progress | None = None,
) -> StereoCalibration:
    """Calibrate a stereo pair from corners that were found elsewhere.

    Parameters
    ----------
    left_px
        Corners (columns * rows, 2) of every left image, row by row; ``right_px`` in the same numbering.
    size_px
        Width and height of the images.
    names
        Names of the pairs in the report. Default: "pair 0" and so on.

        Other parameters as in `calibrate_stereo`.
    """
    _check_board(board, square_mm)
    _check_corners(left_px, right_px, board)
    report = progress or (lambda done, total, what: None)
    names = list(names) if names is not None else [f"pair {i}" for i in range(len(left_px))]
    object_mm = board_points_mm(board, square_mm)
    report(0, 4, "each camera on its own")
    left, right = solve_mono(object_mm, left_px, size_px), solve_mono(object_mm, right_px, size_px)
    report(1, 4, "whether the pairs agree")
    refuse_contradictions(object_mm, left_px, right_px, left, right, names)
    report(2, 4, "both cameras together")
    stereo = solve_stereo(object_mm, left_px, right_px, size_px, left, right, refine_intrinsics)
    outliers = outlying(stereo.per_image_px)
    if drop_outliers and outliers.any() and len(names) - int(outliers.sum()) >= MIN_PAIRS:
        kept = [i for i in range(len(names)) if not outliers[i]]
        again = calibrate_corners(
            [left_px[i] for i in kept],
            [right_px[i] for i in kept],
            size_px=size_px,
            board=board,
            square_mm=square_mm,
            names=[names[i] for i in kept],
            refine_intrinsics=refine_intrinsics,
            progress=progress,
        )
        return _with_dropped(again, names, outliers, stereo.per_image_px)
    report(3, 4, "held-out pairs")
    held_out = held_out_errors(object_mm, left_px, right_px, size_px, board, square_mm, refine_intrinsics)
    return StereoCalibration(
        size_px=size_px,
        board=board,
        square_mm=square_mm,
        left=left,
        right=right,
        stereo=stereo,
        rectification=_rectify(stereo, size_px),
        pairs=tuple(
            PairReport(name, float(error[0]), float(error[1]), bool(outlier))
            for name, error, outlier in zip(names, stereo.per_image_px, outliers, strict=True)
        ),
        held_out=held_out,
        hints=tuple(coverage_hints(object_mm, left_px, right_px, size_px, left, right, stereo.rms_px)),
    )


def _check_board(board: tuple[int, int], square_mm: float) -> None:
    if min(board) < 3:
        raise CalibrationError(f"board is {board[0]}x{board[1]}; valid is at least 3x3 inner corners")
    if not (square_mm > 0.0 and np.isfinite(square_mm)):
        raise CalibrationError(f"square_mm is {square_mm}; valid is a finite length above 0 mm")


def _check_corners(left_px: Sequence[Array], right_px: Sequence[Array], board: tuple[int, int]) -> None:
    if len(left_px) != len(right_px) or len(left_px) < MIN_PAIRS:
        raise TooFewPairsError(
            f"{len(left_px)} left and {len(right_px)} right images; valid is the same number, at least {MIN_PAIRS}",
            min(len(left_px), len(right_px)),
            MIN_PAIRS,
        )
    shape = (board[0] * board[1], 2)
    for corners in (*left_px, *right_px):
        if corners.shape != shape or not np.isfinite(corners).all():
            raise CalibrationError(f"corners have shape {corners.shape}; valid is {shape}, all finite")


def _too_few(usable: int, unused: Sequence[Observation]) -> TooFewPairsError:
    message = (
        f"{usable} pairs show the whole board in both views; at least {MIN_PAIRS} are needed, ten are advised"
    )
    reasons = "; ".join(f"{o.pair.name}: {o.problem}" for o in unused[:5])
    return TooFewPairsError(f"{message} ({reasons})" if reasons else message, usable, MIN_PAIRS)


def _rectify(stereo: Stereo, size_px: tuple[int, int]) -> Rectification:
    r_left, r_right, p_left, p_right, q = cv2.stereoRectify(
        stereo.left_matrix,
        stereo.left_distortion,
        stereo.right_matrix,
        stereo.right_distortion,
        size_px,
        stereo.r_right_left,
        stereo.t_right_left_mm.reshape(3, 1),
    )[:5]
    return Rectification(*(np.asarray(a, float) for a in (r_left, r_right, p_left, p_right, q)))


def _with_unused(calibration: StereoCalibration, observations: Sequence[Observation]) -> StereoCalibration:
    by_name = {pair.name: pair for pair in calibration.pairs}
    pairs = [
        by_name.get(o.pair.name) or PairReport(o.pair.name, None, None, problem=o.problem)
        for o in observations
    ]
    return replace(calibration, pairs=tuple(pairs))


def _with_dropped(
    calibration: StereoCalibration, names: Sequence[str], outliers: npt.NDArray[np.bool_], errors_px: Array
) -> StereoCalibration:
    by_name = {pair.name: pair for pair in calibration.pairs}
    pairs = []
    for name, outlier, error in zip(names, outliers, errors_px, strict=True):
        problem = f"outlier, dropped ({error[0]:.2f} px left, {error[1]:.2f} px right)"
        pairs.append(PairReport(name, None, None, True, problem) if outlier else by_name[name])
    return replace(calibration, pairs=tuple(pairs))
