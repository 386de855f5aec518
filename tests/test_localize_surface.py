"""`localize` on a part's own surface: every marker, covariances, likelihood and other poses."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gelstereo import Params, RegisterError, ShapeError, Template, localize
from gelstereo.geometry import se3_exp, se3_log

SEARCH = Params().replace({"register.method": "surface_search"})


@pytest.fixture(scope="module")
def template() -> Template:
    return Template.from_mesh(trimesh.creation.box((8.0, 6.0, 30.0)), units="mm")


def corner(noise_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A box's corner pressed toward the camera: the pose, salient points, and all markers."""
    rng = np.random.default_rng(3)
    turn = np.array(se3_exp([2.6, 0.7, 0.2, 0.0, 0.0, 0.0]))
    half = np.array([4.0, 3.0, 15.0])
    grid = np.stack(np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)), -1).reshape(-1, 2) * 0.9
    # Entry of every line along z, the box's corner nearest to the camera at 1.6 mm over the rest plane.
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half @ turn[:3, :3].T
    nearest = corners[corners[:, 2].argmin()]
    turn[:3, 3] = np.array([0.0, 0.0, 28.7 - 1.6]) - nearest
    origins = np.column_stack([grid, np.zeros(len(grid))]) - turn[:3, 3]
    origins, way = origins @ turn[:3, :3], turn[:3, :3].T @ [0.0, 0.0, 1.0]
    near, far = (-half * np.sign(way) - origins) / way, (half * np.sign(way) - origins) / way
    enter, leave = near.max(axis=1), far.min(axis=1)
    z = np.where(enter < leave, np.minimum(enter, 28.7), 28.7)
    points = np.column_stack([grid, z]) + noise_mm * rng.normal(size=(len(grid), 3))
    return turn, points[28.7 - points[:, 2] > 0.35], points


def test_a_far_guess_finds_a_corner_with_every_marker(template: Template) -> None:
    truth, salient, everything = corner(0.02)
    guess = truth @ se3_exp([0.2, -0.15, 0.2, 1.0, -1.0, 0.8])
    covariance = np.tile(np.eye(3) * 0.02**2, (len(salient), 1, 1))
    found = localize(
        salient,
        template,
        guess=guess,
        all_points_mm=everything,
        covariance_mm2=covariance,
        params=SEARCH,
    )
    error = np.array(se3_log(np.linalg.inv(found.t_sensor_object) @ truth))
    centre = np.append(salient.mean(axis=0), 1.0)
    moved = (found.t_sensor_object @ np.linalg.inv(truth) @ centre - centre)[:3]
    assert found.converged and np.isfinite(found.log_likelihood)
    # This gel is back at rest beside the part: a shoulder shorter than a third of the pitch explains it.
    assert found.log_odds > 0.0 and found.verdict == "fits"
    assert found.gel_decay_mm is not None and found.gel_decay_mm < 0.3
    # Success as elsewhere: 2 degrees and 0.3 mm at the patch.
    assert np.linalg.norm(error[:3]) < np.deg2rad(2.0) and np.linalg.norm(moved) < 0.3
    for pose, likelihood in found.alternatives:
        assert pose.shape == (4, 4) and likelihood <= found.log_likelihood


def test_what_the_surface_methods_refuse(template: Template) -> None:
    truth, salient, _ = corner(0.0)
    with pytest.raises(RegisterError, match="covariances"):
        localize(salient, template, guess=truth, covariance_mm2=np.eye(3)[None], params=SEARCH)
    with pytest.raises(ShapeError, match=r"valid is \(N, 3, 3\)"):
        localize(salient, template, guess=truth, covariance_mm2=np.eye(3), params=SEARCH)


def test_a_template_of_points_is_as_good_as_its_mesh(template: Template) -> None:
    truth, salient, everything = corner(0.02)
    guess = truth @ se3_exp([0.1, -0.1, 0.1, 0.5, -0.5, 0.4])
    scan = Template.from_points(template.points_mm, template.normals, template.spacing_mm)
    assert scan.surface is None
    found = localize(salient, scan, guess=guess, all_points_mm=everything, params=SEARCH)
    error = np.array(se3_log(np.linalg.inv(found.t_sensor_object) @ truth))
    assert np.linalg.norm(error[:3]) < np.deg2rad(2.0) and found.log_odds > 0


def edge(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A patch on a box's face of 8 by 30 mm, pressed toward the camera: the pose, and the salient points."""
    rng = np.random.default_rng(seed)
    truth = np.array(se3_exp([-0.5 * np.pi, 0.0, 0.0, 0.0, 0.0, 0.0]))
    truth[2, 3] = 30.0
    across, along = np.meshgrid(np.arange(-3.6, 3.7, 0.9), np.arange(-9.0, 9.1, 0.9))
    points = np.column_stack([across.ravel(), along.ravel(), np.full(across.size, 27.0)])
    return truth, points + 0.02 * rng.normal(size=points.shape)


@pytest.mark.parametrize("method", ["surface_search", "surface_close"])
@pytest.mark.parametrize("seed", range(4))
def test_row_50_a_patch_is_registered_whichever_way_it_was_pressed(
    template: Template, seed: int, method: str
) -> None:
    """The sensor's frame turned at will: the press direction that turns with it gives the turned pose."""
    params = SEARCH.replace({"register.method": method})
    truth, salient = edge(seed)
    turn = np.array(se3_exp([*np.random.default_rng(seed).uniform(-3.0, 3.0, 3), 0.0, 0.0, 0.0]))
    guess = turn @ truth @ se3_exp([0.05, -0.05, 0.05, 0.3, -0.3, 0.3])
    turned, way = salient @ turn[:3, :3].T, -2.0 * turn[:3, 2]
    found = localize(turned, template, guess=guess, params=params, press_direction=way)
    # The face lies on the patch, to the noise of 0.02 mm; a marker at a corner may hang by some sigma.
    back = (turned - found.t_sensor_object[:3, 3]) @ found.t_sensor_object[:3, :3]
    distances = template.closest(back).distances_mm
    assert found.verdict != "does_not_fit" and np.sqrt(np.mean(np.square(distances))) < 0.03


@pytest.mark.parametrize("method", ["surface_search", "surface_close"])
@pytest.mark.parametrize("angle_deg", [65.0, 90.0, 115.0])
def test_row_50_a_patch_that_lies_across_the_press_is_refused(
    template: Template, angle_deg: float, method: str
) -> None:
    truth, salient = edge(0)
    for axis in np.eye(3)[:2]:
        turn = np.array(se3_exp([*np.radians(angle_deg) * axis, 0.0, 0.0, 0.0]))
        turned, guess = salient @ turn[:3, :3].T, turn @ truth
        params = SEARCH.replace({"register.method": method})
        with pytest.raises(RegisterError, match=r"valid is up to 60: hand over press_direction"):
            localize(turned, template, guess=guess, params=params)
    with pytest.raises(RegisterError, match="no unit vector"):
        localize(salient, template, guess=truth, params=SEARCH, press_direction=(0.0, 0.0, 0.0))
