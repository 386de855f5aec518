"""Visible edges of a part, for a camera at the origin of the sensor frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gelstereo.view.moment import Part

Floats = npt.NDArray[np.float64]

#: Minimum angle between faces for a feature edge. Facets of a cylinder meet at smaller angles.
_CREASE_COS = float(np.cos(np.radians(30.0)))
#: Edges are split into segments of this length, so that lens distortion can bend them and the image border
#: can cut them.
_PIECE_MM = 0.5
#: Minimum distance from the camera's centre; nearer points are inside the sensor.
_NEAR_MM = 1.0


def feature_edges_mm(part: Part) -> Floats:
    """Segments of outline and creases, (E, 2, 3), sensor frame; those between faces that face away are left
    out.

    Faces do not occlude each other: the picture shows where a part is, not its appearance.
    """
    corners = part.vertices_mm[part.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    towards_camera = np.einsum("fi,fi->f", normals, corners[:, 0]) < 0.0
    edges, faces = _edges_with_faces(part.vertices_mm, part.triangles)
    first, second = faces[:, 0], faces[:, 1]
    alone = second < 0
    outline = alone | (towards_camera[first] != towards_camera[second])
    crease = np.einsum("ei,ei->e", normals[first], normals[second]) < _CREASE_COS
    visible = towards_camera[first] | (~alone & towards_camera[second])
    return _pieces(part.vertices_mm[edges[(outline | crease) & visible]])


def _edges_with_faces(
    vertices_mm: Floats, triangles: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Vertices of each edge, and its one or two faces (-1 for none). Coincident vertices are merged."""
    _, first, same = np.unique(np.round(vertices_mm, 6), axis=0, return_index=True, return_inverse=True)
    welded = first[same.reshape(-1)][triangles]
    edges = np.sort(welded[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(len(triangles)), 3)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    faces = np.full((len(unique), 2), -1, dtype=np.int64)
    # If more than two faces share an edge, the first and the last are kept.
    number = number.reshape(-1)
    faces[number[::-1], 0] = face[::-1]
    last = np.full(len(unique), -1, dtype=np.int64)
    last[number] = face
    faces[:, 1] = np.where(last != faces[:, 0], last, -1)
    return unique, faces


def _pieces(edges_mm: Floats) -> Floats:
    pieces = []
    for start, end in edges_mm:
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _PIECE_MM)))
        along = np.linspace(start, end, count + 1)
        pieces.append(np.stack([along[:-1], along[1:]], axis=1))
    if not pieces:
        return np.zeros((0, 2, 3))
    joined = np.concatenate(pieces)
    near: Floats = joined[(joined[:, :, 2] > _NEAR_MM).all(axis=1)]
    return near
