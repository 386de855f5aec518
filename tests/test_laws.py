"""Laws of SO(3) and SE(3) at 4 ulp: every function against mpmath at 60 digits, on the doubles that it was
given.

An ulp is that of the largest entry of the result. A smaller entry is a sum of terms as large as that one, or
larger: where it cancels, its own ulp means nothing, and no caller can use more digits of it than of the
others. A translation is a vector that was turned, which is off by as much whichever way it points: its ulp is
the rounding unit times the length of what was turned (by the largest entry, 4.4 ulp are met once in
thousands). |ω| is up to π, as rotation vectors are kept; beyond, the argument's own ulp moves sine and cosine
by more.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Iterable

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gelstereo import geometry

MOST_ULP = 4.0
PI = math.pi

directions = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .map(np.array)
    .filter(lambda v: np.abs(v).max() > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)
#: Near 0 by powers of ten, near π from 1e-1 to 1e-12 short of it, π itself, and all between.
angles = st.one_of(
    st.floats(-300, 0).map(lambda power: 10.0**power),
    st.floats(-12, -1).map(lambda power: PI - 10.0**power),
    st.just(PI),
    st.floats(0.1, PI),
)
vectors = st.tuples(*[st.floats(-1e3, 1e3)] * 3).map(np.array).filter(lambda v: np.abs(v).max() > 1e-3)


@pytest.fixture(autouse=True)
def digits() -> Iterable[None]:
    # Cancellation in the reference's own coefficients takes 24 of them at most: below 1e-12 it is a series.
    with mpmath.workdps(60):
        yield


def exact(values: np.ndarray) -> mpmath.matrix:
    return mpmath.matrix([mpmath.mpf(float(x)) for x in values])


def hat(omega: mpmath.matrix) -> mpmath.matrix:
    x, y, z = omega
    return mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def exact_left_jacobian(omega: np.ndarray) -> mpmath.matrix:
    k, theta = hat(exact(omega)), mpmath.norm(exact(omega))
    if theta < mpmath.mpf("1e-12"):
        b, c = mpmath.mpf(1) / 2 - theta**2 / 24, mpmath.mpf(1) / 6 - theta**2 / 120
    else:
        b, c = (1 - mpmath.cos(theta)) / theta**2, (theta - mpmath.sin(theta)) / theta**3
    return mpmath.eye(3) + k * b + k * k * c


def exact_rotation(q: np.ndarray) -> mpmath.matrix:
    return exact_rotation_of(exact(q))


def exact_rotation_of(q: mpmath.matrix) -> mpmath.matrix:
    """1 + 2 w K + 2 K²; that the length is an ulp off 1 is the quaternion's error."""
    x, y, z, w = q
    k = hat(mpmath.matrix([x, y, z]))
    return mpmath.eye(3) + k * (2 * w) + k * k * 2


def ulps(found: np.ndarray, expected: mpmath.matrix, least: float = 0.0) -> float:
    """Largest error of an entry, in ulps of the largest entry of the result, or of this if it is less."""
    entries = list(expected)
    largest = max(least, *(abs(float(e)) for e in entries))
    error = max(abs(mpmath.mpf(float(a)) - b) for a, b in zip(np.ravel(found), entries, strict=True))
    return float(error / mpmath.mpf(math.ulp(largest)))


def ulps_of_length(found: np.ndarray, expected: mpmath.matrix, turned: np.ndarray) -> float:
    """Length of the error in rounding units of the length of what was turned."""
    error = mpmath.norm(exact(found) - expected)
    return float(error / (mpmath.norm(exact(turned)) * math.ulp(1.0)))


@given(directions, angles)
def test_exponential_of_a_rotation(direction: np.ndarray, angle: float) -> None:
    omega = direction * angle
    half = mpmath.norm(exact(omega)) / 2
    vector = exact(omega) * (mpmath.sin(half) / half / 2)
    assert ulps(geometry.so3_exp(omega), mpmath.matrix([*vector, mpmath.cos(half)])) <= MOST_ULP


@given(directions, angles)
def test_logarithm_of_a_rotation(direction: np.ndarray, angle: float) -> None:
    q = np.array(geometry.so3_exp(direction * angle))
    q = q if q[3] >= 0 else -q
    vector, w = exact(q[:3]), mpmath.mpf(float(q[3]))
    length = mpmath.norm(vector)
    # Its direction counts: to unit length it is good to an ulp only.
    expected = vector * (2 * mpmath.atan2(length, w) / length)
    assert ulps(geometry.so3_log(q), expected) <= MOST_ULP


@given(directions, angles)
@example(np.array([1.0, 0.0, 0.0]), 1.5)
def test_left_jacobian_and_its_inverse(direction: np.ndarray, angle: float) -> None:
    omega = direction * angle
    expected = exact_left_jacobian(omega)
    assert ulps(geometry.so3_left_jacobian(omega), expected) <= MOST_ULP
    assert ulps(geometry.so3_left_jacobian_inverse(omega), expected**-1) <= MOST_ULP


@given(directions, angles, vectors)
def test_exponential_of_a_motion(direction: np.ndarray, angle: float, v: np.ndarray) -> None:
    omega = direction * angle
    pose = geometry.se3_exp(np.concatenate([omega, v]))
    # |V v| goes down to 2 / π of |v|: cancellation in V v.
    assert ulps_of_length(pose[:3, 3], exact_left_jacobian(omega) * exact(v), v) <= MOST_ULP
    # The matrix of the quaternion that it holds; what the quaternion itself is worth is tested above.
    assert ulps(pose[:3, :3], exact_rotation(np.array(geometry.so3_exp(omega))), 1.0) <= MOST_ULP


@given(directions, angles, vectors)
def test_logarithm_of_a_motion(direction: np.ndarray, angle: float, v: np.ndarray) -> None:
    pose = np.array(geometry.se3_exp(np.concatenate([direction * angle, v])))
    twist = np.array(geometry.se3_log(pose))
    omega = geometry.so3_log(geometry.so3_from_matrix(pose[:3, :3]))
    assert ulps(twist[:3], exact(omega)) <= MOST_ULP
    # V⁻¹ of the rotation vector that was given back, on the translation that was given.
    expected = exact_left_jacobian(twist[:3]) ** -1 * exact(pose[:3, 3]) if twist[:3].any() else exact(v)
    assert ulps_of_length(twist[3:], expected, pose[:3, 3]) <= MOST_ULP


@given(directions, angles)
def test_quaternion_of_a_matrix(direction: np.ndarray, angle: float) -> None:
    omega = direction * angle
    half = mpmath.norm(exact(omega)) / 2
    expected = mpmath.matrix([*(exact(omega) * (mpmath.sin(half) / half / 2)), mpmath.cos(half)])
    # Rounded once: the matrix that is nearest to the rotation.
    q = geometry.so3_from_matrix(np.array(exact_rotation_of(expected).tolist(), dtype=float))
    either = [ulps(sign * np.array(q), expected, 1.0) for sign in (1.0, -1.0)]
    # At half a turn, where round-off chooses the sign, either is right.
    assert (min(either) if abs(q[3]) < 1e-15 else either[0]) <= MOST_ULP


@given(directions, angles, vectors)
def test_exponential_and_logarithm_undo_each_other(
    direction: np.ndarray, angle: float, v: np.ndarray
) -> None:
    """Both ways; a step each, and beside half a turn the one that V and its inverse stretch by."""
    omega = direction * angle
    back = np.array(geometry.so3_log(geometry.so3_exp(omega)))
    # Where the axis's own round-off makes it more than half a turn, the other end is right.
    ends = [ulps(sign * back, exact(omega)) for sign in (1.0, -1.0)]
    assert (min(ends) if PI - angle < 1e-15 else ends[0]) <= 2.0 * MOST_ULP
    pose = np.array(geometry.se3_exp(np.concatenate([omega, v])))
    again = np.array(geometry.se3_exp(geometry.se3_log(pose)))
    # The matrix of a rotation, the quaternion of that, its logarithm and exponential.
    assert ulps(again[:3, :3], mpmath.matrix(pose[:3, :3].tolist()), 1.0) <= 4.0 * MOST_ULP
    assert ulps_of_length(again[:3, 3], exact(pose[:3, 3]), v) <= 4.0 * MOST_ULP


def test_every_function_has_a_law() -> None:
    source = inspect.getsource(sys.modules[__name__])
    held = set(re.findall(r"geometry\.(s[oe]3_\w+)\(", source))
    assert held == {name for name in dir(geometry) if name.startswith(("so3_", "se3_"))}
