"""Stereo frames drawn without the simulator: printed discs on a gel, and what a camera sees around the gel.

The gel takes the shape of what is pressed into it and returns to rest exponentially. The truth is exact: a
marker is where its point of the gel projects to.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

import gelstereo

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

SIZE_PX = (640, 480)
SIDE, PITCH_MM, RADIUS_MM = 25, 0.85, 0.2
#: Depth of the gel's surface at rest, and the length over which it returns to rest beside a part.
SURFACE_MM, SHOULDER_MM = 28.0, 0.7
GEL_LEVEL, DOT_LEVEL, TRAY_LEVEL = 170.0, 60.0, 40.0
BLUR_PX = 0.8


@dataclass(frozen=True)
class Press:
    """A part in the gel."""

    kind: Literal["board", "cylinder", "ball"]
    depth_mm: float
    place_mm: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0
    #: Half the sides of a board; half the length of a cylinder comes second.
    half_mm: tuple[float, float] = (4.0, 6.0)
    radius_mm: float = 5.0

    def heights_mm(self, xy_mm: Array) -> Array:
        """How far points of the gel are pushed in."""
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        away = xy_mm - np.asarray(self.place_mm)
        u, v = np.abs(away @ [cos, sin]), np.abs(away @ [-sin, cos])
        # A round part leaves the gel where it has sunk half as deep as in the middle.
        rim_mm = np.sqrt(self.radius_mm * self.depth_mm)
        if self.kind == "board":
            across, along = u - self.half_mm[0], v - self.half_mm[1]
        elif self.kind == "cylinder":
            across, along = u - rim_mm, v - self.half_mm[1]
        else:
            across, along = np.hypot(u, v) - rim_mm, np.full(len(u), -np.inf)
        outside_mm = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
        from_axis_mm = 0.0 if self.kind == "board" else np.minimum(across, 0.0) + rim_mm
        top_mm = self.depth_mm - from_axis_mm**2 / (2.0 * self.radius_mm)
        return np.asarray(top_mm * np.exp(-outside_mm / SHOULDER_MM))


@dataclass(frozen=True)
class Sensor:
    """A sensor that is drawn: its cameras, and what is in view besides the gel."""

    tray: bool = True
    noise_levels: float = 2.0
    rig: gelstereo.Rig = field(default_factory=lambda: gelstereo.Rig.parallel(SIZE_PX, 500.0, 6.0))

    @property
    def rest_mm(self) -> Array:
        """Markers at rest, row by row, in the frame of the left camera."""
        steps = (np.arange(SIDE) - (SIDE - 1) / 2) * PITCH_MM
        y, x = np.meshgrid(steps, steps, indexing="ij")
        return np.column_stack([x.ravel() + 3.0, y.ravel(), np.full(SIDE * SIDE, SURFACE_MM)])

    def markers_mm(self, press: Press | None, moved_mm: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Markers under a part, the whole print moved sideways."""
        points_mm = self.rest_mm
        if press is not None:
            points_mm[:, 2] -= press.heights_mm(points_mm[:, :2] - [3.0, 0.0])
        points_mm[:, :2] += moved_mm
        return points_mm

    def pair(self, points_mm: Array, seed: int) -> tuple[Image, Image]:
        """Left and right image of markers at these points."""
        left_px, right_px = self.rig.project(points_mm)
        f_px = float(self.rig.left_matrix[0, 0])
        radii_px = f_px * RADIUS_MM / points_mm[:, 2]
        gels_px = [(at.min(axis=0) - 22.0, at.max(axis=0) + 22.0) for at in self.rig.project(self.rest_mm)]
        left = self._view(left_px, radii_px, gels_px[0], [seed, 0])
        right = self._view(right_px, radii_px, gels_px[1], [seed, 1])
        return left, right

    def _view(self, at_px: Array, radii_px: Array, gel_px: tuple[Array, Array], seed: list[int]) -> Image:
        width, height = SIZE_PX
        x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
        covered = np.zeros((height, width))
        for (u, v), radius in zip(at_px, radii_px, strict=True):
            reach = int(radius + 4 * BLUR_PX) + 2
            if not (-reach < u < width + reach and -reach < v < height + reach):
                continue
            rows = slice(max(int(v) - reach, 0), int(v) + reach + 1)
            cols = slice(max(int(u) - reach, 0), int(u) + reach + 1)
            distance = np.hypot(x[rows, cols] - u, y[rows, cols] - v)
            covered[rows, cols] = np.maximum(covered[rows, cols], _edge((radius - distance) / BLUR_PX))
        levels = GEL_LEVEL - (GEL_LEVEL - DOT_LEVEL) * covered
        if self.tray:
            levels = _with_tray(levels, x, y, gel_px)
        levels = levels + np.random.default_rng(seed).normal(0.0, self.noise_levels, levels.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def _edge(sigmas: Array) -> Array:
    """A blurred step: a logistic curve of the slope of a Gaussian's integral."""
    return 1.0 / (1.0 + np.exp(-1.702 * np.clip(sigmas, -30.0, 30.0)))


def _with_tray(levels: Array, x: Array, y: Array, gel_px: tuple[Array, Array]) -> Array:
    """A dark tray round the gel: light that falls off at its walls, a pale frame, screws and two lamps."""
    low, high = gel_px
    inside = np.minimum.reduce([x - low[0], high[0] - x, y - low[1], high[1] - y])
    # The walls differ in how softly the light falls off.
    softness = np.where(x < low[0], 8.0, np.where(x > high[0], 2.0, 4.0))
    levels = TRAY_LEVEL + (levels - TRAY_LEVEL) * _edge(inside / softness)
    frame = _edge(inside + 62.0) - _edge(inside + 50.0)
    levels = levels + 90.0 * frame
    middle = (low + high) / 2
    for u, v in ((low[0] - 40, middle[1] - 60), (low[0] - 42, middle[1] + 70), (high[0] + 40, middle[1])):
        screw = _edge(5.0 - np.hypot(x - u, y - v))
        levels = levels * (1.0 - 0.7 * screw)
    for u in (middle[0] - 90.0, middle[0] + 110.0):
        levels = levels + 200.0 * _edge(4.0 - np.hypot(x - u, y - (low[1] - 30.0)))
    return levels
