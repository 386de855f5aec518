"""What contacts can tell at best: closed forms, and the irregular cap's own surface in place of
its facets.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from gelstereo import parts
from gelstereo_bench.experiments.insertion.bound import (
    Bound,
    SmoothSurface,
    covariance_bound,
    heights_information,
)
from gelstereo_bench.experiments.insertion.chance import Prior
from gelstereo_bench.experiments.insertion.grasp import fit_of
from gelstereo_bench.experiments.insertion.workplace import workplace

Array = npt.NDArray[np.float64]

#: So little is known before that it plays no part.
NOTHING = Prior(rotation_rad=1e3, shift_mm=1e3)


def covariances(count: int, sigma_mm: float) -> Array:
    return np.tile(sigma_mm**2 * np.eye(3), (count, 1, 1))


def test_a_face_is_known_as_its_closed_form_says() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-2.0, 2.0, 5), np.linspace(-3.0, 3.0, 7)))
    points = np.column_stack([x, y, np.full_like(x, 4.0)])
    # Across the face's normal the markers may be anywhere.
    covariance = np.tile(np.diag([1.0, 1.0, 0.005**2]), (35, 1, 1))
    found = heights_information(points, np.tile([0.0, 0.0, 1.0], (35, 1)), covariance)
    expected = np.zeros((6, 6))
    # z + y ωx - x ωy is seen at every marker.
    expected[0, 0], expected[1, 1], expected[5, 5] = np.sum(y**2), np.sum(x**2), 35.0
    assert found == pytest.approx(expected / 0.005**2, abs=1e-6)


def test_facets_do_not_tell_a_round_part_s_spin() -> None:
    angle, along = (a.ravel() for a in np.meshgrid(np.linspace(-0.6, 0.6, 9), np.linspace(12.0, 26.0, 15)))
    points = np.column_stack([4.0 * np.cos(angle), 4.0 * np.sin(angle), along])
    surface = SmoothSurface(parts.peg_round())
    covariance = covariance_bound(surface, np.eye(4), points, covariances(len(points), 0.005), NOTHING)
    sigma = np.sqrt(np.diag(covariance))
    # The interpolation of normals along a chord of 2.8 degrees is off by 1e-5 rad.
    assert sigma[2] > 1.0, "spin"
    assert sigma[5] > 100.0, "slide along the axis"
    assert max(sigma[3], sigma[4]) < 0.01


def cap(angle: Array, z: Array) -> Array:
    """Radius of the irregular peg's cap, as its documentation draws it."""
    lobes = 1.3 * np.cos(2 * angle + 0.4) + 0.9 * np.cos(3 * angle - 1.1 + 0.8 * z / 20.0)
    return np.asarray(4.0 + 2.2 + lobes - 1.1 * z / 20.0)


def cap_normals(angle: Array, z: Array) -> Array:
    """Gradient of r - R(θ, z), by differences far finer than a facet."""
    step = 1e-5
    radius = cap(angle, z)
    turn = (cap(angle + step, z) - cap(angle - step, z)) / (2.0 * step) / radius
    rise = (cap(angle, z + step) - cap(angle, z - step)) / (2.0 * step)
    out, round_ = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    normals = np.column_stack([(out - turn * round_).T, -rise])
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def test_facets_of_the_irregular_cap_are_seen_as_its_own_surface() -> None:
    surface = SmoothSurface(fit_of("c").mesh)
    angle, z = (a.ravel() for a in np.meshgrid(np.linspace(-0.35, 0.35, 6), np.linspace(2.0, 18.0, 12)))
    radius = cap(angle, z)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    covariance = covariances(len(points), 0.0055)
    smooth = np.linalg.inv(heights_information(points, surface.normals(points), covariance))
    exact = np.linalg.inv(heights_information(points, cap_normals(angle, z), covariance))
    # Vertices' normals are means over facets of 2.8 degrees and 1 mm.
    assert np.sqrt(np.diag(smooth) / np.diag(exact)) == pytest.approx(1.0, abs=0.1)


def test_the_irregular_peg_is_told_on_two_lobes_and_not_on_one() -> None:
    place = workplace("c")
    reach = np.asarray(place.fit.mesh.vertices)[:, :2]

    def height_mm(spin_rad: float) -> float:
        """How far the part reaches towards the gel from its axis."""
        return float(np.max(reach @ [np.cos(spin_rad), -np.sin(spin_rad)]))

    own = place.nominal.spin_rad
    assert height_mm(own) < min(height_mm(own - 0.2), height_mm(own + 0.2)), "it lies there"
    leaves_mm = 0.5 * place.part.clearance_mm
    _, lying = place.bound_of(place.nominal, 0.0055)
    _, rolling = place.bound_of(replace(place.nominal, spin_rad=0.0), 0.0055)
    assert lying.aside_mm < 0.2 * leaves_mm and lying.chance == 1.0
    # On a lobe, poses that were looked for with fine facets and the whole gel gave 0.16 mm and 2 degrees.
    assert rolling.aside_mm > 1.1 * leaves_mm and rolling.chance < 0.8


def test_what_is_known_well_goes_in() -> None:
    fit = fit_of("b")
    bound = Bound.of(fit.hole, fit.end, np.diag([1e-8] * 3 + [1e-6] * 3), np.random.default_rng(1))
    assert bound.chance == 1.0
    # 15 mm and more from the origin a turn of 1e-4 rad counts as a shift.
    assert bound.aside_mm == pytest.approx(np.hypot(1e-3, 1e-4 * 35.0), rel=1e-6)
    wide = Bound.of(fit.hole, fit.end, np.diag([1e-8] * 3 + [1.0] * 3), np.random.default_rng(1))
    # Within ±0.125 mm along both axes.
    assert wide.chance == pytest.approx(0.0099, abs=0.02)
