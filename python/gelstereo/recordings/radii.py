"""The radius of one rigid part from the markers on it, in one or more frames, with its predicted error.

The part has one radius in all frames and a separate pose in each. Gauss-Newton runs over the radius, with the
poses eliminated frame by frame (Schur complement).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from gelstereo.recordings.clouds import RecordingError
from gelstereo.recordings.fits import fit_cylinder, fit_plane, fit_sphere

__all__ = ["RadiusFit", "cap_radius_sigma_mm", "fit_radius"]

Array = npt.NDArray[np.float64]
Shape = Literal["sphere", "cylinder"]

_ITERATIONS = 100
_SETTLED_MM = 1e-8


@dataclass(frozen=True)
class RadiusFit:
    """One radius fitted to all frames."""

    radius_mm: float
    #: Standard error from the markers' noise alone.
    sigma_mm: float
    #: Root mean square distance of the markers from the part.
    rms_mm: float
    converged: bool


def cap_radius_sigma_mm(
    shape: Shape, radius_mm: float, half_width_mm: float, markers: int, sigma_mm: float
) -> float:
    """Standard error of a radius from a shallow cap, in closed form.

    A cap of half width a is the parabola κ u² / 2 with κ = 1 / R; tilt and height are unknown. Markers spread
    evenly over a disc have var(u² / 2) = a⁴ / 48, over a strip a⁴ / 45. This gives the error of κ; the error
    of R is R² times as large.
    """
    spread = 48.0 if shape == "sphere" else 45.0
    return float(radius_mm**2 * sigma_mm / half_width_mm**2 * np.sqrt(spread / markers))


def fit_radius(points_mm: Sequence[Array], shape: Shape, noise_mm: npt.ArrayLike) -> RadiusFit:
    """Fit one radius to the markers of all frames, with a separate pose in each frame.

    Parameters
    ----------
    points_mm
        Markers (N, 3) of every frame, on the side that faces the camera.
    shape
        ``"sphere"`` or ``"cylinder"``.
    noise_mm
        Standard deviation (3,) of a marker along x, y and z; it weights the distances along the surface's
        normal.

    Raises
    ------
    RecordingError
        The arguments are not valid, a frame's markers are flat within their noise, or a plane fits them
        better.
    """
    if shape not in ("sphere", "cylinder"):
        raise RecordingError(f"shape is {shape!r}; valid is 'sphere' or 'cylinder'")
    noise = np.asarray(noise_mm, np.float64)
    if noise.shape != (3,) or not (noise > 0.0).all() or not np.isfinite(noise).all():
        raise RecordingError(f"the noise is {noise}; valid are three positive numbers")
    if not points_mm:
        raise RecordingError("no frames; at least one is needed")
    flat_squares = sum(_plane_squares(p, shape, float(noise.max())) for p in points_mm)
    poses: list[_Sphere | _Cylinder] = [
        _Sphere(p, noise) if shape == "sphere" else _Cylinder(p, noise) for p in points_mm
    ]
    radius = 1.0 / float(np.median([1.0 / pose.start_mm for pose in poses]))
    converged = False
    for _ in range(_ITERATIONS):
        systems = [_eliminated(pose, radius) for pose in poses]
        information = sum(s.information for s in systems)
        step = float(np.clip(sum(s.gradient for s in systems) / information, -0.3 * radius, 0.3 * radius))
        largest = abs(step)
        for pose, s in zip(poses, systems, strict=True):
            moved = s.pose_step + step * s.pose_per_radius
            pose.move(moved)
            largest = max(largest, float(np.abs(moved).max()))
        radius += step
        if largest < _SETTLED_MM:
            converged = True
            break
    information = sum(_eliminated(pose, radius).information for pose in poses)
    squares = sum(float(np.sum((pose.distances() - radius) ** 2)) for pose in poses)
    count = sum(len(p) for p in points_mm)
    if not squares < flat_squares:
        about, plane = (np.sqrt(total / count) for total in (squares, flat_squares))
        raise RecordingError(
            f"the markers lie {about:.3g} mm rms about the {shape} and {plane:.3g} mm about planes; "
            "valid are markers of a cap that faces the camera"
        )
    return RadiusFit(radius, float(1.0 / np.sqrt(information)), float(np.sqrt(squares / count)), converged)


def _plane_squares(points_mm: Array, shape: str, noise_mm: float) -> float:
    """Sum of squared distances from the best-fit plane; it is an error if the markers are flat within their
    noise.
    """
    points = np.asarray(points_mm, np.float64)
    rms_mm = fit_plane(points).rms_mm
    # Markers span fewer than three dimensions: the radius is undetermined.
    if not rms_mm > noise_mm:
        raise RecordingError(
            f"{len(points)} markers lie {rms_mm:.2g} mm rms about a plane, which is no more than their noise "
            f"of {noise_mm:.2g} mm; they do not determine the radius of a {shape}"
        )
    return float(rms_mm**2 * len(points))


@dataclass(frozen=True)
class _System:
    """Reduced normal equations of one frame, with its pose eliminated."""

    information: float
    gradient: float
    pose_step: Array
    pose_per_radius: Array


def _eliminated(pose: _Sphere | _Cylinder, radius: float) -> _System:
    residual = radius - pose.distances()
    normals, jacobian = pose.linearized()
    weight = 1.0 / np.sqrt(normals**2 @ pose.noise**2)
    a, b, c = jacobian * weight[:, None], -weight, residual * weight
    # Both right-hand sides at once: the step for this radius, and how it changes with the radius.
    solved = np.asarray(np.linalg.lstsq(a, np.column_stack([c, -b]), rcond=None)[0], np.float64)
    left_over = b + a @ solved[:, 1]
    return _System(float(left_over @ left_over), float(left_over @ c), solved[:, 0], solved[:, 1])


class _Sphere:
    """A sphere's centre in one frame."""

    def __init__(self, points_mm: Array, noise: Array) -> None:
        fit = fit_sphere(points_mm)
        self.points, self.noise = points_mm, noise
        self.start_mm, self.centre = fit.radius_mm, fit.centre_mm

    def distances(self) -> Array:
        distance: Array = np.linalg.norm(self.points - self.centre, axis=1)
        return distance

    def linearized(self) -> tuple[Array, Array]:
        offset = self.points - self.centre
        normals = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        return normals, -normals

    def move(self, step: Array) -> None:
        self.centre = self.centre + step


class _Cylinder:
    """A cylinder's axis in one frame, parametrised by the plane perpendicular to the axis."""

    def __init__(self, points_mm: Array, noise: Array) -> None:
        fit = fit_cylinder(points_mm)
        self.points, self.noise = points_mm, noise
        middle = points_mm.mean(axis=0)
        self.start_mm, self.axis = fit.radius_mm, fit.axis
        self.centre = fit.centre_mm + ((middle - fit.centre_mm) @ fit.axis) * fit.axis

    def _radial(self) -> tuple[Array, Array]:
        offset = self.points - self.centre
        along = offset @ self.axis
        return along, offset - along[:, None] * self.axis

    def distances(self) -> Array:
        distance: Array = np.linalg.norm(self._radial()[1], axis=1)
        return distance

    def _across(self) -> tuple[Array, Array]:
        side = np.cross(self.axis, np.eye(3)[int(np.argmin(np.abs(self.axis)))])
        side /= np.linalg.norm(side)
        return side, np.cross(self.axis, side)

    def linearized(self) -> tuple[Array, Array]:
        along, radial = self._radial()
        normals = radial / np.linalg.norm(radial, axis=1, keepdims=True)
        first, second = (normals @ direction for direction in self._across())
        return normals, np.column_stack([-first, -second, -along * first, -along * second])

    def move(self, step: Array) -> None:
        first, second = self._across()
        self.centre = self.centre + step[0] * first + step[1] * second
        self.axis = self.axis + step[2] * first + step[3] * second
        self.axis = self.axis / np.linalg.norm(self.axis)
