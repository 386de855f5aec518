"""Least-squares spheres, cylinders and planes through points, for parts of unknown dimensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo.recordings.clouds import RecordingError

__all__ = ["CylinderFit", "PlaneFit", "SphereFit", "fit_cylinder", "fit_plane", "fit_sphere"]

Array = npt.NDArray[np.float64]

_ITERATIONS = 50


@dataclass(frozen=True)
class SphereFit:
    """A least-squares sphere."""

    centre_mm: Array
    radius_mm: float
    rms_mm: float


@dataclass(frozen=True)
class CylinderFit:
    """A least-squares cylinder."""

    #: A point on the axis, and its direction.
    centre_mm: Array
    axis: Array
    radius_mm: float
    rms_mm: float


@dataclass(frozen=True)
class PlaneFit:
    """A least-squares plane."""

    centre_mm: Array
    #: Unit normal, towards the camera (negative z).
    normal: Array
    rms_mm: float


def fit_plane(points_mm: Array) -> PlaneFit:
    """Fit a plane to points (N, 3)."""
    _check(points_mm, 3, "a plane")
    centre = points_mm.mean(axis=0)
    _, singular, vt = np.linalg.svd(points_mm - centre, full_matrices=False)
    normal = vt[2] if vt[2, 2] < 0.0 else -vt[2]
    return PlaneFit(centre, normal, float(singular[2] / np.sqrt(len(points_mm))))


def fit_sphere(points_mm: Array) -> SphereFit:
    """Fit a sphere to points (N, 3): algebraic start, then Gauss-Newton on distances."""
    _check(points_mm, 4, "a sphere")
    origin = points_mm.mean(axis=0)
    p = points_mm - origin
    start = np.linalg.lstsq(np.column_stack([2.0 * p, np.ones(len(p))]), np.sum(p**2, axis=1), rcond=None)[0]
    x = np.append(start[:3], np.sqrt(max(start[3] + start[:3] @ start[:3], 1e-12)))
    for _ in range(_ITERATIONS):
        offset = p - x[:3]
        distance = np.linalg.norm(offset, axis=1)
        jacobian = np.column_stack([-offset / distance[:, None], -np.ones(len(p))])
        step = np.linalg.lstsq(jacobian, x[3] - distance, rcond=None)[0]
        x = x + step
        if np.abs(step).max() < 1e-9:
            break
    rms = float(np.sqrt(np.mean((np.linalg.norm(p - x[:3], axis=1) - x[3]) ** 2)))
    return SphereFit(origin + x[:3], float(x[3]), rms)


def fit_cylinder(points_mm: Array) -> CylinderFit:
    """Fit a cylinder that lies on its side to points (N, 3) of the strip that faces the camera.

    The axis starts along the strip; Gauss-Newton on distances follows.
    """
    _check(points_mm, 5, "a cylinder")
    origin = points_mm.mean(axis=0)
    p = points_mm - origin
    axis = np.linalg.svd(p, full_matrices=False)[2][0]
    side, up = _across(axis)
    across, height = p @ side, p @ up
    # In the plane perpendicular to the axis, the cylinder is a circle.
    start = np.linalg.lstsq(
        np.column_stack([2.0 * across, 2.0 * height, np.ones(len(p))]), across**2 + height**2, rcond=None
    )[0]
    centre = start[0] * side + start[1] * up
    radius = float(np.sqrt(max(start[2] + start[0] ** 2 + start[1] ** 2, 1e-12)))
    for _ in range(_ITERATIONS):
        offset = p - centre
        along = offset @ axis
        radial = offset - along[:, None] * axis
        distance = np.linalg.norm(radial, axis=1)
        normal = radial / distance[:, None]
        # Rotating the axis by a about `side` or b about `up` moves a point at `along` against its normal.
        jacobian = np.column_stack(
            [-normal @ side, -normal @ up, -along * (normal @ side), -along * (normal @ up), -np.ones(len(p))]
        )
        step = np.linalg.lstsq(jacobian, radius - distance, rcond=None)[0]
        centre = centre + step[0] * side + step[1] * up
        axis = axis + step[2] * side + step[3] * up
        axis /= np.linalg.norm(axis)
        side, up = _across(axis)
        radius += float(step[4])
        if np.abs(step).max() < 1e-9:
            break
    offset = p - centre
    distance = np.linalg.norm(offset - (offset @ axis)[:, None] * axis, axis=1)
    return CylinderFit(origin + centre, axis, radius, float(np.sqrt(np.mean((distance - radius) ** 2))))


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors perpendicular to the axis; the first one is also perpendicular to z."""
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def _check(points_mm: Array, min_points: int, what: str) -> None:
    if points_mm.ndim != 2 or points_mm.shape[1] != 3 or not np.isfinite(points_mm).all():
        raise RecordingError(f"points have shape {points_mm.shape}; valid is (N, 3), all finite")
    if len(points_mm) < min_points:
        raise RecordingError(f"{len(points_mm)} points for {what}; at least {min_points} are needed")
