"""Two cameras that view a print through flat layers: geometry, Snell's law and the rig as TOML.

Lengths are millimetres. The world's origin is the left camera's centre; its z axis is the normal of the
layers and points away from the cameras. The sensor frame is the left camera's: x right, y down, z along the
axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def turned(x_deg: float, y_deg: float, z_deg: float) -> Array:
    """Rotation about x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians([x_deg, y_deg, z_deg])) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


@dataclass(frozen=True)
class Camera:
    """A camera without distortion; `rotation` maps camera to world, `centre_mm` is in the world."""

    rotation: Array
    centre_mm: Array
    c_px: tuple[float, float]
    f_px: float = 480.0
    size_px: tuple[int, int] = (640, 480)
    aperture_mm: float = 0.3

    def pixels(self, directions: Array) -> Array:
        """Pixels of rays along `directions` (world, n x 3)."""
        d = directions @ self.rotation
        return np.asarray(self.f_px * d[:, :2] / d[:, 2:] + np.asarray(self.c_px))


@dataclass(frozen=True)
class Optics:
    """Air, an acrylic plate and a gel of constant thickness, seen by two slightly tilted cameras."""

    thickness_mm: float
    gap_mm: float = 20.0
    plate_mm: float = 3.0
    plate_index: float = 1.49
    gel_index: float = 1.41
    left: Camera = field(
        default_factory=lambda: Camera(turned(0.4, -0.5, 0.2), np.zeros(3), c_px=(323.5, 236.5))
    )
    right: Camera = field(
        default_factory=lambda: Camera(
            turned(0.1, -0.9, -0.1), np.array([8.0, 0.05, -0.03]), c_px=(316.5, 241.5)
        )
    )

    @property
    def back_mm(self) -> float:
        """Height of the gel's bonded back."""
        return self.gap_mm + self.plate_mm

    @property
    def surface_mm(self) -> float:
        """Height of the print at rest."""
        return self.back_mm + self.thickness_mm

    def directions(self, camera: Camera, points_mm: Array) -> Array:
        """Directions in air, at the camera, of the rays that reach points in the gel (world, n x 3).

        Newton's method for the ray's slope in air: the lateral shifts in the layers sum to the point's
        lateral distance from the camera.
        """
        offset = points_mm - camera.centre_mm
        across = np.hypot(offset[:, 0], offset[:, 1])
        gap = self.gap_mm - camera.centre_mm[2]
        depths = (gap, self.plate_mm, points_mm[:, 2] - self.back_mm)
        indices = (1.0, self.plate_index, self.gel_index)
        slope = across / offset[:, 2]
        for _ in range(20):
            sine2 = slope**2 / (1 + slope**2)
            shift, rate = np.zeros_like(slope), np.zeros_like(slope)
            for depth, index in zip(depths, indices, strict=True):
                root = np.sqrt(index**2 - sine2)
                shift += depth * np.sqrt(sine2) / root
                # d(sine)/d(slope) = cos^3.
                rate += depth * index**2 / root**3 * (1 - sine2) ** 1.5
            slope = slope - (shift - across) / rate
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        return np.stack((slope * np.cos(angle), slope * np.sin(angle), np.ones_like(slope)), axis=1)

    def project(self, points_mm: Array) -> tuple[Array, Array]:
        """Pixels of points in the gel (world, n x 3), left and right."""
        left, right = (c.pixels(self.directions(c, points_mm)) for c in (self.left, self.right))
        return left, right

    def in_sensor_frame(self, points_mm: Array) -> Array:
        """Points of the world in the left camera's frame."""
        return np.asarray((points_mm - self.left.centre_mm) @ self.left.rotation)

    def rig_toml(self) -> str:
        """The rig as TOML for `gelstereo.Rig.from_toml`, including layers."""
        rotation = self.right.rotation.T @ self.left.rotation
        translation = self.right.rotation.T @ (self.left.centre_mm - self.right.centre_mm)
        normal = self.left.rotation.T @ np.array([0.0, 0.0, 1.0])
        views = [
            f"[{name}]\nwidth_px = {c.size_px[0]}\nheight_px = {c.size_px[1]}\nfx_px = {c.f_px}\nfy_px = "
            f"{c.f_px}\n"
            f"cx_px = {c.c_px[0]}\ncy_px = {c.c_px[1]}\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
            for name, c in (("left", self.left), ("right", self.right))
        ]
        return "\n".join(
            (
                "layers = "
                f"{{ normal = {normal.tolist()}, gap_mm = {self.gap_mm}, plates = [{{ thickness_mm = "
                f"{self.plate_mm}, index = {self.plate_index} }}], gel_index = {self.gel_index} }}\n",
                *views,
                f"[t_right_left]\nrotation_xyzw = {quaternion(rotation).tolist()}\n"
                f"translation_mm = {translation.tolist()}\n",
            )
        )


def quaternion(rotation: Array) -> Array:
    """x, y, z, w of a rotation by less than 180 degrees."""
    w = 0.5 * np.sqrt(1 + np.trace(rotation))
    skew = rotation - rotation.T
    xyz = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * w)
    return np.append(xyz, w)
