"""Calibration against known truth, against real images, and against everything that goes wrong with files."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from chessboards import BOARD, SIZE_PX, SQUARE_MM, TrueRig, board_poses, corner_views, draw_pair, write_pairs
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from real_data import DATA, needs

import gelstereo
from gelstereo import calibrate
from gelstereo.calibrate.checks import _refuse_swapped_views
from gelstereo.calibrate.corner_worker import find_corners
from gelstereo.calibrate.corners import CornerFinder, Corners, neighbouring_boards
from gelstereo.calibrate.observe import Observation, align

CHESS = DATA / "opencv_stereo_chess"
NOISE_PX = 0.1
PAIRS = 16


@pytest.fixture(scope="module")
def rig() -> TrueRig:
    return TrueRig.typical()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, rig: TrueRig) -> Path:
    path = tmp_path_factory.mktemp("boards")
    write_pairs(path, rig, 5)
    return path


def images(folder: Path, view: str) -> list[Path]:
    return sorted(folder.glob(f"{view}*"))


def corners(rig: TrueRig) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return corner_views(rig, board_poses(PAIRS), NOISE_PX)


def solve(left: list[np.ndarray], right: list[np.ndarray], **settings: object) -> calibrate.StereoCalibration:
    return calibrate.calibrate_corners(
        left, right, size_px=SIZE_PX, board=BOARD, square_mm=SQUARE_MM, **settings
    )


def test_truth_is_found_within_the_corner_noise(rig: TrueRig) -> None:
    found = solve(*corners(rig))
    # The rms of 2-D residuals of N corners with P fitted parameters is sigma sqrt(2 (1 - P / 2N)).
    count, fitted = 2 * PAIRS * BOARD[0] * BOARD[1], 18 + 6 + 6 * PAIRS
    expected_px = NOISE_PX * np.sqrt(2.0 * (1.0 - fitted / (2 * count)))
    # Its relative standard deviation is 1 / sqrt(2 (2N - P)), here 1.2 %; four of them.
    assert found.stereo.rms_px == pytest.approx(expected_px, rel=4.0 / np.sqrt(2.0 * (2 * count - fitted)))
    for view, mono, truth in (
        ("left", found.left, rig.left_matrix),
        ("right", found.right, rig.right_matrix),
    ):
        assert abs(mono.matrix[0, 0] - truth[0, 0]) < 4.0 * mono.focal_sigma_px, view
    # The baseline scales with the focal length's relative error at most; twice that for the verged pair.
    relative = 4.0 * found.left.focal_sigma_px / rig.left_matrix[0, 0]
    assert found.baseline_mm == pytest.approx(np.linalg.norm(rig.t_right_left_mm), rel=2.0 * relative)
    assert found.outliers == () and found.used == PAIRS


def test_held_out_errors_are_those_of_the_noise(rig: TrueRig) -> None:
    held_out = solve(*corners(rig)).held_out
    assert held_out is not None
    # The right corner's own noise, plus the left board pose's: at least one, at most a few times sqrt(2)
    # sigma.
    assert np.sqrt(2.0) * NOISE_PX < held_out.transfer_px < 4.0 * NOISE_PX
    assert abs(held_out.square_bias_mm) < held_out.square_mm < 0.05 * SQUARE_MM


def test_rig_triangulates_the_board_and_survives_its_file(rig: TrueRig, tmp_path: Path) -> None:
    left, right = corners(rig)
    found = solve(left, right)
    found.save(tmp_path / "rig.toml")
    loaded = gelstereo.Rig.load(tmp_path / "rig.toml")
    # The file holds the rotation's matrix, the rig its quaternion: equal to round-off.
    np.testing.assert_allclose(loaded.t_right_left, found.rig.t_right_left, atol=1e-15)
    np.testing.assert_array_equal(loaded.left_matrix, found.rig.left_matrix)
    np.testing.assert_array_equal(loaded.right_distortion, found.rig.right_distortion)
    points_mm = gelstereo.triangulate(loaded, left[0], right[0]).reshape(BOARD[1], BOARD[0], 3)
    # One pixel of disparity is 0.23 mm at 32 mm; sqrt(2) corners of 0.1 px leave 0.03 mm along z, less
    # across.
    side_mm = np.linalg.norm(np.diff(points_mm, axis=1), axis=-1)
    assert side_mm.mean() == pytest.approx(SQUARE_MM, abs=0.02)
    assert side_mm.std() < 0.06


def test_rectification_agrees_with_opencv(rig: TrueRig) -> None:
    found = solve(*corners(rig))
    ours, opencv = found.rig.rectification(), found.rectification
    np.testing.assert_allclose(ours.r_left, opencv.r_left, atol=1e-9)
    np.testing.assert_allclose(ours.r_right, opencv.r_right, atol=1e-9)
    assert ours.baseline_mm == pytest.approx(1.0 / opencv.q[3, 2], rel=1e-9)


def test_noisy_pair_is_named_and_dropped_only_when_asked(rig: TrueRig) -> None:
    left, right = corners(rig)
    right[4] = right[4] + np.random.default_rng(5).normal(0.0, 8 * NOISE_PX, right[4].shape)
    found = solve(left, right)
    assert found.outliers == ("pair 4",)
    assert found.used == PAIRS
    dropped = solve(left, right, drop_outliers=True)
    assert dropped.used == PAIRS - 1
    assert dropped.outliers == ("pair 4",)
    assert "outlier, dropped" in dropped.summary()
    assert dropped.stereo.rms_px < 0.8 * found.stereo.rms_px


def test_exchanged_pair_is_named(rig: TrueRig) -> None:
    left, right = corners(rig)
    left[3], right[3] = right[3], left[3]
    with pytest.raises(calibrate.MismatchedPairsError, match="exchanged in pair 3") as error:
        solve(left, right)
    assert error.value.swapped == ("pair 3",) and error.value.mismatched == ()


def test_pair_of_different_moments_is_named(rig: TrueRig) -> None:
    left, right = corners(rig)
    right[2], right[7] = right[7], right[2]
    with pytest.raises(calibrate.MismatchedPairsError, match="same moment") as error:
        solve(left, right)
    assert error.value.mismatched == ("pair 2", "pair 7") and error.value.swapped == ()


def test_swapped_cameras_are_refused(rig: TrueRig) -> None:
    left, right = corners(rig)
    with pytest.raises(calibrate.SwappedViewsError, match="exchange the left and the right"):
        solve(right, left)


@given(arrays(float, 3, elements=st.floats(-1.0, 1.0)), st.floats(0.0, np.pi), st.floats(0.0, 6.3))
def test_views_are_swapped_if_the_right_camera_is_to_the_left(
    turn: npt.NDArray[np.float64], off_rad: float, around_rad: float
) -> None:
    """Within 60 degrees of the left camera's negative x axis, however much the two are turned."""
    assume(abs(off_rad - np.deg2rad(60.0)) > 1e-6)
    beside = np.sin(off_rad) * np.array([np.cos(around_rad), np.sin(around_rad)])
    centre_mm = 8.0 * np.array([-np.cos(off_rad), *beside])
    rotation = cv2.Rodrigues(turn)[0]
    pose = (rotation, -rotation @ centre_mm)
    if off_rad < np.deg2rad(60.0):
        with pytest.raises(calibrate.SwappedViewsError, match=re.escape(f"({centre_mm[0]:.2f}")):
            _refuse_swapped_views(pose)
    else:
        _refuse_swapped_views(pose)


def test_parallel_boards_are_reported_as_undetermined(rig: TrueRig) -> None:
    found = solve(*corner_views(rig, board_poses(PAIRS, tilt_rad=0.02), NOISE_PX))
    tilted = solve(*corners(rig))
    assert any("tilt" in hint for hint in found.hints)
    assert not any("tilt" in hint for hint in tilted.hints)
    assert found.left.focal_sigma_px > 3.0 * tilted.left.focal_sigma_px


def test_images_give_the_rig(folder: Path, rig: TrueRig) -> None:
    steps: list[str] = []
    found = calibrate.calibrate_stereo(
        images(folder, "left"),
        images(folder, "right"),
        board=BOARD,
        square_mm=SQUARE_MM,
        progress=lambda done, total, what: steps.append(what),
    )
    assert found.used == 5
    assert found.stereo.rms_px < 0.2
    assert found.baseline_mm == pytest.approx(8.0, rel=0.02)
    assert any("left01.png" in step for step in steps)
    assert any("only 5 pairs" in hint for hint in found.hints)


@pytest.mark.parametrize("asked", [(10, 7), (8, 5), (9, 7), (10, 6)])
def test_wrong_board_size_suggests_the_right_one(folder: Path, asked: tuple[int, int]) -> None:
    with pytest.raises(calibrate.BoardNotFoundError, match=r"try 9x6\?") as error:
        calibrate.calibrate_stereo(
            images(folder, "left"), images(folder, "right"), board=asked, square_mm=SQUARE_MM
        )
    assert error.value.found == BOARD


def test_neighbouring_boards_start_with_squares_for_corners() -> None:
    sizes = neighbouring_boards((10, 7))
    assert sizes[:2] == [(9, 6), (11, 8)]
    assert len({tuple(sorted(size)) for size in sizes}) == len(sizes)


def test_unpaired_images_are_named(folder: Path) -> None:
    with pytest.raises(calibrate.UnpairedImagesError, match=r"no right image for left03\.png") as error:
        right = [path for path in images(folder, "right") if "03" not in path.name]
        calibrate.pair_images(images(folder, "left"), right)
    assert [path.name for path in error.value.left_only] == ["left03.png"]


def test_images_without_numbers_pair_in_order_and_only_when_as_many() -> None:
    pairs = calibrate.pair_images(["la.png", "lb.png"], ["ra.png", "rb.png"])
    assert [pair.name for pair in pairs] == ["la.png / ra.png", "lb.png / rb.png"]
    with pytest.raises(calibrate.UnpairedImagesError, match="2 left but 1 right"):
        calibrate.pair_images(["la.png", "lb.png"], ["ra.png"])


def test_a_file_for_both_views_is_refused(folder: Path) -> None:
    with pytest.raises(calibrate.UnpairedImagesError, match="as left and as right"):
        calibrate.pair_images(images(folder, "left"), images(folder, "left"))


def test_geometry_decides_and_names_warn(folder: Path, tmp_path: Path) -> None:
    # Files named the wrong way round: one of the two orders calibrates, and its hint says that names are
    # wrong.
    paths: dict[str, list[Path]] = {"left": [], "right": []}
    for view, other in (("left", "right"), ("right", "left")):
        for path in images(folder, view):
            paths[other].append(tmp_path / path.name.replace(view, other))
            shutil.copy(path, paths[other][-1])
    settings = {"board": BOARD, "square_mm": SQUARE_MM}
    with pytest.raises(calibrate.SwappedViewsError, match="exchange the left and the right images, whatever"):
        calibrate.calibrate_stereo(paths["left"], paths["right"], **settings)
    found = calibrate.calibrate_stereo(paths["right"], paths["left"], **settings)
    assert found.baseline_mm == pytest.approx(8.0, rel=0.02)
    assert "named right (right01.png)" in found.hints[0] and "the names are wrong" in found.hints[0]
    right_order = calibrate.calibrate_stereo(images(folder, "left"), images(folder, "right"), **settings)
    assert not any("named" in hint for hint in right_order.hints)


@pytest.mark.parametrize("limit_s", [0.0, -1.0, float("nan"), float("inf"), 1e12])
def test_time_limits_that_no_clock_can_keep(limit_s: float) -> None:
    with pytest.raises(
        calibrate.CalibrationError, match=r"time_limit_s is .*; valid is above 0, at most 86400 s"
    ):
        CornerFinder(limit_s)


def test_corner_search_ends_at_its_time_limit(tmp_path: Path, folder: Path) -> None:
    # Thousands of quadrilaterals without a board keep the search busy for seconds.
    cells = np.random.default_rng(0).integers(0, 2, (300, 300), dtype=np.uint8) * 255
    hard = tmp_path / "hard.png"
    cv2.imwrite(str(hard), np.kron(cells, np.ones((12, 12), np.uint8)))
    with CornerFinder(time_limit_s=0.2) as finder:
        found = finder.find(hard, BOARD)
        assert found.timed_out and found.corners_px is None and found.size_px == (3600, 3600)
    with CornerFinder(time_limit_s=0.2) as finder:
        finder.find(hard, BOARD)
        finder.time_limit_s = 30.0
        assert finder.find(images(folder, "left")[0], BOARD).corners_px is not None


def test_crash_of_the_search_names_the_image_and_is_survived(folder: Path) -> None:
    first = images(folder, "left")[0]
    with CornerFinder() as finder:
        assert finder.find(first, BOARD).corners_px is not None
        worker = finder._worker
        assert worker is not None
        worker._process.kill()
        worker._process.wait()
        with pytest.raises(calibrate.ImageError, match=r"ended while processing .*left01\.png"):
            finder.find(first, BOARD)
        assert finder.find(first, BOARD).corners_px is not None


def test_unreadable_and_odd_sized_images_are_named(tmp_path: Path, folder: Path) -> None:
    text = tmp_path / "left01.png"
    text.write_text("no image")
    left = [text, *images(folder, "left")[1:]]
    with pytest.raises(calibrate.ImageError, match=r"left01\.png is not an image"):
        calibrate.calibrate_stereo(left, images(folder, "right"), board=BOARD, square_mm=SQUARE_MM)
    cv2.imwrite(str(text), np.zeros((100, 100), np.uint8))
    with pytest.raises(calibrate.ImageError, match=r"640x480 px but left01\.png is 100x100 px"):
        calibrate.calibrate_stereo(left, images(folder, "right"), board=BOARD, square_mm=SQUARE_MM)


def test_half_turned_numbering_does_not_matter(rig: TrueRig) -> None:
    # The board's other end first in the right views only, as the sector search may number it.
    left, right = corners(rig)
    pair = calibrate.ImagePair(Path("l"), Path("r"))
    for a, b in zip(left, right, strict=True):
        aligned = align(Observation(pair, Corners(SIZE_PX, a), Corners(SIZE_PX, b[::-1])), BOARD)
        assert aligned.right.corners_px is not None
        np.testing.assert_array_equal(aligned.right.corners_px, b)


@pytest.mark.parametrize(
    ("board", "square_mm", "words"), [((2, 6), 1.0, "at least 3x3"), ((9, 6), 0.0, "square_mm is 0.0")]
)
def test_senseless_boards_are_refused(board: tuple[int, int], square_mm: float, words: str) -> None:
    with pytest.raises(calibrate.CalibrationError, match=words):
        calibrate.calibrate_stereo(["l1.png"], ["r1.png"], board=board, square_mm=square_mm)


def test_errors_derive_from_the_package_error() -> None:
    with pytest.raises(gelstereo.Error, match="at least 3"):
        calibrate.calibrate_stereo(["l1.png"], ["r1.png"], board=BOARD, square_mm=SQUARE_MM)


def test_drawn_corners_are_where_they_should_be(rig: TrueRig) -> None:
    pose = board_poses(1)[0]
    truth = rig.views(*pose, calibrate.Chessboard(BOARD, SQUARE_MM).points_mm())
    for image, exact in zip(draw_pair(rig, pose), truth, strict=True):
        found = find_corners(image, BOARD, "classic")
        assert found is not None
        error = min(np.abs(found - exact).max(), np.abs(found[::-1] - exact).max())
        assert error < 0.1


@given(
    depth_mm=st.floats(30.0, 95.0),
    turn=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.7, 0.7)),
    seed=st.integers(0, 99),
)
@settings(max_examples=25, deadline=None)
def test_corners_of_small_squares(depth_mm: float, turn: tuple[float, ...], seed: int) -> None:
    # Squares of 9 to 30 px under noise of 3 levels. A window of 2 px gives errors of 0.2 to 0.5 px rms.
    rig, points_mm = TrueRig.typical(), calibrate.Chessboard(BOARD, SQUARE_MM).points_mm()
    rotation = np.asarray(cv2.Rodrigues(np.array(turn))[0], float)
    pose = rotation, np.array([3.0, 0.0, depth_mm]) - rotation @ points_mm.mean(axis=0)
    noise = np.random.default_rng(seed).normal(0.0, 3.0, SIZE_PX[::-1])
    image = np.clip(draw_pair(rig, pose)[0] + noise, 0, 255).astype(np.uint8)
    found, truth = find_corners(image, BOARD, "classic"), rig.views(*pose, points_mm)[0]
    if found is None:
        return
    assert min(np.sqrt(np.mean((found - truth) ** 2)), np.sqrt(np.mean((found[::-1] - truth) ** 2))) < 0.1


@needs("opencv_stereo_chess")
def test_real_images_agree_with_the_reference() -> None:
    found = calibrate.calibrate_stereo(
        sorted(CHESS.glob("left[0-9]*.jpg")),
        sorted(CHESS.glob("right[0-9]*.jpg")),
        board=(9, 6),
        square_mm=1.0,
    )
    # An independent run on the same images; the rms by 5 %, lengths by 0.5 %.
    assert found.left.rms_px == pytest.approx(0.195, rel=0.05)
    assert found.right.rms_px == pytest.approx(0.207, rel=0.05)
    assert found.stereo.rms_px == pytest.approx(0.217, rel=0.05)
    assert found.stereo.left_matrix[0, 0] == pytest.approx(532.8, rel=0.005)
    assert found.stereo.right_matrix[0, 0] == pytest.approx(537.5, rel=0.005)
    assert found.baseline_mm == pytest.approx(3.328, rel=0.005)
    assert found.used == 13
    # The shipped calibration of the same camera.
    assert found.stereo.left_matrix[0, 0] == pytest.approx(535.9, rel=0.01)
