"""Scatter of registered poses due to a recording's noise, compared with the predicted covariance.

Part of ``python -m gelstereo_bench.reports.recordings``. No part in the recording is at rest, because it is
moved by hand. Therefore the noise of frames without contact is added to one pressed frame. In the frames with
least motion a parabola over time is removed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
import numpy.typing as npt

from gelstereo import Localization, Params, Template, localize
from gelstereo.geometry import se3_log
from gelstereo.recordings import RecordingError, detrended_covariance

__all__ = ["Steadiness", "rest_noise_mm", "scatter_by_noise", "scatter_over_time", "stillest"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


#: Minimum number of markers of a contact.
_MIN_MARKERS = 8


@dataclass(frozen=True)
class Steadiness:
    """Scatter of the poses of one part."""

    frames: int
    #: Rms over the determined directions, each normalised by its predicted standard deviation.
    ratio: float
    #: Standard deviation along z and of the tilts, measured and predicted.
    height_um: float
    height_predicted_um: float


def rest_noise_mm(stretch_mm: Array, window: int) -> Array:
    """Noise (frames, markers, 3) of a stretch without contact, with creep removed and variance corrected."""
    frames = len(stretch_mm)
    left = _without_parabola(stretch_mm)
    # The parabola removes more of the noise at a stretch's ends than in its middle.
    kept = np.sqrt(np.diag(detrended_covariance(window, frames)))
    noise: Array = left / kept[:, None, None]
    return noise


def scatter_by_noise(
    points_mm: Array,
    template: Template,
    guess: Array,
    noise_mm: Sequence[Array],
    sigma_mm: float,
    method: str,
) -> Steadiness:
    """Register one pressed frame with the noise (markers, 3) of many others."""
    params = _params(method)
    found = [localize(points_mm + noise, template, guess=guess, params=params) for noise in noise_mm]
    twists = _twists(found, points_mm.mean(axis=0))
    return _steadiness(found, twists - twists.mean(axis=0), points_mm, len(found) - 1.0, sigma_mm)


def scatter_over_time(
    points_mm: Array, template: Template, guess: Array, window: int, sigma_mm: float, method: str
) -> Steadiness:
    """Register frames (frames, markers, 3) of a part that hardly moves; a parabola over time is removed."""
    params = _params(method)
    found = [localize(p, template, guess=guess, params=params) for p in points_mm]
    centre = points_mm.mean(axis=(0, 1))
    left = _without_parabola(_twists(found, centre))
    freedom = float(np.trace(detrended_covariance(window, len(found))))
    return _steadiness(found, left, points_mm.mean(axis=0), freedom, sigma_mm)


def stillest(points_mm: Array, cores: Mapping[int, Indices], frames: int) -> tuple[Array, Indices, float]:
    """Find the stretch of a given length in which a contact's markers move least.

    Parameters
    ----------
    points_mm
        All markers in all frames (frames, markers, 3).
    cores
        Markers in contact, for every usable frame.

    Returns
    -------
    points_mm : (frames, core, 3)
        Points of the markers in contact throughout.
    core
        Indices of these markers.
    motion_mm
        Largest of the median motions between consecutive frames.
    """
    best: tuple[Array, Indices, float] | None = None
    for first in cores:
        stretch = range(first, first + frames)
        if not all(frame in cores for frame in stretch):
            continue
        core = reduce(np.intersect1d, [cores[frame] for frame in stretch])
        points = points_mm[first : first + frames][:, core]
        if len(core) < _MIN_MARKERS:
            continue
        motion = np.median(np.linalg.norm(np.diff(points, axis=0), axis=2), axis=1).max()
        if best is None or motion < best[2]:
            best = points, core, float(motion)
    if best is None:
        raise RecordingError(f"no {frames} frames in a row share {_MIN_MARKERS} markers that touch")
    return best


def _params(method: str) -> Params:
    # A step tolerance small enough that convergence adds nothing to the scatter. The gel deviates from the
    # part by more than the noise, so the default deviation of a point is kept, and the information is scaled
    # to the noise afterwards.
    return Params().replace({"register.method": method, "register.advanced.step_tolerance": 1e-6})


def _twists(found: Sequence[Localization], centre_mm: Array) -> Array:
    """Perturbations (frames, 6) from the first pose, about a point."""
    about = np.eye(4)
    about[:3, 3] = -centre_mm
    first = np.linalg.inv(about @ found[0].t_sensor_object)
    return np.array([se3_log(about @ f.t_sensor_object @ first) for f in found])


def _steadiness(
    found: Sequence[Localization], left: Array, points_mm: Array, freedom: float, sigma_mm: float
) -> Steadiness:
    """Compare twists about the points' centroid, corrected for lost degrees of freedom, with the first
    information matrix.
    """
    centre = points_mm.mean(axis=0)
    # A twist (ω, v) about the centroid is (ω, v - ω x centre) about the sensor.
    cross = np.array(
        [[0.0, -centre[2], centre[1]], [centre[2], 0.0, -centre[0]], [-centre[1], centre[0], 0.0]]
    )
    to_sensor = np.block([[np.eye(3), np.zeros((3, 3))], [cross, np.eye(3)]])
    promised_mm = float(Params().to_dict()["register"]["point_sigma_mm"])
    information = to_sensor.T @ found[0].information @ to_sensor * (promised_mm / sigma_mm) ** 2
    radius = float(np.sqrt(np.mean(np.sum((points_mm - centre) ** 2, axis=1))))
    scale = np.diag([1.0 / radius] * 3 + [1.0] * 3)
    values, vectors = np.linalg.eigh(scale @ information @ scale)
    determined = 6 - len(found[0].free)
    values, vectors = values[-determined:], vectors[:, -determined:]
    along = left @ np.linalg.inv(scale) @ vectors
    ratio = float(np.sqrt(np.sum(along**2 * values) / (freedom * determined)))
    up = vectors[5]
    return Steadiness(
        len(found),
        ratio,
        1e3 * float(np.sqrt(np.sum((along @ up) ** 2) / freedom)),
        1e3 * float(np.sqrt(np.sum(up**2 / values))),
    )


def _without_parabola(values: Array) -> Array:
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(values)), 3))[0]
    left: Array = values - np.tensordot(basis @ basis.T, values, 1)
    return left
