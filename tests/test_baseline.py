"""The core against the plain OpenCV, NumPy and SciPy implementation of the paper."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelstereo
from gelstereo.geometry import se3_exp
from gelstereo_bench.frontier import baseline, baseline_register
from gelstereo_bench.frontier.scenes import sphere_press

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def press() -> list[gelstereo.SimulatedFrame]:
    return sphere_press()


def geometry(rig: gelstereo.Rig) -> baseline.StereoGeometry:
    return baseline.StereoGeometry(
        rig.left_matrix,
        rig.left_distortion,
        rig.right_matrix,
        rig.right_distortion,
        rig.t_right_left[:3, :3],
        rig.t_right_left[:3, 3],
        rig.size_px,
    )


def verged_rig() -> gelstereo.Rig:
    matrix = np.array([[560.0, 0.0, 320.0], [0.0, 562.0, 241.0], [0.0, 0.0, 1.0]])
    return gelstereo.Rig.from_opencv(
        size_px=(640, 480),
        left_matrix=matrix,
        left_distortion=[-0.1, 0.03, 2e-4, -1e-4, 0.0],
        right_matrix=matrix + np.array([[2.0, 0.0, -3.0], [0.0, 1.0, 2.0], [0.0, 0.0, 0.0]]),
        right_distortion=[-0.09, 0.02, -1e-4, 2e-4, 0.0],
        rotation=se3_exp([0.003, -0.04, 0.006, 0.0, 0.0, 0.0])[:3, :3],
        translation_mm=[-8.0, 0.04, 0.15],
    )


def detect_both(press: list[gelstereo.SimulatedFrame], centre: str) -> tuple[np.ndarray, np.ndarray]:
    """Centres by the core and by OpenCV, both in the order of the true markers."""
    params = gelstereo.Params().replace(detect={"centre": centre})
    reference = baseline.Baseline(geometry(gelstereo.Scene().rig), params.to_dict())
    found = gelstereo.Detector(params).detect(press[-1].left).centres_px, reference.detect(press[-1].left)
    truth = press[-1].left_px
    assert [len(centres) for centres in found] == [len(truth)] * 2
    ours, theirs = (c[np.linalg.norm(truth[:, None] - c[None], axis=2).argmin(axis=1)] for c in found)
    return ours, theirs


def test_binary_centres_agree(press: list[gelstereo.SimulatedFrame]) -> None:
    ours, theirs = detect_both(press, "binary")
    distance = np.linalg.norm(ours - theirs, axis=1)
    # The two round the blurred images differently, by a level at most: a pixel at the threshold of a marker
    # of about 50 moves its centre by a 50th of its distance, 5 px at most. Two such pixels are rare.
    assert distance.max() < 0.25
    assert np.median(distance) < 0.025


def test_grey_centres_are_no_worse(press: list[gelstereo.SimulatedFrame]) -> None:
    ours, theirs = detect_both(press, "grey")
    error_px = [np.sqrt(np.mean(np.sum((c - press[-1].left_px) ** 2, axis=1))) for c in (ours, theirs)]
    # Two different weightings; the rms over 625 markers has a relative spread of 1 / sqrt(2 * 625), 3 %.
    assert error_px[0] < 1.1 * error_px[1]
    assert error_px[0] < 0.07


@given(SEEDS, st.floats(0.0, 0.08))
def test_foresight_sort_agrees_or_the_core_refuses_wrong_labels(seed: int, turn_rad: float) -> None:
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:8, 0:11] * 20.0
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    points = np.column_stack([c * x.ravel() - s * y.ravel(), s * x.ravel() + c * y.ravel()])
    points += random.uniform(-2.0, 2.0, points.shape)
    shuffle = random.permutation(len(points))
    right = np.argsort(shuffle)
    theirs = baseline.foresight_sort(points[shuffle], 11, 20.0 / 3.0)
    try:
        ours = gelstereo.foresight_sort(points[shuffle], 8, 11, 20.0 / 3.0)
    except gelstereo.LabelError:
        assert theirs is None or not np.array_equal(theirs, right)
    else:
        np.testing.assert_array_equal(ours, right)
        np.testing.assert_array_equal(ours, theirs)


@settings(max_examples=30)
@given(SEEDS)
def test_triangulation_agrees_on_a_verged_distorted_rig(seed: int) -> None:
    rig = verged_rig()
    random = np.random.default_rng(seed)
    points_mm = np.column_stack([random.uniform(-6.0, 12.0, (20, 2)), random.uniform(24.0, 34.0, 20)])
    left_px, right_px = rig.project(points_mm)
    reference = baseline.Baseline(geometry(rig), gelstereo.Params().to_dict())
    theirs = reference.triangulate(left_px, right_px)
    ours = gelstereo.triangulate(rig, left_px, right_px)
    # OpenCV's undistortion stops after five steps, good to some 1e-4 px here; a pixel is 0.2 mm of depth.
    np.testing.assert_allclose(ours, points_mm, atol=1e-9)
    np.testing.assert_allclose(theirs, ours, atol=1e-3)


@given(SEEDS)
def test_indentation_agrees(seed: int) -> None:
    random = np.random.default_rng(seed)
    rest = np.column_stack([random.uniform(-10.0, 10.0, (40, 2)), random.normal(28.7, 0.05, 40)])
    points = rest + random.normal(0.0, 0.3, rest.shape)
    np.testing.assert_allclose(
        gelstereo.RestSurface(rest).indentation_mm(points), baseline.indentation_mm(points, rest), atol=1e-12
    )


def test_whole_pipeline_agrees(press: list[gelstereo.SimulatedFrame]) -> None:
    rig, params = gelstereo.Scene().rig, gelstereo.Params()
    ours, theirs = gelstereo.Pipeline(rig, params), baseline.Baseline(geometry(rig), params.to_dict())
    for frame in press:
        a, b = ours.process(frame.left, frame.right), theirs.process(frame.left, frame.right)
    np.testing.assert_allclose(a.left_px, b.left_px, atol=0.25)
    # A quarter of a pixel in each view, at 0.19 mm per pixel of disparity.
    np.testing.assert_allclose(a.points_mm[:, 2], b.points_mm[:, 2], atol=0.1)
    clear = np.abs(a.indentation_mm - params.to_dict()["contact"]["saliency_mm"]) > 0.1
    np.testing.assert_array_equal(a.salient[clear], b.salient[clear])
    assert a.motion_px == pytest.approx(b.motion_px, abs=0.02)


@pytest.mark.parametrize("method", ["filterreg", "filterreg plane", "icp plane"])
def test_baseline_registration_returns_to_the_truth(method: str) -> None:
    import trimesh

    mesh = trimesh.creation.box((12.0, 9.0, 4.0))
    template = gelstereo.Template.from_mesh(mesh, units="mm", spacing_mm=0.3)
    truth = se3_exp([0.3, -0.2, 0.5, 3.0, -2.0, 29.0])
    corner = np.linalg.norm(template.points_mm - [6.0, 4.5, 2.0], axis=1) < 4.0
    points_mm = template.points_mm[corner] @ truth[:3, :3].T + truth[:3, 3]
    guess = se3_exp([0.02, 0.03, -0.02, 0.2, -0.1, 0.2]) @ truth
    common = {"spacing_mm": 0.3, "max_iterations": 200, "step_tolerance": 1e-6}
    soft = {"sigma_start_mm": 0.7, "sigma_floor_mm": 0.1, "outlier_share": 0.1}
    arguments = (points_mm, template.points_mm, template.normals, guess)
    if method == "icp plane":
        found = baseline_register.icp(*arguments, max_distance_mm=1.0, plane=True, **common)
    else:
        found = baseline_register.filterreg(*arguments, plane="plane" in method, **soft, **common)
    moved = (found @ np.linalg.inv(truth))[:3, :3] @ points_mm.T + (found @ np.linalg.inv(truth))[:3, 3:]
    # Point to point is drawn to the sampled points' local mean, a fraction of the spacing inside edges.
    assert np.abs(moved.T - points_mm).max() < (0.02 if "plane" in method else 0.15)


@given(SEEDS)
def test_rigid_fit_is_never_a_reflection(seed: int) -> None:
    random = np.random.default_rng(seed)
    source = random.normal(size=(6, 3))
    rotation, translation = baseline_register.rigid_fit(source, source * [1.0, 1.0, -1.0], np.ones(6))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    pose = se3_exp(np.append(random.uniform(-1.0, 1.0, 3), random.uniform(-5.0, 5.0, 3)))
    moved = source @ pose[:3, :3].T + pose[:3, 3]
    rotation, translation = baseline_register.rigid_fit(source, moved, random.uniform(0.1, 1.0, 6))
    np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-9)
    np.testing.assert_allclose(translation, pose[:3, 3], atol=1e-9)
