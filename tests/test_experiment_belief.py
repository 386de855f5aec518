"""What a robot believes of a pose: sampled likelihoods against closed forms, on contacts that are made up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.experiments.insertion.belief import Belief, drawn
from gelstereo_bench.experiments.insertion.chance import Prior
from gelstereo_bench.experiments.insertion.sampling import InPlane, _density, believed
from gelstereo_bench.experiments.insertion.sense import Found

#: A part that lies along the sensor's y, its face towards the camera, 4 mm below its axis.
POSE = np.array([[0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 1.0, -15.0], [1.0, 0.0, 0.0, 32.0], [0.0, 0.0, 0.0, 1.0]])
CENTRE_MM = np.array([3.0, 0.0, 28.0])
PRIOR = Prior()


def face(pose: np.ndarray, log_likelihood: float) -> Found:
    """Face that is known by its heights alone: 100 markers over 8 x 16 mm, each to 0.01 mm."""
    x, y = np.meshgrid(np.linspace(-4.0, 4.0, 10), np.linspace(-8.0, 8.0, 10))
    points = CENTRE_MM + np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    normal = np.array([0.0, 0.0, -1.0])
    rows = np.column_stack([np.cross(points, normal), np.tile(normal, (len(points), 1))])
    return Found(pose, rows.T @ rows / 0.01**2, True, (), CENTRE_MM, log_likelihood)


def likelihood(log_of_x):
    """Registration that finds the pose where it is held, and the likelihood of how far that is."""
    plane = InPlane.of(face(POSE, 0.0))
    return lambda guess, _by_mm: face(guess, float(log_of_x(plane.along(guess))))


@given(x=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)).map(np.array))
def test_how_far_a_pose_is_tells_how_far_one_went(x: np.ndarray) -> None:
    plane = InPlane.of(face(POSE, 0.0))
    # A turn also carries the point that the shift is read at, by its square over the radius.
    assert np.allclose(plane.along(plane.pose(x)), x, atol=0.02 * float(x @ x) + 1e-9)
    # The face stays where it is: neither raised nor tilted.
    moved = plane.pose(x) @ np.linalg.inv(POSE)
    assert np.allclose(moved[2], [0.0, 0.0, 1.0, 0.0], atol=1e-5)


def test_kernels_are_a_density() -> None:
    centres, weights = np.array([[0.0, 0.0], [0.3, -0.1]]), np.array([0.25, 0.75])
    step_mm = 0.01
    axis = np.arange(-4.0, 4.0, step_mm)
    x = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    # A sum over a grid of half the narrowest kernel's width is as good as an integral.
    assert _density(x, centres, weights).sum() * step_mm**2 == pytest.approx(1.0, abs=1e-3)


def spread(log_of_x, seeds: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Means and standard deviations, over both motions, of several beliefs."""
    held, plane = likelihood(log_of_x), InPlane.of(face(POSE, 0.0))
    means, sigmas = [], []
    for seed in range(seeds):
        belief = believed([held(POSE, 0.0)], held, PRIOR, seed)
        x = np.array([plane.along(belief.t_sensor_object @ np.asarray(se3_exp(m))) for m in belief.motions])
        mean = belief.weights @ x
        means.append(mean)
        sigmas.append(np.sqrt(belief.weights @ (x - mean) ** 2))
    return np.array(means), np.array(sigmas)


def test_a_plateau_is_believed_as_wide_as_it_is() -> None:
    # Nothing is told within ±0.3 mm across, 0.1 mm off where the search ended; the turn is known to 0.1 mm.
    def plateau(x: np.ndarray) -> float:
        return -0.5 * (x[1] / 0.1) ** 2 - (0.0 if abs(x[0] - 0.1) < 0.3 else 50.0)

    means, sigmas = spread(plateau)
    # 12 beliefs of 12 effective draws or more: 1 / √144 of a standard deviation for the mean, four of them.
    assert np.abs(means.mean(axis=0) - [0.1, 0.0]).max() < 4.0 * 0.6 / np.sqrt(12.0) / 12.0
    assert np.allclose(sigmas.mean(axis=0), [0.6 / np.sqrt(12.0), 0.1], rtol=0.2)


def test_two_peaks_are_both_believed() -> None:
    # Both alike, 0.4 mm apart: half of the beliefs lies at each, whichever the search found.
    def peaks(x: np.ndarray) -> float:
        squared = (x[0] * np.array([1.0, 1.0]) - np.array([0.0, 0.4])) ** 2 + x[1] ** 2
        return float(np.logaddexp.reduce(-0.5 * squared / 0.05**2))

    means, sigmas = spread(peaks)
    assert means[:, 0].mean() == pytest.approx(0.2, abs=4.0 * 0.2 / 12.0)
    assert sigmas[:, 0].mean() == pytest.approx(np.hypot(0.2, 0.05), rel=0.2)


def test_a_pose_that_is_known_is_believed_with_its_covariance() -> None:
    known = face(POSE, 0.0)
    sharp = Found(POSE, known.information + np.eye(6) / 1e-4**2, True, (), CENTRE_MM, 0.0)
    refuses = [0]

    def held(guess: np.ndarray, _by_mm: float) -> Found | None:
        # A registration that fails is no evidence.
        refuses[0] += 1
        return None if refuses[0] % 2 else face(guess, -100.0)

    belief = believed([sharp], held, PRIOR, 1)
    assert np.array_equal(belief.t_sensor_object, POSE) and len(belief.weights) == 1
    assert np.allclose(belief.covariance, Belief.normal(sharp, PRIOR).covariance)


def test_what_nothing_can_be_registered_beside_is_believed_alone() -> None:
    belief = believed([face(POSE, 0.0)], lambda _guess, _by_mm: None, PRIOR, 1)
    assert len(belief.weights) == 1
    assert np.allclose(belief.covariance, Belief.normal(face(POSE, 0.0), PRIOR).covariance)


def test_drawn_motions_have_the_covariance_of_their_beliefs() -> None:
    random = np.random.default_rng(3)
    motions = random.normal(size=(40, 6)) * 0.02
    weights = np.full(40, 1.0 / 40.0)
    belief = Belief(POSE, motions - motions.mean(axis=0), weights, np.diag(np.linspace(1e-4, 4e-4, 6)))
    found = np.cov(belief.draw(random, 20000).T)
    # An element of a covariance of that many draws is known to 1 %.
    scale = np.sqrt(np.outer(np.diag(belief.covariance), np.diag(belief.covariance)))
    assert np.abs((found - belief.covariance) / scale).max() < 0.05
    # The mean of four beliefs that are independent varies by a quarter.
    four = np.cov(drawn([belief] * 4, random, 20000).T)
    assert np.abs((4.0 * four - belief.covariance) / scale).max() < 0.05
    assert np.allclose(se3_log(belief.t_sensor_object @ np.linalg.inv(POSE)), 0.0)
