"""Rotations and motions against mpmath at 50 digits, fits and neighbours against NumPy and SciPy.

Bounds are in units of round-off: u = 2^-53, half an ulp of 1.
"""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial import cKDTree

from gelstereo import FingerKinematics, PoseError, RegisterError, geometry

mpmath.mp.dps = 50
U = 2.0**-53

unit_vectors = hnp.arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)
# From below the square root of the smallest double to just short of half a turn.
angles = st.one_of(st.floats(1e-14, 3.1), st.sampled_from([1e-14, 1e-12, 1e-8, 1e-4, 1.4999, 1.5001]))


@st.composite
def rotation_vectors(draw: st.DrawFn) -> np.ndarray:
    axis = draw(unit_vectors)
    return axis / np.linalg.norm(axis) * draw(angles)


def exact_matrix(omega: np.ndarray) -> mpmath.matrix:
    """Rodrigues' formula, with the doubles taken as exact."""
    k, theta = exact_hat(omega)
    return mpmath.eye(3) + k * (mpmath.sin(theta) / theta) + k * k * ((1 - mpmath.cos(theta)) / theta**2)


def exact_hat(omega: np.ndarray) -> tuple[mpmath.matrix, mpmath.mpf]:
    x, y, z = (mpmath.mpf(float(v)) for v in omega)
    return mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]]), mpmath.sqrt(x * x + y * y + z * z)


def exact_jacobian(omega: np.ndarray) -> mpmath.matrix:
    k, theta = exact_hat(omega)
    b, c = (1 - mpmath.cos(theta)) / theta**2, (theta - mpmath.sin(theta)) / theta**3
    return mpmath.eye(3) + k * b + k * k * c


def to_array(matrix: mpmath.matrix) -> np.ndarray:
    return np.array(matrix.tolist(), dtype=np.float64)


def matrix_of(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@given(rotation_vectors())
def test_exponential_is_rodrigues_formula(omega: np.ndarray) -> None:
    # Quaternion components carry 2 u each; an entry sums up to six products of them.
    error = np.abs(matrix_of(geometry.so3_exp(omega)) - to_array(exact_matrix(omega))).max()
    assert error <= 16 * U


@given(rotation_vectors())
def test_logarithm_undoes_the_exponential(omega: np.ndarray) -> None:
    back = geometry.so3_log(geometry.so3_exp(omega))
    # Relative to the angle; near half a turn the quaternion's own round-off of w sets the angle.
    assert np.linalg.norm(back - omega) <= 16 * U * np.linalg.norm(omega) + 8 * U * (
        np.linalg.norm(omega) > 3
    )


@given(rotation_vectors())
def test_jacobians_against_fifty_digits(omega: np.ndarray) -> None:
    exact = exact_jacobian(omega)
    assert np.abs(geometry.so3_left_jacobian(omega) - to_array(exact)).max() <= 16 * U
    # Entries of the inverse reach |ω|/2 cot(|ω|/2) and |ω|, so scale by their size.
    inverse = to_array(exact**-1)
    found = geometry.so3_left_jacobian_inverse(omega)
    assert np.abs(found - inverse).max() <= 32 * U * max(1.0, np.abs(inverse).max())


@given(rotation_vectors(), hnp.arrays(np.float64, 3, elements=st.floats(-1e3, 1e3)))
def test_motions_go_there_and_back(omega: np.ndarray, v: np.ndarray) -> None:
    twist = np.concatenate([omega, v])
    back = geometry.se3_log(geometry.se3_exp(twist))
    # Through a matrix, so that an angle near half a turn loses digits as 1 / (π - |ω|).
    condition = 1.0 / (np.pi - np.linalg.norm(omega))
    assert np.linalg.norm(back - twist) <= 64 * U * condition * max(1.0, np.linalg.norm(v))


@pytest.mark.parametrize("gap", [0.0, *(10.0**-k for k in range(1, 13))])
def test_row_01_logarithm_near_half_a_turn(gap: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    angle = np.pi - gap
    q = [float(c) for c in mpmath.matrix(axis.tolist()) * mpmath.sin(mpmath.mpf(angle) / 2)]
    q.append(float(mpmath.cos(mpmath.mpf(angle) / 2)))
    found = np.array(geometry.so3_log(q))
    # At half a turn the axis has no sign.
    error = min(np.linalg.norm(found - axis * angle), np.linalg.norm(found + axis * angle))
    assert error <= 8 * U * np.pi
    assert np.linalg.norm(found) <= np.pi * (1 + 2 * U)


@given(st.floats(1e-100, 1e100), rotation_vectors())
def test_row_04_quaternions_of_any_length_and_sign(scale: float, omega: np.ndarray) -> None:
    q = np.array(geometry.so3_exp(omega))
    for sign in (1.0, -1.0):
        found = geometry.so3_log(sign * scale * q)
        assert np.linalg.norm(found - omega) <= 32 * U * (1.0 + np.linalg.norm(omega))


@pytest.mark.parametrize("q", [np.zeros(4), [np.nan, 0, 0, 1], [np.inf, 0, 0, 1], np.full(4, 1e-200)])
def test_row_04_quaternions_without_a_direction(q: np.ndarray) -> None:
    with pytest.raises(PoseError):
        geometry.so3_log(q)


def test_matrices_that_are_no_rotation() -> None:
    for matrix, word in [(np.diag([1, 1, -1]), "-1.0"), (2 * np.eye(3), "8.0"), (np.zeros((3, 3)), "0.0")]:
        with pytest.raises(PoseError, match=f"determinant is {word}"):
            geometry.so3_from_matrix(matrix)
    with pytest.raises(PoseError, match="transposed"):
        geometry.se3_log(geometry.se3_exp([0, 0, 0, 1, 2, 3]).T)


def kabsch(source: np.ndarray, target: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The textbook's answer: SVD with the determinant's sign."""
    share = weights / weights.sum()
    means = share @ source, share @ target
    u, _, vt = np.linalg.svd((source - means[0]).T @ ((target - means[1]) * share[:, None]))
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    out = np.eye(4)
    out[:3, :3] = vt.T @ sign @ u.T
    out[:3, 3] = means[1] - out[:3, :3] @ means[0]
    return out


@given(st.integers(0, 2**32 - 1), st.integers(4, 30), rotation_vectors(), st.floats(0.0, 0.1))
def test_rigid_fit_is_the_svd_solution(seed: int, count: int, omega: np.ndarray, noise_mm: float) -> None:
    rng = np.random.default_rng(seed)
    source, weights = rng.uniform(-10, 10, (count, 3)), rng.uniform(0.1, 1.0, count)
    target = (
        source @ matrix_of(geometry.so3_exp(omega)).T
        + [3.0, -2.0, 1.0]
        + noise_mm * rng.normal(size=(count, 3))
    )
    found, reference = geometry.rigid_fit(source, target, weights), kabsch(source, target, weights)
    # The rotation's condition is the spread over the gap of the two largest singular values' sums; random
    # clouds of four or more points in a 20 mm box stay below 1e3 of it.
    assert np.abs(found - reference).max() <= 1e3 * 64 * U * 20.0


def test_row_05_a_mirrored_cloud_is_not_reflected() -> None:
    source = np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 3], [1, 1, 1]])
    found = geometry.rigid_fit(source, source * [-1, 1, 1])
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0, abs=16 * U)


@pytest.mark.parametrize("weights", [[0, 0, 0], [1, -1, 1], [1, np.nan, 1], [1, 1]])
def test_row_06_weights_without_meaning(weights: list[float]) -> None:
    points = np.eye(3)
    with pytest.raises(RegisterError):
        geometry.rigid_fit(points, points, weights)


@given(
    # A coarse grid makes duplicates and ties, which the index breaks.
    hnp.arrays(
        np.float64, st.tuples(st.integers(1, 200), st.just(3)), elements=st.integers(-3, 3).map(float)
    ),
    hnp.arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-4, 4)),
)
def test_row_12_nearest_is_brute_force(points: np.ndarray, queries: np.ndarray) -> None:
    indices, distances = geometry.nearest(points, queries)
    squares = ((queries[:, None] - points[None]) ** 2).sum(axis=2)
    assert np.array_equal(indices, squares.argmin(axis=1))  # argmin takes the first of equals
    assert np.allclose(distances, np.sqrt(squares.min(axis=1)), rtol=4 * U, atol=0)


def test_nearest_is_scipys() -> None:
    rng = np.random.default_rng(3)
    points, queries = rng.normal(size=(3000, 3)), rng.normal(size=(500, 3))
    indices, distances = geometry.nearest(points, queries)
    reference_distances, reference = cKDTree(points).query(queries)
    assert np.array_equal(indices, reference)
    assert np.allclose(distances, reference_distances, rtol=8 * U)


def test_nearest_refuses_what_has_no_answer() -> None:
    with pytest.raises(RegisterError, match="no points"):
        geometry.nearest(np.empty((0, 3)), [[0.0, 0, 0]])
    with pytest.raises(RegisterError, match="row 1 of queries"):
        geometry.nearest(np.eye(3), [[0.0, 0, 0], [np.nan, 0, 0]])


@pytest.mark.parametrize(
    ("fingers", "stroke_mm"),
    [
        (FingerKinematics.robotiq_2f85(), (0.9, 85.4)),
        (FingerKinematics.robotiq_2f140(), (0.0, 140.0)),
        (FingerKinematics.on_robot_rg2(), (0.0, 110.0)),
        (FingerKinematics.on_robot_rg6(), (0.0, 160.0)),
    ],
    ids=["2F-85", "2F-140", "RG2", "RG6"],
)
def test_fingers_open_by_the_makers_stroke_and_advance_while_they_close(
    fingers: FingerKinematics, stroke_mm: tuple[float, float]
) -> None:
    assert fingers.width_range_mm == pytest.approx(stroke_mm, abs=0.1)
    pads_mm = np.array([fingers.pad_mm(width) for width in np.linspace(*fingers.width_range_mm, 50)])
    assert pads_mm[:, 0] == pytest.approx(np.linspace(*fingers.width_range_mm, 50) / 2)
    # Between closed and open the pads come back by more than the gel is thick: a width alone does not place a
    # sensor.
    assert pads_mm[0, 2] - pads_mm[-1, 2] > 10.0
