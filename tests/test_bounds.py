"""The Cramér-Rao bounds against closed forms, numerical integration and estimates on many noisy images."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter

from gelstereo import Scene, Simulator
from gelstereo_bench.frontier.bounds import (
    Grain,
    blurred_disc,
    centre_bound_px,
    edge_bound_px,
    marker_bounds_px,
)

Array = npt.NDArray[np.float64]


def test_blurred_disc_is_the_blurred_disc() -> None:
    """Against sampling at a twentieth of a pixel; derivatives against differences."""
    radius, blur, fine = 3.1, 0.9, 20
    axis = np.arange(-12 * fine, 12 * fine + 1) / fine
    x, y = np.meshgrid(axis, axis)
    # Coverage of the samples at the rim, to first order in their width.
    disc = np.clip((radius - np.hypot(x, y)) * fine + 0.5, 0.0, 1.0)
    image = gaussian_filter(disc, blur * fine, truncate=6.0)
    distance = np.linspace(0.0, 8.0, 33)
    expected = np.interp(distance, axis, image[12 * fine])
    share, by_distance, by_radius, by_blur = blurred_disc(distance, radius, blur)
    # Sampling at the rim: 1/20 px wide, second order.
    assert np.abs(share - expected).max() < 5e-4
    step = 1e-4

    def slope(d: float, r: float, b: float) -> Array:
        up = blurred_disc(distance + d, radius + r, blur + b)[0]
        down = blurred_disc(distance - d, radius - r, blur - b)[0]
        return np.asarray((up - down) / (2.0 * step))

    for found, changes in ((by_distance, (step, 0, 0)), (by_radius, (0, step, 0)), (by_blur, (0, 0, step))):
        assert np.abs(found - slope(*changes)).max() < 1e-6


@pytest.mark.parametrize("radius", [4.0, 8.0, 16.0])
def test_bound_tends_to_the_closed_form_of_a_sharp_edge(radius: float) -> None:
    """Without grain: the closed form, less what the unknown slope of light takes.

    Over the window's square of half side h, the slope's column x and the edge's derivative share
    (pi r²)² / (sum of squares pi r / (2 sqrt(pi) s) times (2 h)^4 / 12) of the information.
    """
    blur, noise, contrast = 0.9, 2.0, 120.0
    per_axis = centre_bound_px(radius, contrast, blur, noise, rounded=False) / np.sqrt(2.0)
    half = radius + 5.0
    lost = 1.5 * np.pi**1.5 * blur * radius**3 / half**4
    expected = edge_bound_px(radius, contrast, blur, noise) / np.sqrt(1.0 - lost)
    # Curvature counts in the square of blur over radius.
    assert per_axis == pytest.approx(float(expected), rel=0.01 + 0.5 * (blur / radius) ** 2)


def test_grain_raises_the_bound_and_rounding_too() -> None:
    plain = centre_bound_px(4.3, 120.0, 0.9, 2.0, rounded=False)
    rounded = centre_bound_px(4.3, 120.0, 0.9, 2.0)
    grain = centre_bound_px(4.3, 120.0, 0.9, 2.0, grain=Grain(2.0, 1.3))
    assert rounded == pytest.approx(plain * np.sqrt(1.0 + 1.0 / 48.0), rel=1e-9)
    assert grain > 1.5 * rounded
    # Scale: twice the contrast, half the bound; noise and contrast together change nothing.
    assert centre_bound_px(4.3, 240.0, 0.9, 2.0) == pytest.approx(0.5 * rounded, rel=1e-9)
    assert np.all(np.diff(centre_bound_px([2.0, 3.0, 5.0], 100.0, 0.9, 2.0)) < 0.0)


@pytest.mark.parametrize("grain", [None, Grain(2.2, 1.3)], ids=["white", "grain"])
def test_maximum_likelihood_reaches_the_bound(grain: Grain | None) -> None:
    """Monte Carlo: the maximum-likelihood centre of 150 noisy discs has the bound's error, and no less.

    The relative standard deviation of an rms over n errors of two coordinates is 1 / sqrt(4 n) = 4 %.
    """
    radius, blur, contrast, noise, half = 3.6, 0.9, 110.0, 2.0, 8
    rng = np.random.default_rng(7)
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float).reshape(2, -1)
    covariance = noise**2 * np.eye(len(x))
    if grain is not None:
        apart2 = np.subtract.outer(x, x) ** 2 + np.subtract.outer(y, y) ** 2
        covariance += grain.sigma_levels**2 * np.exp(-apart2 / (4.0 * grain.size_px**2))
    colour = np.linalg.cholesky(covariance)
    whiten = np.linalg.inv(colour)
    # The model of the estimator: radial profile by a table, that is by the same physics but other numerics.
    table_d = np.linspace(0.0, 20.0, 4001)
    profiles = {r: blurred_disc(table_d, r, blur)[0] for r in (radius - 0.1, radius, radius + 0.1)}

    def model(p: Array) -> Array:
        distance = np.hypot(x - p[0], y - p[1])
        below, middle, above = (np.interp(distance, table_d, profile) for profile in profiles.values())
        t = p[2] / 0.1
        share = middle + 0.5 * t * (above - below) + 0.5 * t * t * (above - 2.0 * middle + below)
        return np.asarray(p[3] * share + p[4] + p[5] * x + p[6] * y)

    errors = []
    for _ in range(150):
        truth = np.array([*rng.uniform(-0.5, 0.5, 2), 0.0, -contrast, 170.0, 0.1, -0.05])
        image = model(truth) + colour @ rng.normal(size=len(x))
        found = truth.copy()
        slopes = np.column_stack([(model(truth + h) - model(truth - h)) / 2e-4 for h in 1e-4 * np.eye(7)])
        gain = np.linalg.pinv(whiten @ slopes) @ whiten
        for _ in range(
            6
        ):  # Gauss-Newton with the slopes of the truth: errors shrink by their size over the blur
            found -= gain @ (model(found) - image)
        errors.append(found[:2] - truth[:2])
    rms = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    bound = float(centre_bound_px(radius, contrast, blur, noise, grain=grain, rounded=False))
    # The estimator knows blur and stretch, which cost the centre nothing: 3 sigma either way.
    assert 0.88 * bound < rms < 1.12 * bound


def test_bounds_of_a_simulated_frame() -> None:
    effects: dict[str, dict[str, float]] = {
        name: {} for name in ("sensor_noise", "defocus", "grain", "uneven_light")
    }
    scene = Scene().replace({"effects": effects})
    frame = Simulator(scene)[0]
    # Every sixth marker: the first and last ones, the middle, and some of every row.
    left_px, points_mm = frame.left_px[::6], frame.points_mm[::6]
    bounds = marker_bounds_px(scene.to_dict(), left_px, points_mm)
    assert bounds.shape == (105,)
    without = marker_bounds_px(scene.to_dict(), left_px, points_mm, with_grain=False)
    assert np.all(without < 0.6 * bounds)
    # Dim corners: less contrast and less grain, the same sensor.
    corner, middle = np.argmin(left_px.sum(axis=1)), np.argmin(np.abs(left_px - 320).sum(axis=1))
    assert bounds[corner] > bounds[middle]
    direct = centre_bound_px(
        560.0 * 0.22 / 28.7, 120.0, np.sqrt(0.64 + 1.0 / 6.0), 2.0, pitch_px=560.0 * 0.9 / 28.7
    )
    assert without[middle] == pytest.approx(float(direct), rel=0.1)
