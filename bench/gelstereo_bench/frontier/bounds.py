"""Cramér-Rao bounds of a marker's centre, from the model of image formation.

A marker is a disc blurred by a Gaussian, on a background with a brightness gradient. The parameters are the
centre; nuisance parameters are radius (with two directions of stretch), contrast, background, both gradients
and blur. Noise is Gaussian: white noise plus the variance 1/12 of rounding, and correlated noise where there
is grain. No code is shared with the core: the blurred disc is computed by a Fourier integral, not by the
core's edge profile.

References: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory (1993), section 3.9 (bound
of a signal in coloured Gaussian noise).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

with needs(__name__):
    from scipy.interpolate import RegularGridInterpolator
    from scipy.special import j0, j1

__all__ = ["Grain", "blurred_disc", "centre_bound_px", "edge_bound_px", "marker_bounds_px"]

Array = npt.NDArray[np.float64]

_ROUNDING_LEVELS2 = 1.0 / 12.0
#: Variance of a uniform distribution over one pixel, per axis.
_PIXEL_PX2 = 1.0 / 12.0
#: Subpixel positions of the centre over which a bound is averaged.
_PHASES_PX = ((0.0, 0.0), (0.5, 0.0), (0.25, 0.4))


@dataclass(frozen=True)
class Grain:
    """Grain in the image, after the lens; the correlation of pixels at distance d is exp(-d² / (4 size²))."""

    sigma_levels: float
    size_px: float

    @classmethod
    def behind_lens(cls, sigma_levels: float, size_px: float, lens_px: float) -> Grain:
        """Painted grain after a lens of this blur."""
        paint, seen = size_px**2, size_px**2 + lens_px**2
        return cls(sigma_levels * float(np.sqrt(paint / seen)), float(np.sqrt(seen)))


def blurred_disc(distance_px: Array, radius_px: float, blur_px: float) -> tuple[Array, Array, Array, Array]:
    """Relative contrast over distance from the centre, and its derivatives with respect to distance, radius
    and blur.

    The product of the disc's transform 2 pi r J1(kr) / k and the blur's exp(-k² s² / 2), transformed back by
    the Hankel integral of order 0.
    """
    # The contrast beyond the last wave number is e^-32; the step keeps periodic copies 100 px apart.
    last = 8.0 / blur_px
    count = int(np.ceil(last * (100.0 + radius_px) / (2.0 * np.pi))) + 1
    nodes, weights = np.polynomial.legendre.leggauss(2 * count)
    k = 0.5 * last * (nodes + 1.0)
    weight = 0.5 * last * weights * np.exp(-0.5 * (k * blur_px) ** 2) * radius_px
    kd = np.multiply.outer(np.asarray(distance_px, np.float64), k)
    share = j0(kd) @ (weight * j1(k * radius_px))
    by_distance = -j1(kd) @ (weight * k * j1(k * radius_px))
    by_radius = j0(kd) @ (weight * k * j0(k * radius_px))
    by_blur = -blur_px * (j0(kd) @ (weight * k**2 * j1(k * radius_px)))
    return share, by_distance, by_radius, by_blur


def edge_bound_px(
    radius_px: npt.ArrayLike, contrast: npt.ArrayLike, blur_px: float, noise_levels: float
) -> Array:
    """Closed form for white noise and a radius well above the blur: standard deviation of one coordinate.

    sigma_n / C sqrt(2 sigma_b / (sqrt(pi) r)), from the information pi r C² / (2 sqrt(pi) sigma_b sigma_n²)
    of a blurred circle's edge, half of which belongs to each coordinate.
    """
    r, c = np.asarray(radius_px, np.float64), np.abs(np.asarray(contrast, np.float64))
    return np.asarray(noise_levels / c * np.sqrt(2.0 * blur_px / (np.sqrt(np.pi) * r)))


def centre_bound_px(
    radius_px: npt.ArrayLike,
    contrast: npt.ArrayLike,
    blur_px: float,
    noise_levels: float,
    *,
    grain: Grain | None = None,
    pitch_px: float = np.inf,
    rounded: bool = True,
) -> Array:
    """Minimum 2-D rms error sqrt(var x + var y) of an unbiased centre, pixels.

    Parameters
    ----------
    radius_px, contrast
        Radius and contrast (grey levels) of the markers, broadcast against each other.
    blur_px
        Standard deviation of all blur, a pixel's width (0.29 px) included.
    noise_levels
        Standard deviation of the white noise, before rounding.
    grain
        Grain in the image; `None` for none.
    pitch_px
        Distance between markers; pixels nearer to a neighbour are not used.
    rounded
        Whether levels are rounded to whole numbers.
    """
    radii, contrasts = np.broadcast_arrays(
        np.asarray(radius_px, np.float64), np.abs(np.asarray(contrast, np.float64))
    )
    white = noise_levels**2 + (_ROUNDING_LEVELS2 if rounded else 0.0)
    bounds = np.empty(radii.shape)
    for r in np.unique(radii):
        # For a contrast of 1; the bound scales, because all other parameters are linear or unknown.
        of_unit = _unit_bound_px(float(r), blur_px, white, grain, pitch_px)
        here = radii == r
        bounds[here] = of_unit / contrasts[here]
    return bounds


def _unit_bound_px(
    radius_px: float, blur_px: float, white_levels2: float, grain: Grain | None, pitch_px: float
) -> float:
    variances = []
    for phase in _PHASES_PX:
        x, y = _window(radius_px, blur_px, phase, pitch_px)
        jacobian = _jacobian(x, y, radius_px, blur_px)
        noise = white_levels2 * np.eye(len(x))
        if grain is not None:
            apart2 = np.subtract.outer(x, x) ** 2 + np.subtract.outer(y, y) ** 2
            noise += grain.sigma_levels**2 * np.exp(-apart2 / (4.0 * grain.size_px**2))
        information = jacobian.T @ np.linalg.solve(noise, jacobian)
        covariance = np.linalg.inv(information)
        variances.append(covariance[0, 0] + covariance[1, 1])
    return float(np.sqrt(np.mean(variances)))


def _window(
    radius_px: float, blur_px: float, phase: tuple[float, float], pitch_px: float
) -> tuple[Array, Array]:
    """Pixels relative to a centre, including the edge and the correlated grain beside it, but not beyond half
    the pitch.
    """
    reach = min(radius_px + 5.0 * max(blur_px, 1.0), 0.5 * pitch_px)
    half = int(np.ceil(reach)) + 1
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64).reshape(2, -1) + np.asarray(
        phase
    ).reshape(2, 1)
    keep = np.maximum(np.abs(x), np.abs(y)) <= reach
    return x[keep], y[keep]


def _jacobian(x: Array, y: Array, radius_px: float, blur_px: float) -> Array:
    """Derivatives of the levels with respect to centre, radius, two stretches, blur, contrast, background and
    gradients, for contrast 1.
    """
    distance = np.hypot(x, y)
    share, by_distance, by_radius, by_blur = blurred_disc(distance, radius_px, blur_px)
    c, s = x / np.maximum(distance, 1e-12), y / np.maximum(distance, 1e-12)
    twice_c, twice_s = c * c - s * s, 2.0 * c * s
    # A stretch moves the edge by cos 2t: r dI/dr of the stretched disc, to first order in edge width over r.
    return np.column_stack(
        [
            -by_distance * c,
            -by_distance * s,
            by_radius,
            by_radius * twice_c,
            by_radius * twice_s,
            by_blur,
            share,
            np.ones_like(x),
            x,
            y,
        ]
    )


def marker_bounds_px(
    scene: Mapping[str, Any],
    centres_px: Array,
    points_mm: Array,
    *,
    view: Literal["left", "right"] = "left",
    with_grain: bool = True,
) -> Array:
    """Bound (N,), 2-D rms, of every marker of a simulated frame.

    The radius follows from the marker's depth (tilt is neglected), contrast and grain from the illumination
    at its position.

    Parameters
    ----------
    scene
        ``Scene.to_dict()``.
    centres_px
        (N, 2) true centres in that view.
    points_mm
        (N, 3) true points.
    view
        Which camera.
    with_grain
        Whether grain counts as noise; otherwise the bound is for the sensor's noise alone.
    """
    gel, effects, camera = scene["gel"], scene.get("effects", {}), scene["rig"][view]
    depth = np.asarray(points_mm, np.float64)[:, 2]
    focal_px = float(np.sqrt(camera["fx_px"] * camera["fy_px"]))
    radius = focal_px * gel["dot_radius_mm"] / depth
    gain = _gain(effects.get("uneven_light"), camera, np.asarray(centres_px, np.float64))
    contrast = float(gel["bright_level"] - gel["dark_level"])
    lens2 = grain2 = 0.0
    if (defocus := effects.get("defocus")) is not None:
        # The simulator blurs on pixels half as wide, with a kernel integrated over these. Grain is painted in
        # whole pixels and averaged over them again.
        lens2 = defocus["sigma_px"] ** 2 + _PIXEL_PX2 / 4.0
        grain2 = lens2 + 2.0 * _PIXEL_PX2
    blur = float(np.sqrt(lens2 + _PIXEL_PX2))
    noise = effects.get("sensor_noise", {"sigma_levels": 0.0})["sigma_levels"]
    painted = effects.get("grain") if with_grain else None
    pitch = float(np.median(focal_px * gel["pitch_mm"] / depth))

    # The bound is smooth in radius and gain, so a few values of each suffice.
    def nodes(values: Array) -> Array:
        low, high = float(values.min()), float(values.max())
        return np.linspace(low, high + 1e-6 * (1.0 + abs(high)), 4)

    radii, gains = nodes(radius), nodes(gain)
    table = np.empty((len(radii), len(gains)))
    for j, g in enumerate(gains):
        grain = None
        if painted is not None:
            size = float(np.sqrt(painted["size_px"] ** 2 + _PIXEL_PX2))
            grain = Grain.behind_lens(painted["sigma_levels"] * g, size, float(np.sqrt(grain2)))
        table[:, j] = centre_bound_px(radii, g * contrast, blur, noise, grain=grain, pitch_px=pitch)
    return np.asarray(RegularGridInterpolator((radii, gains), table)(np.column_stack([radius, gain])))


def _gain(light: Mapping[str, float] | None, camera: Mapping[str, Any], centres_px: Array) -> Array:
    """Relative brightness at image positions, from the scene's uneven illumination."""
    if light is None:
        return np.ones(len(centres_px))
    x = (centres_px[:, 0] + 0.5) / camera["width_px"] - 0.5
    y = (centres_px[:, 1] + 0.5) / camera["height_px"] - 0.5
    gain = 1.0 + light["across"] * x + light["down"] * y - light["corner_loss"] * 2.0 * (x * x + y * y)
    return np.asarray(np.maximum(gain, 1e-3))
