"""A hole for a part's end, and the test whether the part goes in from a given pose.

The hole's frame is the part's frame at the ideal inserted pose, with z along the hole, into it. The hole is
the widened convex hull of the part's inserted end, with vertical walls and without chamfer; both are rigid.
The part is lowered along z without rotation or lateral motion. It goes in if and only if everything below the
mouth at the end lies between the walls; what is below the mouth earlier is a subset of that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import Error
from gelstereo.extras import needs

with needs(__name__):
    from scipy.spatial import ConvexHull

if TYPE_CHECKING:
    import trimesh

__all__ = ["Hole", "InsertedEnd"]

Array = npt.NDArray[np.float64]

#: Points farther from the walls than this are ignored, because others meet the walls first.
_NEAR_MM = 0.75
#: Walls with normals within this tolerance are merged: a section has points along its edges, which round-off
#: displaces.
_SAME_WALL_RAD = 1e-4


@dataclass(frozen=True)
class InsertedEnd:
    """The part of the surface that matters for a hole, part frame, mm."""

    vertices_mm: Array
    #: (E, 2) vertex indices of each edge.
    edges: npt.NDArray[np.int64]

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> InsertedEnd:
        """Extract vertices and edges of a mesh whose end towards +z is inserted."""
        return cls(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.edges_unique, np.int64))

    def below(self, mouth_mm: float, t_hole_object: Array) -> Array:
        """Points with the same convex hull as the part beyond the plane z = `mouth_mm` of the hole's frame,
        (N, 3) mm.

        They are the vertices beyond the plane, and the intersections of edges with it.
        """
        placed = self.vertices_mm @ t_hole_object[:3, :3].T + t_hole_object[:3, 3]
        height = placed[:, 2] - mouth_mm
        first, second = self.edges[(height[self.edges] > 0.0).sum(axis=1) == 1].T
        share = height[first] / (height[first] - height[second])
        crossings = placed[first] + share[:, None] * (placed[second] - placed[first])
        return np.vstack([placed[height > 0.0], crossings])


@dataclass(frozen=True)
class Hole:
    """Upright walls around a part's end."""

    #: (K, 2) outward unit normals of the walls.
    normals: Array
    #: (K,) distances of the walls from the origin along them, mm.
    offsets_mm: Array
    #: z of the part's tip when inserted, and of the mouth, hole's frame, mm.
    tip_mm: float
    mouth_mm: float

    @classmethod
    def around(cls, end: InsertedEnd, depth_mm: float, clearance_mm: float) -> Hole:
        """Create the hole for `depth_mm` of a part's end; `clearance_mm` is the hole's width minus the
        part's.

        Raises
        ------
        Error
            If the depth is not above 0 and below the part's length, or the clearance not above 0.
        """
        heights = end.vertices_mm[:, 2]
        length_mm = float(np.ptp(heights))
        if not 0.0 < depth_mm < length_mm:
            raise Error(f"depth_mm is {depth_mm}; valid is above 0 and below the part's {length_mm:.3f} mm")
        if not clearance_mm > 0.0:
            raise Error(f"clearance_mm is {clearance_mm}; valid is above 0")
        tip_mm = float(heights.max())
        section = end.below(tip_mm - depth_mm, np.eye(4))[:, :2]
        order = cv2.convexHull(section.astype(np.float32), returnPoints=False)[:, 0]
        hull = section[order]
        along = np.roll(hull, -1, axis=0) - hull
        area = float(np.sum(hull[:, 0] * along[:, 1] - hull[:, 1] * along[:, 0]))
        normals = np.sign(area) * np.column_stack([along[:, 1], -along[:, 0]])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        normals = normals[np.linalg.norm(normals - np.roll(normals, 1, axis=0), axis=1) > _SAME_WALL_RAD]
        offsets = np.max(section @ normals.T, axis=0) + 0.5 * clearance_mm
        return cls(normals, offsets, tip_mm, tip_mm - depth_mm)

    def room_mm(self, end: InsertedEnd, t_hole_object: Array) -> float:
        """Minimum clearance of the inserted part to the walls, mm; below 0 it does not go in.

        The part is lowered until its tip is as deep as the hole, so its initial height does not matter.
        """
        lowered = np.array(t_hole_object, np.float64)
        placed = end.vertices_mm @ lowered[2, :3] + lowered[2, 3]
        lowered[2, 3] += self.tip_mm - placed.max()
        points = end.below(self.mouth_mm, lowered)[:, :2]
        return float(np.min(self.offsets_mm - np.max(points @ self.normals.T, axis=0)))

    def rooms_mm(self, end: InsertedEnd, motions: Array) -> Array:
        """`room_mm` of many motions of the inserted part, (S, 4, 4), small except about and along z; (S,) mm.

        Only points near the walls at the inserted pose are checked. A motion that brings any other point to a
        wall moves these points through it.
        """
        points = end.below(self.mouth_mm, np.eye(4))
        room = np.min(self.offsets_mm - points[:, :2] @ self.normals.T, axis=1)
        near = points[room < _NEAR_MM]
        # The farthest point along a wall's normal is a vertex of the convex hull, for every motion.
        near = near[ConvexHull(near).vertices]
        x, y = (near @ motions[:, axis, :3].T + motions[:, axis, 3] for axis in (0, 1))
        rooms, along, across = np.full(len(motions), np.inf), np.empty_like(x), np.empty_like(x)
        for (nx, ny), offset in zip(self.normals, self.offsets_mm, strict=True):
            np.multiply(x, nx, out=along)
            along += np.multiply(y, ny, out=across)
            np.minimum(rooms, offset - np.max(along, axis=0), out=rooms)
        return rooms
