"""Contacts of the localization benchmark: what the best estimate of one can do."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from gelstereo import Template
from gelstereo_bench.frontier.grasps import Grasp


@pytest.mark.parametrize("tilt_deg", [0.5, 1.0, 1.5])
def test_an_efficient_estimate_of_a_plane_fails_as_often_as_two_tilts_do(tilt_deg: float) -> None:
    """Four markers on a plane tell two tilts alike: their length has Rayleigh's distribution."""
    mesh, reach_mm = trimesh.creation.box((8.0, 8.0, 2.0)), 2.0
    points_mm = reach_mm * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)
    sigma_mm = math.radians(tilt_deg) * reach_mm * math.sqrt(2.0)
    grasp = Grasp(
        "plane",
        mesh,
        Template.from_mesh(mesh, units="mm", spacing_mm=1.0),
        points_mm,
        np.tile(sigma_mm**2 * np.eye(3), (4, 1, 1)),
        points_mm,
        np.tile([0.0, 0.0, 1.0], (4, 1)),
        np.eye(4),
    )
    expected, draws = 1.0 - math.exp(-((2.0 / tilt_deg) ** 2) / 2.0), 4000
    slack = 4.0 * math.sqrt(expected * (1.0 - expected) / draws)
    # The height is known to half of one marker's noise: 0.3 mm are eight standard deviations and more.
    assert abs(grasp.at_bound(draws, 1) - expected) <= slack
    assert grasp.score(np.eye(4)).observable == 3
