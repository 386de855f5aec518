"""Fusion of two estimates of one pose, against its definition in mpmath at 40 digits."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from gelstereo import RegisterError, geometry

seeds = st.integers(0, 2**31)
#: Turns are known to mrad, shifts to 0.1 mm.
SCALE = np.array([1e3] * 3 + [10.0] * 3)


def estimates(random: np.random.Generator, rank: int, sigma: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Two poses, so many standard deviations from a common one, and their information."""
    truth, found = np.asarray(geometry.se3_exp(random.normal(size=6) * [1, 1, 1, 20, 20, 20])), []
    for _ in range(2):
        rows = random.normal(size=(rank, 6)) * SCALE
        error = sigma * random.normal(size=6) / SCALE
        found.append((np.asarray(geometry.se3_exp(error)) @ truth, rows.T @ rows))
    return found


def exact_log(motion: mpmath.matrix) -> mpmath.matrix:
    """Twist (ω, v) of a rigid motion, by the logarithm of its matrix."""
    log = mpmath.logm(motion)
    entries = [log[2, 1], log[0, 2], log[1, 0], log[0, 3], log[1, 3], log[2, 3]]
    return mpmath.matrix([mpmath.re(entry) for entry in entries])


def exact_exp(twist: list[mpmath.mpf]) -> mpmath.matrix:
    x, y, z, a, b, c = twist
    return mpmath.expm(mpmath.matrix([[0, -z, y, a], [z, 0, -x, b], [-y, x, 0, c], [0, 0, 0, 0]]))


def error_at(step: list[float], pose: np.ndarray, estimate: np.ndarray) -> mpmath.matrix:
    """Error e of an estimate T where exp(e) T is `pose`, moved by a left perturbation."""
    moved = exact_exp([mpmath.mpf(x) for x in step]) * mpmath.matrix(pose.tolist())
    return exact_log(moved * mpmath.inverse(mpmath.matrix(estimate.tolist())))


@settings(max_examples=4, deadline=None)
@given(seed=seeds)
def test_the_fused_pose_has_the_least_distance_and_its_curvature(seed: int) -> None:
    random = np.random.default_rng(seed)
    found = estimates(random, 8, 3.0)
    (first, one), (second, two) = found
    pose, information, squared = geometry.fuse_poses(first, one, second, two)
    gradient, expected, distance = np.zeros(6), np.zeros((6, 6)), 0.0
    with mpmath.workdps(40):
        step = mpmath.mpf("1e-12")
        for estimate, known in found:
            error = np.array([float(x) for x in error_at([0.0] * 6, pose, estimate)])
            jacobian = np.empty((6, 6))
            for i in range(6):
                ahead, behind = (
                    error_at([sign * step if k == i else 0.0 for k in range(6)], pose, estimate)
                    for sign in (1, -1)
                )
                jacobian[:, i] = [float(x) for x in (ahead - behind) / (2 * step)]
            gradient += jacobian.T @ known @ error
            expected += jacobian.T @ known @ jacobian
            distance += float(error @ known @ error)
    sigma = np.sqrt(np.diag(np.linalg.inv(expected)))
    # By how much of its own standard deviation the pose is off the minimum; a double's pose is known to
    # 1e-14.
    assert np.abs(np.linalg.solve(expected, gradient) / sigma).max() < 1e-6
    assert np.allclose(information * sigma[:, None] * sigma, expected * sigma[:, None] * sigma, atol=1e-8)
    assert squared == pytest.approx(distance, rel=1e-7, abs=1e-9)


def test_the_distance_of_right_estimates_is_chi_squared_and_the_fused_pose_is_as_good_as_it_says() -> None:
    random = np.random.default_rng(5)
    distances, errors = [], []
    for _ in range(2000):
        truth = np.asarray(geometry.se3_exp(random.normal(size=6) * [1, 1, 1, 20, 20, 20]))
        looks = []
        for _look in range(2):
            rows = random.normal(size=(9, 6)) * SCALE
            known = rows.T @ rows
            error = np.linalg.solve(np.linalg.cholesky(known).T, random.normal(size=6))
            looks += [np.asarray(geometry.se3_exp(-error)) @ truth, known]
        pose, information, squared = geometry.fuse_poses(*looks)
        error = np.asarray(geometry.se3_log(truth @ np.linalg.inv(pose)))
        distances.append(squared)
        errors.append(error @ information @ error)
    # 2000 draws of a law with probability 1e-4 of failing, once; the seed is fixed.
    for sample in (distances, errors):
        assert stats.kstest(sample, stats.chi2(6).cdf).pvalue > 1e-4


def test_what_one_look_leaves_free_the_other_tells() -> None:
    """Two faces at a right angle, each known along its normal: the second fills in the slide of the first."""
    first, second = np.eye(4), np.eye(4)
    first[:3, 3], second[:3, 3] = [0.01, 0.4, 0.0], [-0.3, 0.02, 0.0]
    turns = [1e6, 1e6, 1e6]
    pose, information, squared = geometry.fuse_poses(
        first, np.diag([*turns, 1e4, 0.0, 0.0]), second, np.diag([*turns, 0.0, 1e4, 0.0])
    )
    assert pose[:3, 3] == pytest.approx([0.01, 0.02, 0.0], abs=1e-12) and squared == pytest.approx(
        0.0, abs=1e-12
    )
    # Along the part's axis neither knows anything; the first pose is kept. A turn of a pose that is 0.4 mm
    # off moves it by half of that: 1e4 / 4 * 0.4² of 2e6.
    assert np.diag(information) == pytest.approx([2e6, 2e6, 2e6, 1e4, 1e4, 0.0], rel=5e-4)


def test_what_is_no_estimate_is_refused() -> None:
    good, known = np.eye(4), np.eye(6)
    with pytest.raises(RegisterError, match="estimate 1 is not symmetric"):
        geometry.fuse_poses(good, known, good, -known)
    turned = np.asarray(geometry.se3_exp([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(RegisterError, match=r"differ by 1\.000 rad"):
        geometry.fuse_poses(good, known, turned, known)


def distance_mm(pose: np.ndarray, point_mm: np.ndarray, normal: np.ndarray, offset_mm: float) -> float:
    return float(normal @ (pose[:3, :3] @ point_mm + pose[:3, 3]) - offset_mm)


@settings(max_examples=20, deadline=None)
@given(seed=seeds, knows=st.integers(3, 9))
def test_a_touched_plane_gives_the_least_distance_of_all_poses(seed: int, knows: int) -> None:
    """Against a general minimizer, which knows nothing of the fusion's steps."""
    random = np.random.default_rng(seed)
    [(first, known), _] = estimates(random, knows, 1.0)
    point_mm, normal = 10.0 * random.normal(size=3), random.normal(size=3)
    normal /= np.linalg.norm(normal)
    sigma_mm = random.uniform(0.02, 0.2)
    offset_mm = distance_mm(first, point_mm, normal, 0.0) + 0.3 * random.normal()

    def residuals(twist: np.ndarray) -> np.ndarray:
        scaled = twist / SCALE
        moved = np.asarray(geometry.se3_exp(scaled)) @ first
        return np.append(root @ scaled, distance_mm(moved, point_mm, normal, offset_mm) / sigma_mm)

    values, vectors = np.linalg.eigh(known)
    root = np.sqrt(values.clip(0.0))[:, None] * vectors.T
    solved = optimize.least_squares(residuals, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    pose, information, squared = geometry.fuse_plane(first, known, point_mm, normal, offset_mm, sigma_mm)
    assert squared == pytest.approx(2.0 * solved.cost, rel=1e-6, abs=1e-9)
    # Along what neither knows there are many poses at the least distance: all of them are as far from the
    # plane.
    best = np.asarray(geometry.se3_exp(solved.x / SCALE)) @ first
    assert distance_mm(pose, point_mm, normal, offset_mm) == pytest.approx(
        distance_mm(best, point_mm, normal, offset_mm), abs=1e-6
    )
    there = pose[:3, :3] @ point_mm + pose[:3, 3]
    row = np.append(np.cross(there, normal), normal) / sigma_mm
    # The plane adds information along its own direction alone.
    step = np.linalg.norm(np.asarray(geometry.se3_log(pose @ np.linalg.inv(first))) * SCALE)
    expected = known + np.outer(row, row)
    scale = np.sqrt(np.diag(expected))
    assert np.abs((information - expected) / np.outer(scale, scale)).max() < 1e-6 + 1e-2 * step


def test_a_touched_plane_is_as_far_as_it_says() -> None:
    random = np.random.default_rng(6)
    distances = []
    for _ in range(2000):
        truth = np.asarray(geometry.se3_exp(random.normal(size=6) * [1, 1, 1, 20, 20, 20]))
        rows = random.normal(size=(9, 6)) * SCALE
        known = rows.T @ rows
        error = np.linalg.solve(np.linalg.cholesky(known).T, random.normal(size=6))
        found = np.asarray(geometry.se3_exp(-error)) @ truth
        point_mm, normal = 10.0 * random.normal(size=3), random.normal(size=3)
        normal /= np.linalg.norm(normal)
        offset_mm = distance_mm(truth, point_mm, normal, 0.0) + 0.05 * random.normal()
        distances.append(geometry.fuse_plane(found, known, point_mm, normal, offset_mm, 0.05)[2])
    assert stats.kstest(distances, stats.chi2(1).cdf).pvalue > 1e-4


def test_what_is_no_plane_is_refused() -> None:
    good, known, along = np.eye(4), np.eye(6), [0.0, 1.0, 0.0]
    with pytest.raises(RegisterError, match="sigma_mm of the plane contact is 0; valid is above 0"):
        geometry.fuse_plane(good, known, [0, 0, 0], along, 1.0, 0.0)
    with pytest.raises(RegisterError, match="the length of normal of the plane contact is 2"):
        geometry.fuse_plane(good, known, [0, 0, 0], [0.0, 2.0, 0.0], 1.0, 0.1)
