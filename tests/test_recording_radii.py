"""Radii of parts from markers, their predicted errors, and the recorder's smoothing, against known truths."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from gelstereo.geometry import se3_exp
from gelstereo.recordings import (
    CloudRecording,
    RecordingError,
    cap_radius_sigma_mm,
    detrended_covariance,
    fit_plane,
    fit_radius,
    intact,
    noise_gain,
    noise_mm,
    smoothing_frames,
    undo_smoothing,
)

SEEDS = st.integers(0, 2**32 - 1)
NOISE_MM = np.array([0.0007, 0.0008, 0.0035])


def cap(shape: str, radius_mm: float, half_mm: float, count: int, random: np.random.Generator) -> np.ndarray:
    """Points of a cap that faces the camera, the shape tilted by up to 0.2 rad and anywhere."""
    if shape == "sphere":
        r, angle = half_mm * np.sqrt(random.uniform(size=count)), random.uniform(0, 2 * np.pi, count)
        x, y = r * np.cos(angle), r * np.sin(angle)
        local = np.column_stack([x, y, -np.sqrt(radius_mm**2 - r**2)])
    else:
        x = random.uniform(-half_mm, half_mm, count)
        y = random.uniform(-2.5, 2.5, count) * half_mm  # a strip: the fit starts along its longer side
        local = np.column_stack([x, y, -np.sqrt(radius_mm**2 - x**2)])
    twist = np.concatenate([random.uniform(-0.2, 0.2, 2), random.uniform(-3, 3, 1), [0, 0, 0]])
    pose = se3_exp(twist)
    return local @ pose[:3, :3].T + random.uniform(-5.0, 5.0, 3) + [0.0, 0.0, 15.0]


@settings(max_examples=30)
@given(SEEDS, st.sampled_from(["sphere", "cylinder"]), st.floats(2.0, 12.0), st.integers(1, 4))
def test_exact_caps_of_one_part_give_its_radius(seed: int, shape: str, radius_mm: float, frames: int) -> None:
    random = np.random.default_rng(seed)
    points = [cap(shape, radius_mm, 0.4 * radius_mm, 40, random) for _ in range(frames)]
    fit = fit_radius(points, shape, NOISE_MM)
    assert fit.converged
    assert fit.radius_mm == pytest.approx(radius_mm, rel=1e-6)
    assert fit.rms_mm < 1e-6


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
@pytest.mark.parametrize("frames", [1, 5])
def test_radius_is_unbiased_and_its_error_as_predicted(shape: str, frames: int) -> None:
    random = np.random.default_rng(7)
    radius_mm, trials = 4.0, 300
    squared, errors = [], []
    for _ in range(trials):
        points = [cap(shape, radius_mm, 1.6, 40, random) for _ in range(frames)]
        points = [p + NOISE_MM * random.normal(size=p.shape) for p in points]
        fit = fit_radius(points, shape, NOISE_MM)
        errors.append((fit.radius_mm - radius_mm) / fit.sigma_mm)
        squared.append(errors[-1] ** 2)
    # Four standard errors of a mean of unit variance; and the 99.99 % band of the mean of squares.
    assert abs(np.mean(errors)) < 4.0 / np.sqrt(trials)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], trials) / trials
    assert low < np.mean(squared) < high


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_error_of_a_shallow_cap_is_the_closed_form(shape: str) -> None:
    random = np.random.default_rng(11)
    noise = np.full(3, 0.003)
    for radius_mm, half_mm in [(10.0, 2.0), (20.0, 3.0)]:
        fit = fit_radius([cap(shape, radius_mm, half_mm, 4000, random)], shape, noise)
        expected = cap_radius_sigma_mm(shape, radius_mm, half_mm, 4000, 0.003)
        # The parabola leaves out (a / R)² of the sagitta; 4000 random places scatter the spread by 3 %.
        assert fit.sigma_mm == pytest.approx(expected, rel=(half_mm / radius_mm) ** 2 + 0.05)


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_the_error_of_a_cap_is_that_of_evenly_spread_markers(shape: Literal["sphere", "cylinder"]) -> None:
    count, half_mm = 400_000, 1.5
    even = (np.arange(count) + 0.5) / count
    # The squared distance from the middle is even over a disc, the distance over a strip.
    squared_mm2 = half_mm**2 * (even if shape == "sphere" else even**2)
    curvature_sigma = 0.003 / np.sqrt(count * np.var(0.5 * squared_mm2))
    expected_mm = 8.0**2 * curvature_sigma
    assert cap_radius_sigma_mm(shape, 8.0, half_mm, count, 0.003) == pytest.approx(expected_mm, rel=1e-6)


def test_joint_fit_is_the_mean_of_equal_frames_and_narrower() -> None:
    random = np.random.default_rng(3)
    points = [
        p + NOISE_MM * random.normal(size=p.shape)
        for p in (cap("cylinder", 4.0, 1.6, 60, random) for _ in range(9))
    ]
    alone = [fit_radius([p], "cylinder", NOISE_MM) for p in points]
    joint = fit_radius(points, "cylinder", NOISE_MM)
    weights = np.array([fit.sigma_mm**-2.0 for fit in alone])
    mean = np.sum(weights * [fit.radius_mm for fit in alone]) / weights.sum()
    # Equal to first order: what is left is of the order of sigma² / R.
    assert joint.radius_mm == pytest.approx(mean, abs=0.1 * joint.sigma_mm)
    assert joint.sigma_mm == pytest.approx(weights.sum() ** -0.5, rel=0.02)


def test_bad_input_of_a_radius_is_refused() -> None:
    points = [np.eye(5, 3)]
    with pytest.raises(RecordingError, match="valid is 'sphere' or 'cylinder'"):
        fit_radius(points, "cone", NOISE_MM)  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="three positive numbers"):
        fit_radius(points, "sphere", [0.0, 1.0, 1.0])
    with pytest.raises(RecordingError, match="at least one is needed"):
        fit_radius([], "sphere", NOISE_MM)
    with pytest.raises(RecordingError, match="2 points for a plane"):
        fit_radius([np.eye(2, 3)], "sphere", NOISE_MM)


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_markers_of_no_cap_are_refused(shape: str) -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-2.5, 3.0), np.arange(-2.5, 3.0)))
    flat = np.column_stack([x, y, np.full(36, 20.0)])
    for points in (flat, np.full((9, 3), 2.0), np.column_stack([np.arange(9.0), np.zeros(9), np.zeros(9)])):
        with pytest.raises(RecordingError, match="no more than their noise"):
            fit_radius([points], shape, NOISE_MM)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.sampled_from(["sphere", "cylinder"]), st.integers(5, 30))
def test_a_fit_is_never_worse_than_a_plane(seed: int, shape: str, count: int) -> None:
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3)) * [2.0, 2.0, 0.3] + [0.0, 0.0, 20.0]
    try:
        fit = fit_radius([points], shape, NOISE_MM)
    except RecordingError as refused:
        assert "mm about planes" in str(refused)
        return
    assert np.isfinite([fit.radius_mm, fit.rms_mm]).all()
    assert fit.rms_mm < fit_plane(points).rms_mm


def smoothed(values: np.ndarray, window: int) -> np.ndarray:
    """Mean of every frame and those before it, the first window - 1 frames dropped."""
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    return (total[window:] - total[:-window]) / window


@settings(max_examples=20)
@given(SEEDS, st.integers(1, 6))
def test_window_and_noise_are_found_under_creep(seed: int, window: int) -> None:
    random = np.random.default_rng(seed)
    stretches = []
    for frames in (26, 32):
        noise = (
            smoothed(random.normal(size=(frames + window - 1, 256, 3)), window) * np.sqrt(window) * NOISE_MM
        )
        creep = 0.05 * np.linspace(0, 1, frames)[:, None, None] ** 2 * random.normal(size=(1, 256, 3))
        stretches.append(noise + creep)
    assert smoothing_frames(stretches) == window
    # About 256 * 58 / window independent values, some lost to the parabola: 4 standard errors of a deviation.
    tolerance = 4.0 / np.sqrt(2.0 * 256.0 * 50.0 / window)
    np.testing.assert_allclose(noise_mm(stretches, window), NOISE_MM, rtol=tolerance)


def test_expected_covariance_is_that_of_simulated_noise() -> None:
    random = np.random.default_rng(5)
    frames, window, degree = 12, 4, 2
    noise = smoothed(random.normal(size=(frames + window - 1, 200000)), window) * np.sqrt(window)
    design = np.vander(np.arange(frames), degree + 1)
    left = noise - design @ np.linalg.lstsq(design, noise, rcond=None)[0]
    # Covariances of unit variables over 200000 trials scatter by at most sqrt(2 / 200000) = 0.003; five of
    # that.
    np.testing.assert_allclose(
        detrended_covariance(window, frames, degree), left @ left.T / 200000, atol=0.016
    )


def moving(frames: int, sequence: np.ndarray | None = None) -> CloudRecording:
    """A cylinder of 4 mm pushed along x by an accelerated motion, a marker every 0.5 mm."""
    x = np.tile(np.linspace(-1.5, 1.5, 10), 10)
    y = np.repeat(np.linspace(-3.0, 3.0, 10), 10)
    t = np.arange(frames)
    shift = 0.2 * t + 0.01 * t**2
    z = 20.0 + 0.05 * shift[:, None] ** 2 + 0.2 * np.sin(x[None] - shift[:, None])
    points = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y, z.shape), z], axis=2)
    rest = np.column_stack([x, y, np.full(100, 20.0)])
    return CloudRecording("made up", 10, 10, points, rest, 0.03 * t, sequence)


def test_undone_smoothing_leaves_a_fraction_of_the_smear() -> None:
    truth = moving(40).points_mm
    # The mean of frames t-1.5 to t+1.5 stands for the middle between two frames, so an odd window is compared
    # here.
    for window in (3, 5):
        middle = slice(window // 2, -(window // 2))
        recording = replace(
            moving(40), points_mm=smoothed(truth, window), time_s=np.arange(40.0 - window + 1)
        )
        sharp = undo_smoothing(recording, window).points_mm[1:-1]
        before = np.abs(recording.points_mm[1:-1] - truth[middle][1:-1])[:, :, 2].max()
        after = np.abs(sharp - truth[middle][1:-1])[:, :, 2].max()
        assert after < 0.35 * before
    assert undo_smoothing(moving(10), 1).points_mm == pytest.approx(moving(10).points_mm, abs=0.0)
    with pytest.raises(RecordingError, match="a window of 0 frames"):
        undo_smoothing(moving(10), 0)


@pytest.mark.parametrize("window", [1, 2, 4, 5])
def test_noise_grows_by_its_gain(window: int) -> None:
    random = np.random.default_rng(window)
    frames = 400
    noise = smoothed(random.normal(size=(frames + window - 1, 100, 3)), window)
    recording = replace(moving(frames), points_mm=noise)
    gain = undo_smoothing(recording, window).points_mm[1:-1].std() / noise[1:-1].std()
    # 120000 values of which at least every fifth is independent: 1 / sqrt(2 * 24000) = 0.5 %, four of that.
    assert gain == pytest.approx(noise_gain(window), rel=0.02)


def test_undoing_is_exact_for_accelerated_points() -> None:
    t = np.arange(30.0)
    path = 0.3 * t**2 - 2.0 * t
    points = moving(30).points_mm.copy()
    points[:] = path[:, None, None]
    recording = replace(moving(28), points_mm=smoothed(points, 3), time_s=np.arange(28.0))
    sharp = undo_smoothing(recording, 3).points_mm
    np.testing.assert_allclose(sharp[1:-1, 0, 0], path[2:-2], atol=1e-9)


def test_lost_frames_are_told_and_left_as_they_are() -> None:
    sequence = np.arange(20)
    sequence[12:] += 2
    recording = moving(20, sequence)
    assert np.flatnonzero(recording.lost_before).tolist() == [12]
    assert np.flatnonzero(~intact(recording, 4)).tolist() == [11, 12, 13, 14]
    changed = np.any(undo_smoothing(recording, 4).points_mm != recording.points_mm, axis=(1, 2))
    assert np.flatnonzero(~changed).tolist() == [0, 11, 12, 19]
    with pytest.raises(RecordingError, match="do not increase at frame 5"):
        moving(20, np.where(np.arange(20) == 5, 4, np.arange(20)))
    with pytest.raises(RecordingError, match="3 numbers for 20 frames"):
        moving(20, np.arange(3))


def test_short_stretches_are_refused() -> None:
    with pytest.raises(RecordingError, match="each of 16 frames or more"):
        smoothing_frames([np.zeros((15, 4, 3))])
    with pytest.raises(RecordingError, match="stretches have shapes"):
        noise_mm([])
