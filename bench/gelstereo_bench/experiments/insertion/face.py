"""The smooth face under most markers of a contact, and the information from their heights.

A row of markers beside an edge can be explained by the next face too, with a suitable shift and rotation of
the part: two parameters fit a straight row. The apparent information of such a row does not determine how the
part slides on its face.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo import Template
from gelstereo.extras import needs
from gelstereo_bench.experiments.insertion.bound import heights_information

with needs(__name__):
    from scipy.spatial import cKDTree

if TYPE_CHECKING:
    import trimesh

__all__ = ["Faces", "is_ridged"]

Array = npt.NDArray[np.float64]

#: Faces that meet at a smaller angle are one, rad; as in registration (32 degrees).
_CREASE_RAD = 0.55
#: Faces that meet at a larger angle count as perpendicular, rad (80 degrees).
_UPRIGHT_RAD = 1.4
#: Minimum cosine between axis and edge for an edge along the axis.
_ALONG = 0.99
#: Maximum distance of markers on the part, mm: four standard deviations of a height.
_TOUCH_MM = 0.025


def is_ridged(mesh: trimesh.Trimesh) -> bool:
    """Whether two faces that can touch the gel meet at an edge along the part's axis, z, longer than the
    part's width.

    A face perpendicular to the one on the gel is never touched.
    """
    angles = mesh.face_adjacency_angles
    ends = mesh.vertices[mesh.face_adjacency_edges[(angles > _CREASE_RAD) & (angles < _UPRIGHT_RAD)]]
    ways = np.abs(ends[:, 1] - ends[:, 0])
    is_along = ways[:, 2] > _ALONG * np.linalg.norm(ways, axis=1)
    return bool(np.any(is_along & (ways[:, 2] > np.max(mesh.extents[:2]))))


class Faces:
    """The faces of a part, from the points of its template."""

    def __init__(self, template: Template) -> None:
        self._points_mm, self._normals = np.asarray(template.points_mm), np.asarray(template.normals)
        self._tree = cKDTree(self._points_mm)

    def information(self, t_sensor_object: Array, points_mm: Array, covariance_mm2: Array) -> Array:
        """Information on a motion (ω, v) in the sensor frame, (6, 6), from the markers on the largest face in
        contact.

        `points_mm` (N, 3) and `covariance_mm2` (N, 3, 3) are those of the salient markers, sensor frame.
        """
        turn = t_sensor_object[:3, :3]
        points = (points_mm - t_sensor_object[:3, 3]) @ turn
        near = self._tree.query(points)[1]
        normals = self._normals[near]
        heights = np.einsum("ni,ni->n", points - self._points_mm[near], normals)
        touches = np.abs(heights) < _TOUCH_MM
        alike = (normals @ normals[touches].T > np.cos(_CREASE_RAD)).sum(axis=1)
        chosen = touches & (normals @ normals[np.argmax(alike)] > np.cos(_CREASE_RAD))
        return heights_information(points_mm[chosen], normals[chosen] @ turn.T, covariance_mm2[chosen])
