"""Triangulation against OpenCV's and against the projection it undoes; hard cases 17 and 18."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gelstereo import Params, Rig, RigError, ShapeError, TriangulateError, triangulate, triangulate_covariance
from gelstereo.geometry import se3_exp

F_PX, BASELINE_MM = 560.0, 8.0
RIG = Rig.parallel((640, 480), F_PX, BASELINE_MM)
CENTRE = np.array([319.5, 239.5])
points = hnp.arrays(np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-1, 1)).map(
    lambda unit: unit * [10.0, 8.0, 3.0] + [4.0, 0.0, 29.0]
)
lenses = st.tuples(st.floats(-0.2, 0.2), st.floats(0, 0.05), *[st.floats(-2e-3, 2e-3)] * 2)


def turned_rig(turn: tuple[float, ...], lens: tuple[float, ...]) -> Rig:
    matrix = np.array([[F_PX, 0, 325.0], [0, F_PX + 2, 236.0], [0, 0, 1]])
    return Rig.from_opencv(
        size_px=(640, 480),
        left_matrix=matrix,
        left_distortion=lens,
        right_matrix=matrix,
        right_distortion=lens,
        rotation=np.array(se3_exp([*turn, 0, 0, 0]))[:3, :3],
        translation_mm=[-BASELINE_MM, 0.2, -0.1],
    )


@given(points, st.tuples(*[st.floats(-0.1, 0.1)] * 3), lenses)
def test_it_undoes_projection(
    points_mm: np.ndarray, turn: tuple[float, ...], lens: tuple[float, ...]
) -> None:
    rig = turned_rig(turn, lens)
    # Pixels are good to 1e-9 px where the distortion is inverted, and a pixel of disparity is 0.2 mm of
    # depth.
    assert np.abs(triangulate(rig, *rig.project(points_mm)) - points_mm).max() < 1e-9


@given(points, st.floats(-0.4, 0.4))
def test_it_is_opencvs_reprojection(points_mm: np.ndarray, epipolar_px: float) -> None:
    left, right = RIG.project(points_mm)
    right = right + [0.0, epipolar_px]
    homogeneous = (
        np.column_stack([left, left[:, 0] - right[:, 0], np.ones(len(left))]) @ RIG.rectification().q.T
    )
    found = triangulate(RIG, left, right)
    assert np.abs(found - homogeneous[:, :3] / homogeneous[:, 3:]).max() < 1e-10
    # OpenCV takes Q with its own sign of the baseline and 32-bit disparities: 2^-24 of 160 px, times 0.2
    # mm/px.
    disparity = (left[:, 0] - right[:, 0]).astype(np.float32).reshape(-1, 1)
    opencv = cv2.reprojectImageTo3D(disparity, np.array(RIG.rectification().q))[:, 0]
    assert np.abs(opencv[:, 2] - found[:, 2]).max() < 1e-4


@given(points)
def test_it_is_opencvs_triangulation_on_exact_rays(points_mm: np.ndarray) -> None:
    left, right = RIG.project(points_mm)
    camera = RIG.left_matrix
    projections = camera @ np.eye(3, 4), camera @ RIG.t_right_left[:3]
    opencv = cv2.triangulatePoints(*projections, np.array(left.T), np.array(right.T))
    # A 4x4 singular value problem in pixels: condition about f² = 3e5 of round-off at 30 mm.
    assert np.abs((opencv[:3] / opencv[3]).T - triangulate(RIG, left, right)).max() < 1e-8


def test_covariance_is_the_jacobians() -> None:
    point, sigma_px = np.array([[6.0, -2.0, 28.0]]), 0.05
    left, right = RIG.project(point)
    step = 1e-4
    columns = []
    for view, axis in [("left", 0), ("left", 1), ("right", 0)]:
        moved = [left.copy(), right.copy()]
        moved[view == "right"][0, axis] += step
        columns.append((triangulate(RIG, *moved) - point)[0] / step)
    numeric = sigma_px**2 * sum(np.outer(c, c) for c in columns)
    # One-sided differences are off by step / disparity.
    found = triangulate_covariance(RIG, point, sigma_px=sigma_px)[0]
    assert np.abs(found - numeric).max() <= 4 * step / 160.0 * np.abs(numeric).max()


@pytest.mark.parametrize("disparity_px", [0.0, 1e-12, -1e-12, -3.0, -160.0, np.nan])
def test_row_17_disparities_without_a_point(disparity_px: float) -> None:
    left = np.array([[400.0, 240.0], [380.0, 240.0]])
    right = left - [[160.0, 0.0], [disparity_px, 0.0]]
    with pytest.raises(TriangulateError, match="marker 1"):
        triangulate(RIG, left, right)


def test_row_17_swapped_views_are_named() -> None:
    left, right = RIG.project([[4.0, 0.0, 28.7], [6.0, 1.0, 28.0]])
    with pytest.raises(TriangulateError, match=r"2 of 2 .*swapped"):
        triangulate(RIG, right, left)
    with pytest.raises(RigError, match="swapped"):
        Rig.parallel((640, 480), F_PX, -BASELINE_MM)


@pytest.mark.parametrize("baseline_mm", [0.0, 1e-300, 1e-9, np.nan, np.inf])
def test_row_18_no_baseline_no_depth(baseline_mm: float) -> None:
    with pytest.raises(RigError, match=r"baseline|mm apart"):
        Rig.parallel((640, 480), F_PX, baseline_mm)


@given(st.floats(0.01, 100.0))
def test_row_18_depth_scales_with_a_short_baseline(baseline_mm: float) -> None:
    # Z = f B / d in closed form, for a disparity that does not depend on the baseline.
    rig = Rig.parallel((640, 480), F_PX, baseline_mm)
    found = triangulate(rig, [CENTRE + [80.0, 0.0]], [CENTRE - [80.0, 0.0]])
    expected = np.array([80.0, 0.0, F_PX]) * baseline_mm / 160.0
    assert np.abs(found[0] - expected).max() <= 8 * 2.0**-53 * F_PX * baseline_mm / 160.0


def test_row_18_parallel_rays_are_refused_by_the_setting() -> None:
    pair = [CENTRE + [0.5, 0.0]], [CENTRE]
    with pytest.raises(TriangulateError, match="at least 1 px"):
        triangulate(RIG, *pair)
    assert (
        triangulate(RIG, *pair, Params().replace({"triangulate.min_disparity_px": 0.1}))[0, 2] == F_PX * 16.0
    )


def test_what_is_no_pair() -> None:
    with pytest.raises(TriangulateError, match=r"2 markers in the left view but 1"):
        triangulate(RIG, np.zeros((2, 2)), np.zeros((1, 2)))
    with pytest.raises(ShapeError, match=r"right_px has the shape \(2, 3\); valid is \(N, 2\)"):
        triangulate(RIG, np.zeros((2, 2)), np.zeros((2, 3)))
    with pytest.raises(TriangulateError, match="sigma_px is -1"):
        triangulate_covariance(RIG, [[0.0, 0, 1]], sigma_px=-1.0)
    assert triangulate(RIG, np.empty((0, 2)), np.empty((0, 2))).shape == (0, 3)
