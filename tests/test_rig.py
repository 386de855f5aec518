"""The rig against OpenCV: rectification, distortion and its inverse, and files."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import PoseError, Rig, RigError, ShapeError
from gelstereo.geometry import se3_exp

SIZE_PX = (640, 480)


def steps(low: float, high: float) -> st.SearchStrategy[float]:
    """Multiples of 1e-4: OpenCV's Rodrigues takes angles below 1e-6 for none."""
    return st.integers(round(low * 1e4), round(high * 1e4)).map(lambda n: n * 1e-4)


turns = st.tuples(*[steps(-0.15, 0.15)] * 3)
offsets = st.tuples(steps(-20, -5), steps(-1, 1), steps(-1, 1))
# Mild enough to be one-to-one over the whole image.
lenses = st.tuples(
    st.floats(-0.2, 0.2), st.floats(0, 0.05), *[st.floats(-2e-3, 2e-3)] * 2, st.floats(0, 0.02)
)


def rotation_of(turn: tuple[float, float, float]) -> np.ndarray:
    return np.array(se3_exp([*turn, 0, 0, 0]))[:3, :3]


def camera_matrix(f_px: float = 560.0) -> np.ndarray:
    return np.array([[f_px, 0, 325.0], [0, f_px + 3.0, 236.0], [0, 0, 1]])


def rig_of(turn: tuple[float, ...], offset: tuple[float, ...], lens: tuple[float, ...] = (0,) * 5) -> Rig:
    return Rig.from_opencv(
        size_px=SIZE_PX,
        left_matrix=camera_matrix(),
        left_distortion=lens,
        right_matrix=camera_matrix(555.0),
        right_distortion=lens,
        rotation=rotation_of(turn),
        translation_mm=np.array(offset).reshape(3, 1),
    )


@given(turns, offsets)
def test_rectification_is_opencvs(turn: tuple[float, ...], offset: tuple[float, ...]) -> None:
    found = rig_of(turn, offset).rectification()
    r_left, r_right, *_, q, _, _ = cv2.stereoRectify(
        camera_matrix(),
        np.zeros(5),
        camera_matrix(555.0),
        np.zeros(5),
        SIZE_PX,
        rotation_of(turn),
        np.array(offset).reshape(3, 1),
    )
    # OpenCV orthonormalises rotation vectors by an SVD on the way: a few 1e-9 at most.
    assert np.abs(found.r_left - r_left).max() < 1e-8
    assert np.abs(found.r_right - r_right).max() < 1e-8
    assert found.baseline_mm == pytest.approx(1.0 / q[3, 2], rel=1e-9)
    assert np.linalg.norm(offset) == pytest.approx(found.baseline_mm, rel=1e-12)


@given(lenses, st.lists(st.tuples(st.floats(0, 639), st.floats(0, 479)), min_size=1, max_size=20))
def test_undistortion_is_opencvs(lens: tuple[float, ...], pixels: list[tuple[float, float]]) -> None:
    rig = rig_of((0, 0, 0), (-8, 0, 0), lens)
    found = rig.undistort(pixels)
    # OpenCV iterates to its criteria and not to the last bit: ask for far more than its default of five
    # steps.
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-13)
    reference = opencv_undistort(np.array(pixels), np.array(lens), criteria)
    assert np.abs(found - reference).max() < 1e-9
    # And there and back, which needs no reference: 1e-12 of a normalised coordinate is 1e-9 px.
    points = np.column_stack([found, np.ones(len(found))]) * 30.0
    assert np.abs(rig.project(points)[0] - pixels).max() < 1e-8


def opencv_undistort(pixels: np.ndarray, lens: np.ndarray, criteria: tuple[int, int, float]) -> np.ndarray:
    points = pixels.reshape(-1, 1, 2)
    if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4; 5 takes the criteria as an argument
        return cv2.undistortPointsIter(points, camera_matrix(), lens, None, None, criteria).reshape(-1, 2)
    return cv2.undistortPoints(points, camera_matrix(), lens, criteria=criteria).reshape(-1, 2)


@given(turns, offsets, lenses)
def test_projection_is_opencvs(
    turn: tuple[float, ...], offset: tuple[float, ...], lens: tuple[float, ...]
) -> None:
    points = np.array([[4.0, 1.0, 28.7], [-3.0, 5.0, 31.0], [10.0, -6.0, 26.0]])
    left, right = rig_of(turn, offset, lens).project(points)
    none = np.zeros(3)
    reference, _ = cv2.projectPoints(points, none, none, camera_matrix(), np.array(lens))
    assert np.abs(left - reference[:, 0]).max() < 1e-9
    in_right = points @ rotation_of(turn).T + offset
    reference, _ = cv2.projectPoints(in_right, none, none, camera_matrix(555.0), np.array(lens))
    assert np.abs(right - reference[:, 0]).max() < 1e-9


def test_row_22_pixels_beyond_the_distortion_model() -> None:
    # k1 = -0.4 folds over at a distorted radius of 0.609; 0.65 lies beyond, where no ray is right.
    rig = rig_of((0, 0, 0), (-8, 0, 0), (-0.4, 0, 0, 0, 0))
    centre = np.array([[325.0, 236.0]])
    assert np.isfinite(rig.undistort(centre + np.array([0.60 * 560, 0]))).all()
    with pytest.raises(RigError, match="distortion"):
        rig.undistort(centre + np.array([0.65 * 560, 0]))


@given(turns, offsets, lenses)
def test_files_keep_the_rig(
    turn: tuple[float, ...], offset: tuple[float, ...], lens: tuple[float, ...]
) -> None:
    rig = rig_of(turn, offset, lens)
    again = Rig.from_toml(rig.to_toml())
    assert np.array_equal(again.left_matrix, rig.left_matrix)
    assert np.array_equal(again.left_distortion, rig.left_distortion)
    assert np.abs(again.t_right_left - rig.t_right_left).max() == 0
    copied = pickle.loads(pickle.dumps(rig))
    assert np.abs(copied.t_right_left - rig.t_right_left).max() == 0


def test_load_and_save(tmp_path: Path) -> None:
    rig = Rig.parallel(SIZE_PX, 560.0, 8.0)
    rig.save(tmp_path / "rig.toml")
    assert Rig.load(tmp_path / "rig.toml") == rig
    with pytest.raises(FileNotFoundError, match="absent"):
        Rig.load(tmp_path / "absent.toml")
    with pytest.raises(RigError, match=r"line 2, `focal = 3`.*unknown field"):
        Rig.from_toml("[left]\nfocal = 3")


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"translation_mm": [8.0, 0, 0]}, RigError, "swapped"),
        ({"translation_mm": [0.0, 0, 0]}, RigError, "mm apart"),
        ({"translation_mm": [-8.0, np.nan, 0]}, RigError, "NaN"),
        ({"translation_mm": [1.0, 2.0]}, ShapeError, "3 numbers"),
        ({"rotation": 2 * np.eye(3)}, PoseError, "determinant"),
        ({"left_matrix": [[560, 1, 320], [0, 560, 240], [0, 0, 1]]}, RigError, "skew"),
        ({"left_matrix": np.eye(4)}, ShapeError, r"\(3, 3\)"),
        ({"left_matrix": [[-560.0, 0, 320], [0, 560, 240], [0, 0, 1]]}, RigError, "fx_px is -560"),
        ({"left_distortion": np.zeros(8)}, RigError, "RATIONAL"),
    ],
)
def test_numbers_that_are_no_rig(changes: dict[str, object], error: type[Exception], words: str) -> None:
    good: dict[str, object] = {
        "left_matrix": camera_matrix(),
        "left_distortion": np.zeros((1, 5)),
        "right_matrix": camera_matrix(),
        "right_distortion": [],
        "rotation": np.eye(3),
        "translation_mm": [-8.0, 0, 0],
    }
    assert Rig.from_opencv(size_px=SIZE_PX, **good).baseline_mm == 8.0  # type: ignore[arg-type]
    with pytest.raises(error, match=words):
        Rig.from_opencv(size_px=SIZE_PX, **(good | changes))  # type: ignore[arg-type]


def test_points_behind_a_camera_are_named() -> None:
    with pytest.raises(RigError, match=r"point 1: .* not in front"):
        Rig.parallel(SIZE_PX, 560.0, 8.0).project([[0, 0, 1.0], [0, 0, -1.0]])
