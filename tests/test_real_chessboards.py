"""Real chessboards: what our rig makes of them, and mrcal's opinion on the same corners."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest
from real_data import DATA, needs

from gelstereo.calibrate import StereoCalibration
from gelstereo_bench.reports import chessboards

pytestmark = needs("opencv_stereo_chess")


@pytest.fixture(scope="module")
def boards() -> chessboards.Boards:
    return chessboards.read_corners(DATA / "opencv_stereo_chess")


@pytest.fixture(scope="module")
def ours(boards: chessboards.Boards) -> StereoCalibration:
    return chessboards.calibrate(boards)


def test_the_board_is_flat_and_its_squares_are_square(
    boards: chessboards.Boards, ours: StereoCalibration
) -> None:
    pairs = list(zip(boards.left_px, boards.right_px, strict=True))
    assert len(pairs) == 13
    mine = chessboards.flatness([chessboards.triangulate_rig(ours.rig, *pair) for pair in pairs])
    theirs = chessboards.flatness([chessboards.triangulate_opencv(ours.rig, *pair) for pair in pairs])
    # Standard deviations estimated from 702 corners have a sampling error of 2.7 %.
    sampling = 1.0 + 1.0 / np.sqrt(2 * 702)
    assert mine.plane_rms <= theirs.plane_rms * sampling
    assert mine.side_sigma <= theirs.side_sigma * sampling
    # The scale is known as well as the baseline: a corner's noise over the square root of 702 of them in
    # each view.
    assert mine.side_mean == pytest.approx(1.0, abs=1e-3)


@pytest.mark.skipif(
    shutil.which("mrcal-calibrate-cameras") is None, reason="mrcal is absent (apt-get install mrcal)"
)
def test_mrcal_agrees(boards: chessboards.Boards, ours: StereoCalibration) -> None:
    second = chessboards.mrcal_rig(boards)
    assert second is not None
    rig, rms_px = second
    # One likelihood, two optimisers: they differ by where they stop and by mrcal's faint regularisation,
    # which is far below what the corners' noise leaves open.
    assert rms_px == pytest.approx(ours.stereo.rms_px, rel=0.01)
    sigma_px = max(ours.left.focal_sigma_px, ours.right.focal_sigma_px)
    for view in ("left_matrix", "right_matrix"):
        assert np.abs(getattr(rig, view) - getattr(ours.rig, view)).max() < 0.1 * sigma_px
    assert rig.baseline_mm == pytest.approx(ours.rig.baseline_mm, rel=1e-3)
    angle = cv2.Rodrigues(rig.t_right_left[:3, :3] @ ours.rig.t_right_left[:3, :3].T)[0]
    # A tenth of what moves a corner by its noise.
    assert np.linalg.norm(angle) < 0.1 * rms_px / ours.rig.left_matrix[0, 0]
