"""Hard cases 1 to 4: rotations and motions against mpmath at 50 digits, where they lose digits.

The doubles given are taken as exact. Bounds are in units of round-off, U = 2^-53, half an ulp of 1, and
scaled by the condition number of the case.
"""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import PoseError, geometry

mpmath.mp.dps = 50
U = 2.0**-53
PI = float(np.pi)

directions = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .map(np.array)
    .filter(lambda v: np.abs(v).max() > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)
# From the smallest powers of ten to 1, evenly by their logarithm.
small_angles = st.floats(-300, 0).map(lambda power: 10.0**power)
# How far from half a turn, on the near side and none at all.
gaps = st.one_of(st.just(0.0), st.floats(-12, -1).map(lambda power: 10.0**power))
quaternion_parts = st.tuples(*[st.floats(-1, 1)] * 4).map(np.array).filter(lambda q: np.abs(q).max() > 0.1)


def exact(vector: np.ndarray) -> mpmath.matrix:
    return mpmath.matrix([mpmath.mpf(float(x)) for x in vector])


def hat(omega: mpmath.matrix) -> mpmath.matrix:
    x, y, z = omega
    return mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def exact_quaternion(omega: np.ndarray) -> list[mpmath.mpf]:
    vector = exact(omega)
    theta = mpmath.norm(vector)
    return [*(vector * (mpmath.sin(theta / 2) / theta)), mpmath.cos(theta / 2)]


def exact_logarithm(q: np.ndarray) -> mpmath.matrix:
    """Of a quaternion near unit length, w >= 0: its direction counts, not its length."""
    vector, w = exact(q[:3]), mpmath.mpf(float(q[3]))
    n = mpmath.norm(vector)
    return vector * (2 * mpmath.atan2(n, w) / n)


def exact_jacobian(omega: np.ndarray) -> mpmath.matrix:
    # The coefficients cancel 2/3 of the leading digits at 1e-300: the series itself is exact there.
    k, theta = hat(exact(omega)), mpmath.norm(exact(omega))
    if theta < mpmath.mpf("1e-12"):
        b = mpmath.mpf(1) / 2 - theta**2 / 24
        c = mpmath.mpf(1) / 6 - theta**2 / 120
    else:
        b, c = (1 - mpmath.cos(theta)) / theta**2, (theta - mpmath.sin(theta)) / theta**3
    return mpmath.eye(3) + k * b + k * k * c


def worst(found: np.ndarray, expected: mpmath.matrix | list[mpmath.mpf]) -> float:
    """Largest difference of entries, computed with 50 digits."""
    pairs = zip(np.ravel(found), list(expected), strict=True)
    return float(max(abs(mpmath.mpf(float(a)) - b) for a, b in pairs))


@given(directions, gaps)
def test_row_01_beside_half_a_turn(direction: np.ndarray, gap: float) -> None:
    omega = direction * (PI - gap)
    q = geometry.so3_exp(omega)
    # Half the length carries its ulp, up to 2 U, into sine and cosine; sine, quotient and products add
    # theirs.
    assert worst(q, exact_quaternion(omega)) <= 6 * U
    # The logarithm of exactly that quaternion: atan2, its quotient and products, on an angle of π.
    assert worst(geometry.so3_log(q), exact_logarithm(q if q[3] >= 0 else -q)) <= 6 * U * PI


@given(directions)
def test_row_01_exactly_half_a_turn(direction: np.ndarray) -> None:
    omega = geometry.so3_log(np.array([*direction, 0.0]))
    # Either end of the axis is right, and its length is π.
    assert abs(np.linalg.norm(omega) - PI) <= 6 * U * PI
    assert np.abs(np.cross(omega, direction)).max() <= 12 * U * PI


@given(directions, small_angles)
def test_row_02_small_angles_keep_all_their_digits(direction: np.ndarray, angle: float) -> None:
    omega = direction * angle
    q = geometry.so3_exp(omega)
    # Relative to the angle: length, sine, quotient and two products. The last term is a denormal's own step.
    assert worst(q[:3], exact_quaternion(omega)[:3]) <= 6 * U * angle + 5e-324
    assert worst(geometry.so3_log(q), exact(omega)) <= 12 * U * angle + 1e-323


@given(directions, st.one_of(small_angles, st.floats(1e-9, 1e-7), st.floats(1.4, 1.6), st.floats(0.1, 6.2)))
def test_row_03_left_jacobian_and_inverse(direction: np.ndarray, angle: float) -> None:
    omega = direction * angle
    expected = exact_jacobian(omega)
    # Entries are at most 1; each is a sum of three terms with coefficients good to 4 U, times θ and θ².
    assert worst(geometry.so3_left_jacobian(omega), expected) <= 16 * U
    # The inverse has entries up to h / sin h, h = θ/2, and a change of θ by its round-off changes them by up
    # to its derivative, h² / sin² h: this is their condition towards a full turn.
    half = angle / 2
    condition = max(1.0, (half / np.sin(half)) ** 2)
    assert worst(geometry.so3_left_jacobian_inverse(omega), expected**-1) <= 16 * U * condition


@given(directions, small_angles, st.tuples(*[st.floats(-1e3, 1e3)] * 3).map(np.array))
def test_row_03_motions_with_small_rotations(direction: np.ndarray, angle: float, v: np.ndarray) -> None:
    omega = direction * angle
    pose = geometry.se3_exp(np.concatenate([omega, v]))
    size = float(np.abs(v).sum())  # A sum of squares would underflow.
    assert worst(pose[:3, 3], exact_jacobian(omega) * exact(v)) <= 16 * U * size + 5e-324
    # A matrix keeps angles to U, not relative to themselves.
    back = geometry.se3_log(pose)
    assert np.abs(back[:3] - omega).max() <= 8 * U
    assert np.abs(back[3:] - v).max() <= 32 * U * size + 5e-324


@given(quaternion_parts, st.floats(-140, 140))
def test_row_04_sign_and_length_do_not_matter(q: np.ndarray, power: float) -> None:
    omega = geometry.so3_log(q)
    other = geometry.so3_log(-q * 10.0**power)
    # Scaling rounds each part by U, normalisation by 3 U, the angle follows; at half a turn either sign is
    # right.
    difference = min(
        np.abs(omega - other).max(), np.abs(omega + other).max() if abs(q[3]) < 4 * U else np.inf
    )
    assert difference <= 32 * U * PI


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [1e-200, 0, 0, 1e-200], [np.nan, 0, 0, 1], [0, np.inf, 0, 1]])
def test_row_04_quaternions_without_a_direction_are_refused(q: list[float]) -> None:
    with pytest.raises(PoseError):
        geometry.so3_log(np.array(q, dtype=float))


@given(directions, st.one_of(small_angles, gaps.map(lambda gap: PI - gap), st.floats(0.1, 3.0)))
def test_row_04_matrix_to_quaternion(direction: np.ndarray, angle: float) -> None:
    omega = direction * angle
    k, theta = hat(exact(omega)), mpmath.norm(exact(omega))
    sinc = mpmath.sin(theta) / theta
    versine = 2 * (mpmath.sin(theta / 2) / theta) ** 2
    matrix = mpmath.eye(3) + k * sinc + k * k * versine
    rounded = np.array(matrix.tolist(), dtype=float)
    q = geometry.so3_from_matrix(rounded)
    # Entries of the matrix are rounded by U/2 to U; the largest of the four numbers is at least 1/2, so the
    # others, sums of two entries over four times it, are good to 2 U, and normalisation adds 2 U.
    expected = exact_quaternion(omega)
    error = min(worst(q, expected), worst(-q, expected) if abs(q[3]) < 4 * U else np.inf)
    assert error <= 6 * U


@pytest.mark.parametrize(
    "matrix", [np.diag([-1.0, 1.0, 1.0]), np.eye(3) * 1.001, np.zeros((3, 3)), np.full((3, 3), np.nan)]
)
def test_row_04_matrices_that_are_no_rotation_are_refused(matrix: np.ndarray) -> None:
    with pytest.raises(PoseError):
        geometry.so3_from_matrix(matrix)
