"""Rigid parts as signed distance functions, and their motion. Parts are above the gel and press towards -z.

Here z is the height above the gel's bonded back, so the gel's free surface is at its thickness. Adding the
back's height gives world coordinates; both z axes point away from the cameras.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .optics import turned

Array = npt.NDArray[np.float64]

# Limit of the curvature, per mm; twice that of the sharpest rounded edge of the solids.
MAX_CURVATURE = 8.0


def to_outline(points: Array, corners: Array) -> Array:
    """Signed distance in the plane to a closed outline of corners in order, positive outside."""
    distance = np.full(len(points), np.inf)
    inside = np.zeros(len(points), dtype=bool)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        way, off = end - start, points - start
        share = np.clip(off @ way / (way @ way), 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(off - share[:, None] * way, axis=1))
        crosses = (start[1] > points[:, 1]) != (end[1] > points[:, 1])
        if way[1] != 0:
            inside ^= crosses & (off[:, 0] < off[:, 1] / way[1] * way[0])
    return np.where(inside, -distance, distance)


@dataclass(frozen=True)
class Part:
    """A ball; a box, cylinder (axis along x) or plate (an outline along x and y) with rounded edges; a group
    of these.

    It is rotated about its own origin. `half_mm` is the half sides of a box, (half length, radius, radius) of
    a cylinder, or the half thickness of a plate in all three entries. `at_mm` is the position of a group's
    part.
    """

    kind: str
    half_mm: tuple[float, float, float]
    edge_mm: float = 0.2
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    outline_mm: tuple[tuple[float, float], ...] = ()
    at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pieces: tuple[Part, ...] = ()

    @classmethod
    def read(cls, entry: Mapping[str, Any]) -> Part:
        """The part of an entry of `contacts.toml`."""
        kind, more = entry["kind"], {k: tuple(entry[k]) for k in ("turn_deg", "at_mm") if k in entry}
        if kind == "ball":
            return cls(kind, (entry["radius_mm"],) * 3, **more)
        if kind == "group":
            return cls(kind, (0.0,) * 3, pieces=tuple(cls.read(e) for e in entry["pieces"]), **more)
        if kind == "cylinder":
            half = (0.5 * entry["length_mm"], entry["radius_mm"], entry["radius_mm"])
        elif kind == "box":
            half = tuple(0.5 * side for side in entry["size_mm"])
        elif kind == "plate":
            half = (0.5 * entry["thickness_mm"],) * 3
            more["outline_mm"] = tuple(map(tuple, entry["outline_mm"]))
        else:
            raise ValueError(f"part kind {kind!r}; valid are ball, cylinder, box, plate, group")
        return cls(kind, half, entry.get("edge_mm", 0.2), **more)

    def own_distance(self, points: Array) -> Array:
        """Signed distance of points in the part's frame (n x 3), positive outside."""
        if self.kind == "group":
            found = [p.own_distance((points - p.at_mm) @ turned(*p.turn_deg)) for p in self.pieces]
            return np.asarray(np.min(found, axis=0))
        if self.kind == "ball":
            return np.asarray(np.linalg.norm(points, axis=1) - self.half_mm[0])
        if self.kind == "cylinder":
            off = np.stack((np.abs(points[:, 0]), np.hypot(points[:, 1], points[:, 2])), axis=1)
            beyond = off - np.array(self.half_mm[:2])
        elif self.kind == "plate":
            across = to_outline(points[:, :2], np.array(self.outline_mm))
            beyond = np.stack((across, np.abs(points[:, 2]) - self.half_mm[2]), axis=1)
        else:
            beyond = np.abs(points) - np.array(self.half_mm)
        beyond = beyond + self.edge_mm
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0) - self.edge_mm)


@dataclass(frozen=True)
class Posed:
    """A part at `middle_mm`, with an additional rotation about z by `twist_deg`."""

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
        """Second derivatives of the distance (n x 3 x 3), clipped where faces meet without a rounded edge."""
        axes = step * np.eye(3)
        found = [(self.slope(points + a) - self.slope(points - a)) / (2 * step) for a in axes]
        return np.clip(np.stack(found, axis=2), -MAX_CURVATURE, MAX_CURVATURE)

    def carried(self, points: Array, before: Posed) -> Array:
        """Displacement of points that stick to the part, from `before` to now (n x 3, mm)."""
        own = (points - self.middle_mm) @ self.rotation
        return points - (own @ before.rotation.T + before.middle_mm)


def at_touch(
    part: Part, thickness_mm: float, middle_mm: tuple[float, float], reach_mm: float = 12.0
) -> Posed:
    """The part at first touch of a flat gel."""
    grid = np.linspace(-reach_mm, reach_mm, 481)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    on_gel = np.stack((x, y, np.full_like(x, thickness_mm)), axis=1)
    low, high = thickness_mm - 30.0, thickness_mm + 30.0
    for _ in range(40):
        height = 0.5 * (low + high)
        distance = Posed(part, np.array([*middle_mm, height])).distance(on_gel)
        # Points that are farther than the part can still move never touch.
        on_gel = on_gel[distance <= high - low]
        if distance.min() > 0:
            high = height
        else:
            low = height
    return Posed(part, np.array([*middle_mm, high]))
