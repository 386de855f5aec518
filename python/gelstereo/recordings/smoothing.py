"""Estimation and removal of the recorder's smoothing over time.

A mean over n frames correlates the noise of successive frames at rest, which shows the window's length. Under
a moving part it smears the gel's relief: a ridge appears wider and lower than it is, and its radius too
large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gelstereo.recordings.clouds import CloudRecording, RecordingError

__all__ = [
    "detrended_covariance",
    "intact",
    "noise_gain",
    "noise_mm",
    "smoothing_frames",
    "undo_smoothing",
]

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

#: Longest window tried.
_LONGEST = 8
#: Degree of the polynomial over time that removes the gel's slow creep.
_CREEP_DEGREE = 2


def detrended_covariance(window: int, frames: int, degree: int = _CREEP_DEGREE) -> Array:
    """Covariance (frames, frames) of white noise after a mean over ``window`` frames and the removal of a
    polynomial.

    In units of the smoothed noise's variance, so that the diagonal is 1 without the polynomial.
    """
    lag = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    smoothed = np.clip(1.0 - lag / window, 0.0, None)
    left = np.eye(frames) - _trend(frames, degree)
    covariance: Array = left @ smoothed @ left
    return covariance


def smoothing_frames(points_mm: Sequence[Array]) -> int:
    """Estimate the number of frames over which the recorder averaged.

    The autocorrelation of the noise at rest, after removal of slow creep, is compared with the prediction for
    means over 1 to 8 frames. The prediction includes the effect of removing the creep.

    Parameters
    ----------
    points_mm
        Stretches (frames, markers, 3) without contact, each of 16 frames or more.
    """
    _check_stretches(points_mm)
    seen = [(len(p), _correlation(_residual_covariance(p))) for p in points_mm]
    misfits = [
        sum(
            np.sum((found - _correlation(detrended_covariance(window, frames))) ** 2)
            for frames, found in seen
        )
        for window in range(1, _LONGEST + 1)
    ]
    return 1 + int(np.argmin(misfits))


def noise_mm(points_mm: Sequence[Array], window: int = 1) -> Array:
    """Standard deviation (3,) of a marker's noise along x, y and z without contact.

    Creep is removed. The result is corrected for the noise that this removes, for noise averaged over
    ``window`` frames.
    """
    _check_stretches(points_mm)
    squares, share = np.zeros(3), 0.0
    for stretch in points_mm:
        frames, markers = stretch.shape[:2]
        residual = stretch - np.tensordot(_trend(frames, _CREEP_DEGREE), stretch, 1)
        squares += np.sum(residual**2, axis=(0, 1)) / markers
        share += float(np.trace(detrended_covariance(window, frames)))
    deviation: Array = np.sqrt(squares / share)
    return deviation


def undo_smoothing(recording: CloudRecording, window: int) -> CloudRecording:
    """Undo a mean over ``window`` frames, to second order in time.

    The mean of x over n frames is x + (n² - 1) / 24 d²x/dt² about the window's middle. The smoothed frames
    have nearly the same second difference. It does not exist at the recording's ends and beside lost frames;
    see `intact`.
    """
    if window < 1:
        raise RecordingError(f"a window of {window} frames; at least 1 is needed")
    p = recording.points_mm
    sharp = p.copy()
    whole = ~recording.lost_before[1:-1] & ~recording.lost_before[2:]
    second = (p[:-2] - 2.0 * p[1:-1] + p[2:])[whole]
    sharp[1:-1][whole] -= _share(window) * second
    return replace(recording, points_mm=sharp)


def noise_gain(window: int) -> float:
    """Factor on the standard deviation by `undo_smoothing`, for noise averaged over ``window`` frames."""
    share = _share(window)
    smooth = np.full(window, 1.0 / window)
    sharp = np.convolve(smooth, [-share, 1.0 + 2.0 * share, -share])
    return float(np.linalg.norm(sharp) / np.linalg.norm(smooth))


def _share(window: int) -> float:
    """Half the variance of the times in a window: the coefficient of the second difference in their mean."""
    return (window**2 - 1) / 24.0


def intact(recording: CloudRecording, window: int) -> Bools:
    """Mask (frames,) of frames without a lost frame in their window or in their second difference."""
    whole = np.ones(len(recording), bool)
    for frame in np.flatnonzero(recording.lost_before):
        whole[max(frame - 1, 0) : frame + window - 1] = False
    return whole


def _check_stretches(points_mm: Sequence[Array]) -> None:
    if not points_mm or any(p.ndim != 3 or p.shape[2] != 3 or len(p) < 2 * _LONGEST for p in points_mm):
        shapes = [p.shape for p in points_mm]
        raise RecordingError(
            f"stretches have shapes {shapes}; valid is one or more of (frames, markers, 3), "
            f"each of {2 * _LONGEST} frames or more"
        )


def _trend(frames: int, degree: int) -> Array:
    """Projection (frames, frames) onto polynomials of time."""
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, frames), degree + 1))[0]
    projection: Array = basis @ basis.T
    return projection


def _residual_covariance(stretch: Array) -> Array:
    flat = stretch.reshape(len(stretch), -1)
    residual = flat - _trend(len(flat), _CREEP_DEGREE) @ flat
    covariance: Array = residual @ residual.T
    return covariance


def _correlation(covariance: Array) -> Array:
    """Autocorrelation at the first lags, of a stretch's covariance matrix."""
    total = float(np.trace(covariance))
    return np.array([float(np.trace(covariance, k)) / total for k in range(1, _LONGEST)])
