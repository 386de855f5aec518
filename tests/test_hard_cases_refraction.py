"""Hard cases 19 to 22: light through flat layers and the inverse of distortion against mpmath at 50 digits.

The doubles given are taken as exact. Bounds are in units of round-off, U = 2^-53, half an ulp of 1, and
scaled by the condition number of the case.
"""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import optimize

from gelstereo import Params, Rig, RigError, triangulate

mpmath.mp.dps = 50
U = 2.0**-53
F_PX, BASELINE_MM = 600.0, 10.0
CAMERAS = Rig.parallel((640, 480), F_PX, BASELINE_MM, c_px=(320.0, 240.0))

tilts = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
plates = st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(1.0, 2.0)), max_size=2)
points = st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(22.0, 45.0))


def layers(
    tilt: tuple[float, float], gap_mm: float, plates: list[tuple[float, float]], gel_index: float
) -> dict[str, Any]:
    normal = np.array([*tilt, 1.0])
    return {
        "normal": (normal / np.linalg.norm(normal)).tolist(),
        "gap_mm": gap_mm,
        "plates": [{"thickness_mm": t, "index": n} for t, n in plates],
        "gel_index": gel_index,
    }


def exact_pixel(rig: Rig, point_mm: tuple[float, ...], centre_x_mm: float) -> list[mpmath.mpf]:
    """Of an undistorted camera at (centre_x_mm, 0, 0): the sine of the ray in air by bisection, then its
    direction.
    """
    stack = rig.layers or {}
    normal = mpmath.matrix(stack["normal"])
    normal /= mpmath.norm(normal)
    at = mpmath.matrix(point_mm) - mpmath.matrix([centre_x_mm, 0, 0])
    height = (normal.T * at)[0]
    across = at - normal * height
    gap = mpmath.mpf(stack["gap_mm"]) - normal[0] * centre_x_mm
    left = max(height - gap, mpmath.mpf(0))
    path = [(min(gap, height), mpmath.mpf(1))]
    for plate in stack["plates"]:
        thickness = min(left, mpmath.mpf(plate["thickness_mm"]))
        path.append((thickness, mpmath.mpf(plate["index"])))
        left -= thickness
    path.append((left, mpmath.mpf(stack["gel_index"])))
    rho = mpmath.norm(across)

    def reach(sine: mpmath.mpf) -> mpmath.mpf:
        return sum(d * sine / mpmath.sqrt(n * n - sine * sine) for d, n in path) - rho

    low, high = mpmath.mpf(0), mpmath.mpf(1)
    for _ in range(180):
        middle = (low + high) / 2
        low, high = (middle, high) if reach(middle) < 0 else (low, middle)
    tangent = low / mpmath.sqrt(1 - low * low)
    direction = normal + across * (tangent / rho) if rho > 0 else normal
    return [F_PX * direction[0] / direction[2] + 320, F_PX * direction[1] / direction[2] + 240]


def check_against_exact(rig: Rig, point_mm: tuple[float, ...]) -> None:
    for pixel, centre_x in zip(rig.project([point_mm]), (0.0, BASELINE_MM), strict=True):
        expected = exact_pixel(rig, point_mm, centre_x)
        off = max(abs(mpmath.mpf(float(a)) - b) for a, b in zip(pixel[0], expected, strict=True))
        # Some 10 roundings of coordinates up to 45 mm, seen from 15 mm at least, and two of the pixel. Across
        # the layers a slope s in air turns an error by at most 1 + s².
        slope2 = ((pixel[0] - [320, 240]) ** 2).sum() / F_PX**2
        assert off <= U * (10 * F_PX * 45.0 / 15.0 * (1 + slope2) + 2 * np.abs(pixel).max())


@given(tilts, st.floats(15.0, 30.0), plates, st.floats(1.0, 2.0), points)
def test_row_19_refraction_to_round_off(
    tilt: tuple[float, float],
    gap_mm: float,
    stack: list[tuple[float, float]],
    gel_index: float,
    point_mm: tuple[float, ...],
) -> None:
    normal = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
    assume(gap_mm - BASELINE_MM * normal[0] > 5.0 and point_mm @ normal > 15.0)
    check_against_exact(CAMERAS.with_layers(layers(tilt, gap_mm, stack, gel_index)), point_mm)


@pytest.mark.parametrize("offset_mm", [0.0, 1e-300, 1e-12, 1e-6, 1e-3])
def test_row_19_beside_normal_incidence(offset_mm: float) -> None:
    rig = CAMERAS.with_layers(layers((0.0, 0.0), 20.0, [(3.0, 1.49)], 1.41))
    check_against_exact(rig, (offset_mm, 0.0, 28.0))


@pytest.mark.parametrize("gap_mm", [1e-9, 1e-6, 1e-3])
def test_row_19_grazing_light_through_a_narrow_gap(gap_mm: float) -> None:
    """Beyond the critical angle light only arrives along the interface: the pixel is far outside
    the image.
    """
    rig = CAMERAS.with_layers(layers((0.0, 0.0), gap_mm, [], 1.41))
    point_mm = (9.0, 0.0, 5.0)
    [[column, _]], _ = rig.project([point_mm])
    expected = exact_pixel(rig, point_mm, 0.0)[0]
    # The slope in air is (rho - the gel's share) / gap, and the height by which it is multiplied is the gap:
    # what the difference of two lengths of 9 mm has lost counts over the gap.
    assert abs(column / expected - 1) <= 4 * U * 9.0 / gap_mm + 20 * U
    with pytest.raises(RigError, match="totally reflected"):
        CAMERAS.with_layers(layers((0.0, 0.0), 0.0, [], 1.41)).project([point_mm])


@given(tilts, plates, points)
def test_row_20_vacuum_is_the_pinhole_to_the_bit(
    tilt: tuple[float, float], stack: list[tuple[float, float]], point_mm: tuple[float, ...]
) -> None:
    rig = CAMERAS.with_layers(layers(tilt, 15.0, [(t, 1.0) for t, _ in stack], 1.0))
    for found, expected in zip(rig.project([point_mm]), CAMERAS.project([point_mm]), strict=True):
        assert (found == expected).all()


@pytest.mark.parametrize("height_mm", [20.0, 23.0])
def test_row_20_points_on_the_interfaces(height_mm: float) -> None:
    rig = CAMERAS.with_layers(layers((0.0, 0.0), 20.0, [(3.0, 1.49)], 1.41))
    check_against_exact(rig, (4.0, -3.0, height_mm))
    if height_mm == 20.0:
        for found, expected in zip(
            rig.project([[4.0, -3.0, 20.0]]), CAMERAS.project([[4.0, -3.0, 20.0]]), strict=True
        ):
            assert (found == expected).all()


@pytest.mark.parametrize("tilt", [1e-12, -1e-12, 1e-9])
def test_row_21_a_tilt_of_1e_12(tilt: float) -> None:
    check_against_exact(
        CAMERAS.with_layers(layers((tilt, 0.0), 20.0, [(3.0, 1.49)], 1.41)), (4.0, -3.0, 28.0)
    )


def bent(k1: float) -> Rig:
    matrix = [[F_PX, 0, 320.0], [0, F_PX, 240.0], [0, 0, 1]]
    return Rig.from_opencv(
        size_px=(640, 480),
        left_matrix=matrix,
        left_distortion=[k1],
        right_matrix=matrix,
        right_distortion=[0.0],
        rotation=np.eye(3),
        translation_mm=[-BASELINE_MM, 0.0, 0.0],
    )


@given(st.floats(0.0, 0.912), st.floats(0.0, 6.3))
def test_row_22_distortion_is_inverted_up_to_the_fold(radius: float, turn: float) -> None:
    """k1 = -0.4 is monotone up to r = 0.9129, where r_d = 0.6086."""
    along = np.array([np.cos(turn), np.sin(turn)])
    pixel = np.array([320.0, 240.0]) + F_PX * along * radius * (1 - 0.4 * radius**2)
    found = bent(-0.4).undistort([pixel])[0]
    target = [(mpmath.mpf(float(pixel[0])) - 320) / F_PX, (mpmath.mpf(float(pixel[1])) - 240) / F_PX]
    length = mpmath.sqrt(target[0] ** 2 + target[1] ** 2)
    low, high = mpmath.mpf(0), 1 / mpmath.sqrt(mpmath.mpf("1.2"))
    for _ in range(180):
        middle = (low + high) / 2
        low, high = (middle, high) if middle - mpmath.mpf(0.4) * middle**3 < length else (low, middle)
    expected = [t * (low / length) if length > 0 else mpmath.mpf(0) for t in target]
    off = max(abs(mpmath.mpf(float(a)) - b) for a, b in zip(found, expected, strict=True))
    # The pixel's distance from the centre and the polynomial round to some 6 U; at the fold 1 - 1.2 r² goes
    # to 0.
    assert off <= 6 * U / (1 - 1.2 * radius**2) + U


@pytest.mark.parametrize("radius", [0.6087, 0.61, 0.7, 1.0, 5.0, 1e6])
def test_row_22_beyond_the_fold_there_is_no_ray(radius: float) -> None:
    with pytest.raises(RigError, match="beyond the range"):
        bent(-0.4).undistort([[320.0 + F_PX * radius, 240.0]])


@given(tilts, points, st.lists(st.floats(-0.1, 0.1), min_size=4, max_size=4))
def test_rays_are_scipys_least_squares(
    tilt: tuple[float, float], point_mm: tuple[float, ...], noise_px: list[float]
) -> None:
    normal = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
    assume(20.0 - BASELINE_MM * normal[0] > 5.0 and point_mm @ normal > 23.1)
    rig = CAMERAS.with_layers(layers(tilt, 20.0, [(3.0, 1.49)], 1.41))
    left, right = (
        pixel[0] + noise_px[i : i + 2] for pixel, i in zip(rig.project([point_mm]), (0, 2), strict=True)
    )
    found = triangulate(rig, [left], [right], Params().replace({"triangulate.method": "rays"}))[0]

    def residuals(at: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [pixel[0] - seen for pixel, seen in zip(rig.project([at]), (left, right), strict=True)]
        )

    scipys = optimize.least_squares(
        residuals, point_mm, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac"
    )
    # The one step leaves what is quadratic in the noise: at 0.1 px less than a thousandth of what that is in
    # depth, z² / (f b). In 3000 uniform cases it was 5.4e-6 mm at most, where this is 3.4e-5.
    assert np.abs(found - scipys.x).max() < 1e-3 * 0.1 * 45.0**2 / (F_PX * BASELINE_MM)
