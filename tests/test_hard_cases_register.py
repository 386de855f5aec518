"""Hard cases 5 to 12 of registration: against a singular value decomposition, brute force and
closed forms.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

import gelstereo
from gelstereo import RegisterError, geometry

EPS = float(np.finfo(float).eps)
#: How far R Rᵀ may be from the identity. With u = EPS / 2, the norm of a quaternion is rounded by 3 u and
#: the division by u, so its square is 1 within 8 u. A half turn's R = 1 + 2 [v]² makes that four times as
#: much. The entries of R are rounded by 5 u at most, which adds 2 sqrt(3) 5 u, and the product here by 3 u:
#: 53 u, rounded up.
ORTHONORMAL = 32 * EPS
METHODS = ["filterreg_point", "ransac_icp"]

clouds = st.integers(4, 30).flatmap(lambda n: hnp.arrays(float, (n, 3), elements=st.floats(-10, 10)))
twists = st.tuples(*[st.floats(-1.8, 1.8)] * 3, *[st.floats(-50, 50)] * 3).map(np.array)


def kabsch(source: np.ndarray, target: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation by singular values with the sign of the determinant (Kabsch 1976), and the singular values."""
    centred = [p - np.average(p, axis=0, weights=weights) for p in (source, target)]
    u, values, vt = np.linalg.svd((centred[0] * weights[:, None]).T @ centred[1])
    sign = np.sign(np.linalg.det(u @ vt))
    return vt.T @ np.diag([1, 1, sign]) @ u.T, np.array([values[0], values[1], sign * values[2]])


def moved(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def params(method: str, **register: float) -> gelstereo.Params:
    settings = {"method": method, "ransac_icp": {"hypotheses": 200}, **register}
    return gelstereo.Params().replace(register=settings)


def sphere_template(radius_mm: float, spacing_mm: float) -> gelstereo.Template:
    count = int(4 * np.pi * (radius_mm / spacing_mm) ** 2)
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    normals = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return gelstereo.Template.from_points(normals * radius_mm, normals, spacing_mm)


def cap(radius_mm: float, reach_mm: float) -> np.ndarray:
    """Lattice points on the sphere's side towards the camera."""
    x, y = (c.ravel() for c in np.meshgrid(np.arange(-2.7, 2.8, 0.9), np.arange(-2.7, 2.8, 0.9)))
    keep = np.hypot(x, y) < reach_mm
    return np.stack([x, y, -np.sqrt(radius_mm**2 - x**2 - y**2)], axis=1)[keep]


@given(clouds, twists, st.data())
def test_row_05_rigid_fit_agrees_with_singular_values(
    source: np.ndarray, twist: np.ndarray, data: st.DataObject
) -> None:
    noise = data.draw(hnp.arrays(float, source.shape, elements=st.floats(-1, 1)))
    weights = data.draw(hnp.arrays(float, len(source), elements=st.floats(0.1, 1)))
    mirror = np.diag([data.draw(st.sampled_from([1.0, -1.0])), 1, 1])
    target = moved(geometry.se3_exp(twist), source @ mirror) + noise
    rotation, values = kabsch(source, target, weights)
    # The rotation is determined to round-off over the smallest gap of Horn's matrix, 2 (s2 + s3).
    gap = (values[1] + values[2]) / values[0] if values[0] > 0 else 0
    assume(gap > 1e-6)
    fit = geometry.rigid_fit(source, target, weights)
    offset = np.abs(target).max() / np.abs(target - target.mean(axis=0)).max()
    assert np.abs(fit[:3, :3] - rotation).max() <= 64 * len(source) * EPS * (1 + offset) / gap
    assert np.linalg.det(fit[:3, :3]) > 0.999


#: What each kind keeps of a cloud.
KINDS = {
    "coplanar": lambda points: points * [1, 1, 0],
    "collinear": lambda points: points * [1, 0, 0],
    "identical": lambda points: np.repeat(points[:1], len(points), axis=0),
    "single": lambda points: points[:1],
    "all": lambda points: points,
}
#: Its mirror image is best met by a half turn whose R Rᵀ is 8.5 EPS off the identity on one processor.
HALF_TURN = np.zeros((30, 3))
HALF_TURN[[0, 5, 6, 16], 1] = 0.859375, 3.67951367, 7.03498779, -1.5
HALF_TURN[[7, 17, 18], [0, 2, 1]] = -1.35680064, 0.9, 0.18479509
#: Rotations all over, 10 degrees or less from any.
EVERYWHERE = Rotation.random(5000, random_state=5).as_matrix()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mirror", [1.0, -1.0])
@given(clouds, twists, st.booleans())
@example(HALF_TURN, np.zeros(6), True)
def test_row_05_no_rotation_fits_degenerate_points_better(
    kind: str, mirror: float, points: np.ndarray, twist: np.ndarray, is_exact: bool
) -> None:
    source = KINDS[kind](points)
    target = moved(geometry.se3_exp(twist), source * [1, 1, mirror])
    # Or anything at all, of the same number of points.
    target = target if is_exact else np.roll(points, 1, axis=1)[: len(source)]
    fit = geometry.rigid_fit(source, target)
    assert np.abs(fit[:3, :3] @ fit[:3, :3].T - np.eye(3)).max() < ORTHONORMAL
    assert np.linalg.det(fit[:3, :3]) > 0.999
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    correlation = a.T @ b
    size = np.sum(a * a) + np.sum(b * b)
    _, values = kabsch(source, target, np.ones(len(source)))
    # Squares are summed of coordinates up to 100 mm, offsets and all.
    slack = 64 * len(source) * EPS * (size + 100.0 * np.sqrt(size) + 1e4 * EPS)
    residual = np.sum((moved(fit, source) - target) ** 2)
    assert abs(residual - (size - 2 * values.sum())) <= slack
    searched = size - 2 * np.einsum("kij,ji->k", EVERYWHERE, correlation)
    assert residual <= searched.min() + slack


@pytest.mark.parametrize(
    "points",
    [[[0, 0, 0], [1, 0, 0], [3, 0, 0]], [[1, 2, 3]], [[1, 2, 3]] * 5, [[0, 0, 0], [1, 0, 0], [0, 1, 0]]],
)
def test_row_05_degenerate_points_get_a_rotation(points: list[list[float]]) -> None:
    source = np.array(points, dtype=float)
    for mirror in (1.0, -1.0):
        target = source * [1, mirror, 1] + [5, 6, 7]
        fit = geometry.rigid_fit(source, target)
        assert np.abs(fit[:3, :3] @ fit[:3, :3].T - np.eye(3)).max() < ORTHONORMAL
        assert np.linalg.det(fit[:3, :3]) > 0.999
        # A plane's mirror image is reached by half a turn, a line's and a point's by none.
        assert np.abs(moved(fit, source) - target).max() < 64 * EPS


@pytest.mark.parametrize("weights", [[0, 0, 0], [1, -1, 1], [1, np.nan, 1], [np.inf, 1, 1], [1, 1]])
def test_row_06_weights_without_meaning_are_refused(weights: list[float]) -> None:
    with pytest.raises(RegisterError):
        geometry.rigid_fit(np.eye(3), np.eye(3), np.array(weights, dtype=float))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("points", [np.empty((0, 3)), np.zeros((1, 3)), np.full((4, 3), np.nan)])
def test_row_06_patches_without_meaning_are_refused(method: str, points: np.ndarray) -> None:
    with pytest.raises(RegisterError):
        gelstereo.localize(points, sphere_template(5, 0.5), guess=np.eye(4), params=params(method))


def test_row_06_a_patch_out_of_reach_is_told_its_distance() -> None:
    with pytest.raises(RegisterError, match=r"nearest is 1\d\.\d+ mm"):
        gelstereo.localize(cap(5, 2) + [0, 0, -15], sphere_template(5, 0.5), guess=np.eye(4))


@pytest.mark.parametrize("offset_mm", [1e3, 1e6, 1e9])
def test_row_09_the_answer_moves_with_the_offset(offset_mm: float) -> None:
    method = "filterreg_point"
    template, points = sphere_template(5, 0.4), cap(5, 2.5)
    guess = geometry.se3_exp([0.02, -0.03, 0.01, 0.1, -0.2, 0.15])
    shift = np.array([offset_mm, -offset_mm, offset_mm / 2])
    here = gelstereo.localize(points, template, guess=guess, params=params(method))
    far_guess = guess.copy()
    far_guess[:3, 3] += shift
    far = gelstereo.localize(points + shift, template, guess=far_guess, params=params(method))
    # Coordinates, and translations of the iterations, are rounded by half an eps of the offset; the weakest
    # determined direction of this patch amplifies that by R / ρ = 3; both runs stop within 1e-3 of the
    # spacing.
    bound = 10 * EPS * offset_mm + 2 * 1e-3 * template.spacing_mm
    on_object = np.linalg.inv(here.t_sensor_object)
    moved_points = moved(far.t_sensor_object, moved(on_object, points)) - shift
    assert np.abs(moved_points - points).max() <= bound


@pytest.mark.parametrize("method", METHODS)
def test_row_10_a_sphere_leaves_three_rotations(method: str) -> None:
    template, points = sphere_template(5, 0.3), cap(5, 2.5)
    found = gelstereo.localize(points, template, guess=np.eye(4), params=params(method))
    assert len(found.free) == 3
    assert all("about" in str(direction) for direction in found.free)
    assert np.isfinite(found.information).all()
    # Three eigenvalues are zero to round-off; rotations are about the camera, here at the sphere's centre, 5
    # mm off.
    values = np.linalg.eigvalsh(found.information)
    assert np.abs(values[:3]).max() <= 1e3 * EPS * values[-1]
    assert values[3] > 1


# Lattices, duplicates, planes, denormals, far points.
coordinates = st.one_of(
    st.integers(-4, 4).map(float), st.floats(-1, 1), st.sampled_from([0.0, -0.0, 5e-324, -1e-310, 1e9])
)
awkward = st.integers(1, 200).flatmap(lambda n: hnp.arrays(float, (n, 3), elements=coordinates))


@given(awkward, awkward)
def test_row_12_nearest_agrees_with_brute_force(points: np.ndarray, queries: np.ndarray) -> None:
    indices, distances = geometry.nearest(points, queries)
    # In the same order of additions, so that ties are ties here too; argmin takes the first.
    d = points[None, :, :] - queries[:, None, :]
    squares = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]
    assert np.array_equal(indices, squares.argmin(axis=1))
    assert np.array_equal(distances, np.sqrt(squares.min(axis=1)))


def test_row_12_thousands_of_duplicates() -> None:
    indices, distances = geometry.nearest(np.tile([1.0, 2.0, 2.0], (5000, 1)), np.zeros((1, 3)))
    assert (indices[0], distances[0]) == (0, 3.0)
