"""Stereo calibration: from images of a board to a rig.

The board is a chessboard, a ChArUco board or a grid of AprilTags. It must be flat, and stand still while both
cameras take a picture. A good calibration takes ten or more poses that are tilted in several directions and
cover the whole image. For a gel sensor, print the board on a separate gel (section II of the paper), because
gel and acrylic bend light.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

from .boards import MIN_CORNERS, AprilTagBoard, Board, CharucoBoard, Chessboard, board_of, determines_pose
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
from .observe import Observation, Progress, observe, observe_tags
from .pairs import ImagePair, names_swapped, pair_images
from .report import HeldOut, PairReport, Rectification, StereoCalibration
from .solve import Mono, Stereo, seen, solve_mono, solve_stereo

with needs(__name__):
    import cv2

__all__ = [
    "AprilTagBoard",
    "BoardNotFoundError",
    "CalibrationError",
    "CharucoBoard",
    "Chessboard",
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
    board: tuple[int, int] | Board,
    square_mm: float | None = None,
    time_limit_s: float = 10.0,
    drop_outliers: bool = False,
    refine_intrinsics: bool = True,
    progress: Progress | None = None,
) -> StereoCalibration:
    """Calibrate a stereo pair from images of a chessboard, a ChArUco board or AprilTags.

    Parameters
    ----------
    left_paths
        Images of the left camera. The numbers in the file names pair them with the right images.
    right_paths
        Images of the right camera.
    board
        Inner corners (columns, rows) of a chessboard; a board of 10x7 squares has 9x6. Or a `CharucoBoard` or
        `AprilTagBoard`, of which every image may show a part.
    square_mm
        Side of a square of a chessboard; boards with tags state their own lengths.
    time_limit_s
        Time limit of the corner search in one image. An image that exceeds it is left out and reported.
    drop_outliers
        Whether to calibrate a second time without outlying pairs. Outliers are reported in any case.
    refine_intrinsics
        Whether the intrinsic parameters are refined together with the stereo pose.
    progress
        Called with (steps done, total steps, description of the step).

    Raises
    ------
    CalibrationError
        No calibration explains the corners. Subclasses state what is wrong with files, boards and pairs:
        `UnpairedImagesError`, `ImageError`, `BoardNotFoundError`, `TooFewPairsError`, `SwappedViewsError` and
        `MismatchedPairsError`.
    """
    known = board_of(board, square_mm)
    report = progress or (lambda done, total, what: None)
    pairs = pair_images(left_paths, right_paths)
    if len(pairs) < MIN_PAIRS:
        raise _too_few(len(pairs), [])
    with CornerFinder(time_limit_s) as finder:
        if isinstance(known, Chessboard):
            observations = observe(pairs, known.corners, finder, report)
        else:
            observations = observe_tags(pairs, known, finder, report)
    used = [o for o in observations if o.problem is None]
    if len(used) < MIN_PAIRS:
        raise _too_few(len(used), [o for o in observations if o.problem is not None])
    if used[0].left.size_px != used[0].right.size_px:
        raise ImageError(
            f"{used[0].pair.left.name} is {used[0].left.size_px} px but {used[0].pair.right.name} is "
            f"{used[0].right.size_px} px; both cameras must have the same size",
            used[0].pair.right,
        )
    named = names_swapped([o.pair.left for o in used], [o.pair.right for o in used])
    calibration = calibrate_corners(
        [o.left.corners_px for o in used if o.left.corners_px is not None],
        [o.right.corners_px for o in used if o.right.corners_px is not None],
        size_px=used[0].left.size_px,
        board=known,
        names=[o.pair.name for o in used],
        drop_outliers=drop_outliers,
        refine_intrinsics=refine_intrinsics,
        progress=report,
    )
    if named is not None:
        hint = f"{named}, but their images show that they are in the right order: the names are wrong"
        calibration = replace(calibration, hints=(hint, *calibration.hints))
    return _with_unused(calibration, observations)


def calibrate_corners(
    left_px: Sequence[Array],
    right_px: Sequence[Array],
    *,
    size_px: tuple[int, int],
    board: tuple[int, int] | Board,
    square_mm: float | None = None,
    names: Sequence[str] | None = None,
    drop_outliers: bool = False,
    refine_intrinsics: bool = True,
    progress: Progress | None = None,
) -> StereoCalibration:
    """Calibrate a stereo pair from detected corners.

    Parameters
    ----------
    left_px
        Corners (N, 2) of every left image, in the order of the board's ``points_mm()``: row by row for a
        chessboard. NaN for a corner that is not seen; ``right_px`` in the same numbering.
    size_px
        Width and height of the images.
    names
        Names of the pairs in the report. Default: "pair 0" and so on.

        Other parameters as in `calibrate_stereo`.
    """
    known = board_of(board, square_mm)
    object_mm = known.points_mm()
    _check_corners(left_px, right_px, len(object_mm))
    report = progress or (lambda done, total, what: None)
    names = list(names) if names is not None else [f"pair {i}" for i in range(len(left_px))]
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
            board=known,
            names=[names[i] for i in kept],
            refine_intrinsics=refine_intrinsics,
            progress=progress,
        )
        return _with_dropped(again, names, outliers, stereo.per_image_px)
    report(3, 4, "held-out pairs")
    held_out = held_out_errors(left_px, right_px, size_px, known, refine_intrinsics)
    return StereoCalibration(
        size_px=size_px,
        board=known,
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


def _check_corners(left_px: Sequence[Array], right_px: Sequence[Array], count: int) -> None:
    if len(left_px) != len(right_px) or len(left_px) < MIN_PAIRS:
        raise TooFewPairsError(
            f"{len(left_px)} left and {len(right_px)} right images; valid is the same number, at least "
            f"{MIN_PAIRS}",
            min(len(left_px), len(right_px)),
            MIN_PAIRS,
        )
    for corners in (*left_px, *right_px):
        if corners.shape != (count, 2) or np.isinf(corners).any():
            raise CalibrationError(
                f"corners have shape {corners.shape}; valid is ({count}, 2), NaN where not seen"
            )
    for at, (left, right) in enumerate(zip(left_px, right_px, strict=True)):
        shared = np.where(seen(left, right)[:, None], left, np.nan)
        if not determines_pose(shared):
            raise CalibrationError(
                f"both views of pair {at} see {int(seen(left, right).sum())} corners; valid are "
                f"{MIN_CORNERS} or more, not all on one line"
            )


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
