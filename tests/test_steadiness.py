"""Scatter of registered poses by noise of known size, beside the predicted covariance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gelstereo import Template
from gelstereo.recordings import RecordingError
from gelstereo_bench.reports.steadiness import rest_noise_mm, scatter_by_noise, scatter_over_time, stillest

SIGMA_MM = 0.003


def contact() -> tuple[np.ndarray, Template, np.ndarray]:
    """A flat face 20 mm from the sensor, 49 markers on it, and its template's pose."""
    template = Template.from_mesh(trimesh.creation.box((40.0, 40.0, 2.0)), units="mm", spacing_mm=0.5)
    x, y = np.meshgrid(np.arange(-3.0, 4.0), np.arange(-3.0, 4.0))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(49, 20.0)])
    pose = np.eye(4)
    pose[2, 3] = 21.0
    return points, template, pose


@pytest.mark.parametrize("method", ["surface_search", "filterreg_point"])
def test_white_noise_scatters_as_predicted(method: str) -> None:
    points, template, pose = contact()
    random = np.random.default_rng(2)
    noise = SIGMA_MM * random.normal(size=(200, *points.shape))
    found = scatter_by_noise(points, template, pose, list(noise), SIGMA_MM, method)
    assert found.frames == 200
    # Three directions of 199 freedoms each: 2.9 % of a deviation; four of that. Robust weights cost some per
    # cent.
    assert found.ratio == pytest.approx(1.0, abs=0.15)
    assert found.height_predicted_um == pytest.approx(1e3 * SIGMA_MM / 7.0, rel=0.1)
    assert found.height_um == pytest.approx(1e3 * SIGMA_MM / 7.0, rel=0.2)


def test_parabola_takes_out_motion_but_not_noise() -> None:
    points, template, pose = contact()
    random = np.random.default_rng(4)
    ratios = []
    for _ in range(20):
        moved = points + np.linspace(0.0, 1.0, 8)[:, None, None] ** 2 * [0.0, 0.0, 0.05]
        moved = moved + SIGMA_MM * random.normal(size=moved.shape)
        ratios.append(scatter_over_time(moved, template, pose, 1, SIGMA_MM, "surface_search").ratio)
    # 20 runs of 5 freedoms in 3 directions: 4.1 %; four of that.
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.17)


def test_rest_noise_keeps_its_size() -> None:
    random = np.random.default_rng(6)
    stretch = SIGMA_MM * random.normal(size=(20, 400, 3)) + np.linspace(0.0, 1.0, 20)[:, None, None] ** 2
    noise = rest_noise_mm(stretch, 1)
    # Every frame holds 1200 values: 2 % of a deviation; four of that.
    np.testing.assert_allclose(noise.std(axis=(1, 2)), SIGMA_MM, rtol=0.09)


def test_stillest_frames_are_found() -> None:
    random = np.random.default_rng(8)
    motion = 0.1 * np.ones(30)
    motion[18:22] = 0.01
    points = random.normal(size=(1, 20, 3)) + np.cumsum(motion)[:, None, None] * [1.0, 0.0, 0.0]
    cores = {frame: np.arange(4, 16) for frame in range(30)}
    cores[18] = np.arange(5, 20)
    found, core, motion_mm = stillest(points, cores, 5)
    assert core.tolist() == list(range(5, 16))
    np.testing.assert_array_equal(found, points[17:22][:, core])
    assert motion_mm == pytest.approx(0.01)
    with pytest.raises(RecordingError, match="no 5 frames in a row"):
        stillest(points, {frame: np.arange(3) for frame in range(30)}, 5)
