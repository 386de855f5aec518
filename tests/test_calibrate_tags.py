"""Calibration with ChArUco boards and AprilTags, drawn through a known rig, whole and cut by the image."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from chessboards import SIZE_PX, TrueRig
from hypothesis import given, settings
from hypothesis import strategies as st

from gelstereo import calibrate
from gelstereo.calibrate import AprilTagBoard, CharucoBoard
from gelstereo.calibrate.boards import TagBoard, families_in, from_request, to_request
from gelstereo.cli.main import main

Array = npt.NDArray[np.float64]

CHARUCO = CharucoBoard((9, 7), 2.6, 1.9)
APRILTAGS = AprilTagBoard((6, 5), 2.8, 0.8)
#: Pixels of a flat drawing for each millimetre.
SCALE = 40
#: Images are drawn larger by this and averaged.
TIMES = 2


def flat(board: TagBoard, legacy: bool = False) -> tuple[npt.NDArray[np.uint8], float]:
    """The printed board and its white margin, mm."""
    dictionary = board.dictionary if isinstance(board, CharucoBoard) else f"apriltag_{board.family}"
    number = {"4x4_50": cv2.aruco.DICT_4X4_50, "5x5_100": cv2.aruco.DICT_5X5_100}
    book = cv2.aruco.getPredefinedDictionary(number.get(dictionary, cv2.aruco.DICT_APRILTAG_36h11))
    drawn: cv2.aruco.Board
    if isinstance(board, CharucoBoard):
        (cols, rows), step = board.squares, board.square_mm
        size_mm = np.array([cols, rows]) * step
        drawn = cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, book)
        drawn.setLegacyPattern(legacy)
    else:
        (cols, rows), step = board.tags, board.tag_mm + board.gap_mm
        size_mm = np.array([cols, rows]) * step - board.gap_mm
        drawn = cv2.aruco.GridBoard(board.tags, board.tag_mm, board.gap_mm, book)
    width, height = np.round(size_mm * SCALE).astype(int)
    margin = SCALE
    image = drawn.generateImage((int(width) + 2 * margin, int(height) + 2 * margin), marginSize=margin)
    return np.asarray(image, np.uint8), 1.0


def origin_mm(board: TagBoard) -> float:
    """Where the print's upper left corner lies before the first point of the board."""
    return -board.square_mm if isinstance(board, CharucoBoard) else 0.0


@cache
def rays_of(matrix: bytes, distortion: bytes) -> Array:
    """Rays (N, 3) of the pixels of an enlarged image; the same for every pose."""
    y, x = np.mgrid[0 : SIZE_PX[1] * TIMES, 0 : SIZE_PX[0] * TIMES]
    pixels = (np.column_stack([x.ravel(), y.ravel()]) + 0.5) / TIMES - 0.5
    camera = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), *camera).reshape(-1, 2)
    return np.column_stack([rays, np.ones(len(rays))])


def draw(rig: TrueRig, board: TagBoard, pose: tuple[Array, Array], legacy: bool = False) -> list[Array]:
    """Both views of a board: every pixel is traced to the print."""
    image, margin_mm = flat(board, legacy)
    views = []
    for view in range(2):
        matrix, distortion = (
            (rig.left_matrix, rig.left_distortion) if view == 0 else (rig.right_matrix, rig.right_distortion)
        )
        rotation, translation = pose
        if view == 1:
            rotation, translation = (
                rig.r_right_left @ rotation,
                rig.r_right_left @ translation + rig.t_right_left_mm,
            )
        rays = rays_of(matrix.tobytes(), distortion.tobytes()) @ rotation
        start = -translation @ rotation
        hit = start + rays * (-start[2] / rays[:, 2])[:, None]
        at = (hit[:, :2] - origin_mm(board) + margin_mm) * SCALE - 0.5
        shape = SIZE_PX[1] * TIMES, SIZE_PX[0] * TIMES
        drawn = cv2.remap(
            cv2.GaussianBlur(image, (0, 0), 2.0),
            at[:, 0].reshape(shape).astype(np.float32),
            at[:, 1].reshape(shape).astype(np.float32),
            cv2.INTER_LINEAR,
            borderValue=(255.0,),
        )
        small = cv2.resize(drawn, SIZE_PX, interpolation=cv2.INTER_AREA).astype(np.float64)
        views.append(np.clip(30.0 + 0.75 * small, 0, 255))
    return views


def poses(board: TagBoard, count: int, reach_mm: float, seed: int = 3) -> list[tuple[Array, Array]]:
    """Poses around the middle of both views; with a large reach, the board is cut by the image's border."""
    random = np.random.default_rng(seed)
    centre = board.points_mm().mean(axis=0)
    found = []
    for _ in range(count):
        turn = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(-0.4, 0.4))
        rotation = np.asarray(cv2.Rodrigues(turn)[0], float)
        offset = random.uniform(-reach_mm, reach_mm, 2)
        where = np.array([3.0 + offset[0], offset[1], random.uniform(28.0, 36.0)])
        found.append((rotation, where - rotation @ centre))
    return found


def write(folder: Path, board: TagBoard, count: int, reach_mm: float) -> tuple[list[Path], list[Path]]:
    rig, random = TrueRig.typical(), np.random.default_rng(1)
    paths: tuple[list[Path], list[Path]] = ([], [])
    for at, pose in enumerate(poses(board, count, reach_mm)):
        for view, name, image in zip(paths, ("left", "right"), draw(rig, board, pose), strict=True):
            view.append(folder / f"{name}{at:02}.png")
            noisy = np.clip(np.round(image + random.normal(0.0, 2.0, image.shape)), 0, 255)
            cv2.imwrite(str(view[-1]), noisy.astype(np.uint8))
    return paths


@pytest.mark.parametrize("board", [CHARUCO, APRILTAGS], ids=["charuco", "apriltag"])
@pytest.mark.parametrize("reach_mm", [0.0, 6.0], ids=["whole", "cut"])
def test_drawn_boards_give_the_rig(board: TagBoard, reach_mm: float, tmp_path: Path) -> None:
    left, right = write(tmp_path, board, 12, reach_mm)
    found = calibrate.calibrate_stereo(left, right, board=board)
    rig = TrueRig.typical()
    assert found.used >= 10 and found.stereo.rms_px < 0.25
    assert found.stereo.left_matrix[0, 0] == pytest.approx(rig.left_matrix[0, 0], rel=0.01)
    assert found.baseline_mm == pytest.approx(np.linalg.norm(rig.t_right_left_mm), rel=0.01)
    assert found.held_out is not None and found.held_out.square_mm < 0.02 * board.side_mm
    assert str(board) in found.summary()


@pytest.mark.parametrize("board", [CHARUCO, APRILTAGS], ids=["charuco", "apriltag"])
@given(seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_every_corner_has_the_number_of_its_place(board: TagBoard, seed: int) -> None:
    rig, pose = TrueRig.typical(), poses(board, 1, 7.0, seed)[0]
    image = draw(rig, board, pose)[0].astype(np.uint8)
    found, truth = board.find(image), rig.views(*pose, board.points_mm())[0]
    seen = np.isfinite(found[:, 0])
    assert np.abs(found - truth)[seen].max(initial=0.0) < 0.8


def test_boards_of_the_older_pattern() -> None:
    board, rig = CharucoBoard((8, 6), 2.6, 1.9), TrueRig.typical()
    pose = poses(board, 1, 0.0)[0]
    truth = rig.views(*pose, board.points_mm())[0]
    for legacy in (False, True):
        found = board.find(draw(rig, board, pose, legacy)[0].astype(np.uint8))
        assert np.abs(found - truth).max() < 1.0


@pytest.mark.long
def test_another_dictionary_is_named(tmp_path: Path) -> None:
    shown = CharucoBoard((9, 7), 2.6, 1.9, "5x5_100")
    left, right = write(tmp_path, shown, 3, 0.0)
    with pytest.raises(calibrate.BoardNotFoundError, match="shows markers of 5x5_50"):
        calibrate.calibrate_stereo(left, right, board=CHARUCO)
    assert families_in(cv2.imread(str(left[0]), cv2.IMREAD_GRAYSCALE))[0] == "5x5_50"
    with pytest.raises(calibrate.BoardNotFoundError, match="shows markers of 5x5_50"):
        calibrate.calibrate_stereo(left, right, board=APRILTAGS)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: CharucoBoard((2, 6), 2.0, 1.0), "at least 3x3"),
        (lambda: CharucoBoard((9, 6), 2.0, 2.0), "valid is below square_mm"),
        (lambda: CharucoBoard((9, 6), 2.0, 1.0, "9x9_10"), "valid is one of"),
        (lambda: CharucoBoard((20, 20), 2.0, 1.0, "4x4_50"), "200 tags; 4x4_50 has 50"),
        (lambda: AprilTagBoard((1, 1), 2.0, 1.0), "two tags"),
        (lambda: AprilTagBoard((3, 3), 2.0, float("nan")), "gap_mm is nan"),
        (lambda: calibrate.calibrate_stereo([], [], board=CHARUCO, square_mm=2.0), "states its own lengths"),
        (lambda: calibrate.calibrate_stereo([], [], board=(9, 6)), "square_mm is missing"),
    ],
)
def test_senseless_boards_are_refused(make: object, said: str) -> None:
    assert callable(make)
    with pytest.raises(calibrate.CalibrationError, match=said):
        make()


@pytest.mark.parametrize("board", [CHARUCO, APRILTAGS])
def test_boards_survive_a_request(board: TagBoard) -> None:
    import json

    assert from_request(json.loads(json.dumps(to_request(board)))) == board


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = write(tmp_path, APRILTAGS, 4, 0.0)
    words = [
        "calibrate",
        "--left",
        *map(str, left),
        "--right",
        *map(str, right),
        "--out",
        str(tmp_path / "rig.toml"),
    ]
    lengths = ["--marker-mm", "2.8", "--gap-mm", "0.8"]
    assert main([*words, "--board", "apriltag:6x5", *lengths]) == 0
    assert "6x5 AprilTags 36h11" in capsys.readouterr().out and (tmp_path / "rig.toml").is_file()
    assert main([*words, "--board", "apriltag:6x5"]) == 2
    assert "--marker-mm is missing" in capsys.readouterr().err
    assert main([*words, "--board", "9x6", "--square-mm", "2", "--dictionary", "4x4_50"]) == 2
    assert "has none" in capsys.readouterr().err
