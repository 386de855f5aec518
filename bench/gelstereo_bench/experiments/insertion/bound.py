"""Cramér-Rao bound of a part's pose from the heights of markers in contact, and the resulting uncertainty
over the hole.

A marker in contact measures the height of the surface. Let x be its position and n the smooth surface's
normal, in the part's frame. A motion (ω, v) of the part raises the surface there by (x × n)·ω + n·v. The
Fisher information is the sum of the outer products of (x × n, n), divided by the marker's variance along n.
Its inverse bounds the covariance of any unbiased registration of these heights (Cramér-Rao). Normals are
those of the smooth part, not of the mesh's facets.

The bound ignores edges, which are informative through the markers that they separate. On flat faces, edges
determine what heights do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo_bench.experiments.insertion.chance import SAMPLES, Prior, adjoint, chance
from gelstereo_bench.experiments.insertion.hole import Hole, InsertedEnd

if TYPE_CHECKING:
    import trimesh

__all__ = ["Bound", "SmoothSurface", "covariance_bound", "heights_information"]

Array = npt.NDArray[np.float64]

#: Faces that meet at a smaller angle are one smooth surface, rad; as in registration (32 degrees).
_CREASE_RAD = 0.55


class SmoothSurface:
    """The smooth surface that a part's mesh approximates."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        import trimesh

        self._mesh = trimesh.graph.smooth_shade(mesh, angle=_CREASE_RAD)

    def normals(self, points_mm: Array) -> Array:
        """Unit normals at the surface points nearest to points (N, 3), part frame."""
        import trimesh

        near, _, faces = self._mesh.nearest.on_surface(points_mm)
        shares = trimesh.triangles.points_to_barycentric(self._mesh.triangles[faces], near)
        normals = np.einsum("ni,nij->nj", shares, self._mesh.vertex_normals[self._mesh.faces[faces]])
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def heights_information(points_mm: Array, normals: Array, covariance_mm2: Array) -> Array:
    """Fisher information of markers' heights about a motion (ω, v) of the part, (6, 6).

    Parameters
    ----------
    points_mm, normals
        Markers in contact, and the surface's normals there, (N, 3) in the part's frame.
    covariance_mm2
        Covariance of each marker, (N, 3, 3), same frame.
    """
    rows = np.hstack([np.cross(points_mm, normals), normals])
    variance = np.einsum("ni,nij,nj->n", normals, covariance_mm2, normals)
    return np.asarray((rows / variance[:, None]).T @ rows)


def covariance_bound(
    surface: SmoothSurface, t_sensor_object: Array, points_mm: Array, covariance_mm2: Array, prior: Prior
) -> Array:
    """Minimum covariance of a motion (ω, v) of the part in its own frame, (6, 6), including the prior.

    `points_mm` (N, 3) and `covariance_mm2` (N, 3, 3) are those of the markers in contact, sensor frame.
    """
    turn = t_sensor_object[:3, :3]
    points = (points_mm - t_sensor_object[:3, 3]) @ turn
    information = heights_information(points, surface.normals(points), turn.T @ covariance_mm2 @ turn)
    to_centre: Array = np.eye(4)
    to_centre[:3, 3] = -points.mean(axis=0)
    carry = adjoint(to_centre)
    known = np.diag(np.repeat([prior.rotation_rad**-2.0, prior.shift_mm**-2.0], 3))
    return np.asarray(np.linalg.inv(information + carry.T @ known @ carry))


@dataclass(frozen=True)
class Bound:
    """Uncertainty of the part over its hole for an efficient estimator from heights: standard deviations."""

    #: Rotation about the part's axis.
    spin_rad: float
    #: Translation across the hole's axis at the middle of the hole, along the least certain direction.
    aside_mm: float
    #: Success rate of insertions with this uncertainty.
    chance: float

    @classmethod
    def of(cls, hole: Hole, end: InsertedEnd, covariance: Array, random: np.random.Generator) -> Bound:
        """Bound from a covariance of a motion (ω, v) in the hole's frame, (6, 6)."""
        about = np.eye(4)
        about[2, 3] = -0.5 * (hole.tip_mm + hole.mouth_mm)
        carry = adjoint(about)
        there = carry @ covariance @ carry.T
        motions = random.multivariate_normal(np.zeros(6), covariance, size=SAMPLES, method="cholesky")
        aside = np.linalg.eigvalsh(there[3:5, 3:5])[-1]
        return cls(float(np.sqrt(there[2, 2])), float(np.sqrt(aside)), chance(hole, end, motions))
