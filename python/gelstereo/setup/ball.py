"""The depth of the print below the skin, from presses with a ball of known radius.

Markers below the skin of a gel under a ball lie on a surface of a larger radius than the ball's.
`skin_over` gives the skin for any depth of the print. The depth at which the skin has the ball's radius is
smaller than that of the print, because the law of `skin_over` varies more from the middle of a contact to
its edge than the layer over the print does. `SHAPE_SHARE` corrects that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo._native import RestSurface, skin_over

__all__ = ["BallPress", "PrintDepth", "print_depth"]

Array = npt.NDArray[np.float64]

#: Depth whose skin has the ball's radius, over the depth of the print: the median over the development half
#: of the finite-element gels of bench/outside, at depths of 0.2, 0.4 and 0.8 mm under balls of 3 to 7 mm.
SHAPE_SHARE = 0.65
#: Standard deviation of the estimate from those gels: a share of the depth, and a length.
SHARE_SIGMA, LENGTH_SIGMA_MM = 0.15, 0.12
#: Markers within this share of a contact's radius are used: at its edge the law is worse (docs/outside.md).
INNER = 0.7
#: Fewest markers of a press, and of all presses.
MIN_OF_PRESS, MIN_MARKERS = 6, 20
#: Depths tried, over the largest one.
STEPS = 60
#: Largest depth tried, over the ball's radius.
MAX_OF_RADIUS = 0.4


@dataclass(frozen=True)
class BallPress:
    """Markers of one frame under a ball.

    Attributes
    ----------
    points_mm : (N, 3) float64
        Of the print, row by row, in the sensor frame.
    touching : (N,) bool
        Whether each marker is in contact.
    """

    points_mm: Array
    touching: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class PrintDepth:
    """Depth of a print below the skin.

    Attributes
    ----------
    depth_mm, sigma_mm : float
    rms_mm : float
        Distance of the markers' skin from the ball.
    markers : int
        Markers used, of all presses.
    """

    depth_mm: float
    sigma_mm: float
    rms_mm: float
    markers: int


def print_depth(
    rest: RestSurface, presses: Sequence[BallPress], *, cols: int, radius_mm: float
) -> PrintDepth | None:
    """Estimate the depth of a print.

    Parameters
    ----------
    rest : RestSurface
        The print at rest, in rows of `cols`.
    presses
        Frames under the ball.
    cols : int
    radius_mm : float
        The ball's.

    Returns
    -------
    PrintDepth or None
        None where fewer than 20 markers lie well inside the contacts.
    """
    inner = [(press, inner_markers(rest, press)) for press in presses]
    used = [(press, inside) for press, inside in inner if inside.sum() >= MIN_OF_PRESS]
    markers = sum(int(inside.sum()) for _, inside in used)
    if markers < MIN_MARKERS:
        return None
    depths_mm = np.linspace(0.0, MAX_OF_RADIUS * radius_mm, STEPS + 1)

    def off_mm(depth_mm: float) -> Array:
        return np.concatenate(list(_residuals(rest, used, cols, radius_mm, depth_mm)))

    squares = np.array([np.sum(off_mm(depth_mm) ** 2) for depth_mm in depths_mm])
    best = int(np.clip(np.argmin(squares), 1, STEPS - 1))
    # The parabola through the smallest value and its neighbours.
    before, here, after = squares[best - 1 : best + 2]
    bend = max(before - 2.0 * here + after, 1e-30)
    step_mm = depths_mm[1]
    shape_mm = float(np.clip(depths_mm[best] + 0.5 * step_mm * (before - after) / bend, 0.0, None))
    freedom = max(markers - 3 * len(used) - 1, 1)
    noise_mm = float(np.sqrt(2.0 * here / freedom / bend) * step_mm)
    depth_mm = shape_mm / SHAPE_SHARE
    law_mm = np.hypot(SHARE_SIGMA * depth_mm, LENGTH_SIGMA_MM)
    sigma_mm = float(np.hypot(noise_mm / SHAPE_SHARE, law_mm))
    return PrintDepth(depth_mm, sigma_mm, float(np.sqrt(here / markers)), markers)


def inner_markers(rest: RestSurface, press: BallPress) -> npt.NDArray[np.bool_]:
    """Markers well inside a contact, by their places at rest."""
    if not press.touching.any():
        return press.touching
    rest_mm = np.asarray(rest.points_mm)
    normal = np.asarray(rest.normal)
    middle = rest_mm[press.touching].mean(axis=0)
    away = rest_mm - middle
    aside = np.linalg.norm(away - np.outer(away @ normal, normal), axis=1)
    return np.asarray(press.touching & (aside < INNER * aside[press.touching].max()))


def _residuals(
    rest: RestSurface,
    used: Sequence[tuple[BallPress, npt.NDArray[np.bool_]]],
    cols: int,
    radius_mm: float,
    depth_mm: float,
) -> Iterator[Array]:
    """Distances of the skin from the best sphere of this radius, press by press."""
    nothing = np.zeros((len(rest.points_mm), 3, 3))
    toward = np.asarray(rest.normal)
    for press, inside in used:
        skin_mm, _ = skin_over(rest, press.points_mm, nothing, cols=cols, depth_mm=depth_mm)
        yield _off_sphere(np.asarray(skin_mm)[inside], radius_mm, toward)


def _off_sphere(points_mm: Array, radius_mm: float, toward: Array) -> Array:
    """Distances from the sphere of this radius that fits best, by Gauss and Newton.

    The normal leads to the camera, and the ball lies behind the gel.
    """
    middle = points_mm[np.argmax(points_mm @ toward)] - radius_mm * toward
    for _ in range(30):
        away = points_mm - middle
        lengths = np.linalg.norm(away, axis=1)
        step = np.linalg.lstsq(away / lengths[:, None], lengths - radius_mm, rcond=None)[0]
        middle = middle + step
        if np.linalg.norm(step) < 1e-9:
            break
    return np.asarray(np.linalg.norm(points_mm - middle, axis=1) - radius_mm)
