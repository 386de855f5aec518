"""Rigid parts by their signed distances, and their motion. Parts stand over the gel: they press towards -z.

Here z is the height over the gel's bonded back, so that the gel's free surface is at its thickness. World
coordinates follow by adding the back's height: both z axes point away from the cameras.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .optics import turned

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """A ball, or a box or cylinder (axis along x) with rounded edges, turned about its middle.

    `half_mm` are the box's half sides, or half the cylinder's length and its radius twice.
    """

    kind: str
    half_mm: tuple[float, float, float]
    edge_mm: float = 0.2
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def read(cls, entry: Mapping[str, Any]) -> Part:
        """The part of an entry of `contacts.toml`."""
        kind, turn = entry["kind"], tuple(entry.get("turn_deg", (0.0, 0.0, 0.0)))
        if kind == "ball":
            return cls(kind, (entry["radius_mm"],) * 3)
        if kind == "cylinder":
            half = (0.5 * entry["length_mm"], entry["radius_mm"], entry["radius_mm"])
        elif kind == "box":
            half = tuple(0.5 * side for side in entry["size_mm"])
        else:
            raise ValueError(f"part kind {kind!r}; valid are ball, cylinder, box")
        return cls(kind, half, entry.get("edge_mm", 0.2), turn)

    def own_distance(self, points: Array) -> Array:
        """Signed distance of points in the part's frame (n x 3), positive outside."""
        if self.kind == "ball":
            return np.asarray(np.linalg.norm(points, axis=1) - self.half_mm[0])
        if self.kind == "cylinder":
            off = np.stack((np.abs(points[:, 0]), np.hypot(points[:, 1], points[:, 2])), axis=1)
            half = np.array(self.half_mm[:2])
        else:
            off, half = np.abs(points), np.array(self.half_mm)
        beyond = off - half + self.edge_mm
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0) - self.edge_mm)


@dataclass(frozen=True)
class Posed:
    """A part at `middle_mm`, turned about z by `twist_deg` more than it is by itself."""

    part: Part
    middle_mm: Array
    twist_deg: float = 0.0

    @property
    def rotation(self) -> Array:
        return turned(0, 0, self.twist_deg) @ turned(*self.part.turn_deg)

    def distance(self, points: Array) -> Array:
        """Signed distance, mm."""
        return self.part.own_distance((points - self.middle_mm) @ self.rotation)

    def slope(self, points: Array, step: float = 1e-5) -> Array:
        """Gradient of the distance: the outward unit normal (n x 3)."""
        axes = step * np.eye(3)
        return np.stack(
            [(self.distance(points + a) - self.distance(points - a)) / (2 * step) for a in axes], axis=1
        )

    def curvature(self, points: Array, step: float = 1e-3) -> Array:
        """Second derivatives of the distance (n x 3 x 3)."""
        axes = step * np.eye(3)
        return np.stack(
            [(self.slope(points + a) - self.slope(points - a)) / (2 * step) for a in axes], axis=2
        )

    def carried(self, points: Array, before: Posed) -> Array:
        """How far the part carries points that stick to it, from `before` to now (n x 3, mm)."""
        own = (points - self.middle_mm) @ self.rotation
        return points - (own @ before.rotation.T + before.middle_mm)


def at_touch(
    part: Part, thickness_mm: float, middle_mm: tuple[float, float], reach_mm: float = 12.0
) -> Posed:
    """The part over a flat gel, at the height at which it just touches it."""
    grid = np.linspace(-reach_mm, reach_mm, 481)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    on_gel = np.stack((x, y, np.full_like(x, thickness_mm)), axis=1)
    low, high = thickness_mm - 30.0, thickness_mm + 30.0
    for _ in range(40):
        height = 0.5 * (low + high)
        if Posed(part, np.array([*middle_mm, height])).distance(on_gel).min() > 0:
            high = height
        else:
            low = height
    return Posed(part, np.array([*middle_mm, high]))
