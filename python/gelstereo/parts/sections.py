"""Closed surfaces from stacks of rings.

Every part is one stack of cross-sections along its axis. Bands of triangles join neighbours, and both ends
are closed. The result is watertight by construction, without Boolean operations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gelstereo._native import MeshError
from gelstereo.extras import needs

if TYPE_CHECKING:
    import trimesh

__all__ = ["loft", "polar", "rectangle", "regular"]

Array = npt.NDArray[np.float64]


def loft(rings: Sequence[tuple[float, Array]]) -> trimesh.Trimesh:
    """Join rings into a closed surface.

    Parameters
    ----------
    rings
        Heights along z, mm, and outlines in the plane across it, (N, 2) mm, counter-clockwise seen from +z,
        all with the same N >= 3. The first and the last are closed by a fan about their mean, so they must be
        star-shaped about it. Heights need not increase: two rings at the same height make a step, and a stack
        that turns back makes a bore.

    Raises
    ------
    MeshError
        If the rings do not fit together, or do not enclose a volume.
    """
    with needs(__name__):
        import trimesh

    outlines = [np.asarray(outline, np.float64) for _, outline in rings]
    if len(outlines) < 2 or any(o.ndim != 2 or o.shape != (len(outlines[0]), 2) for o in outlines):
        raise MeshError(
            f"the rings have the shapes {[o.shape for o in outlines]}; valid is two or more of one shape (N, "
            "2)"
        )
    count = len(outlines[0])
    if count < 3:
        raise MeshError(f"the rings have {count} points; an outline needs at least 3")
    vertices = [
        np.column_stack([outline, np.full(count, height)])
        for (height, _), outline in zip(rings, outlines, strict=True)
    ]
    ends = [vertices[0].mean(axis=0), vertices[-1].mean(axis=0)]
    here = np.arange(count)
    after = np.roll(here, -1)
    triangles = []
    for below in range(0, (len(rings) - 1) * count, count):
        above = below + count
        triangles += [np.column_stack([below + here, below + after, above + after])]
        triangles += [np.column_stack([below + here, above + after, above + here])]
    last, tip = (len(rings) - 1) * count, len(rings) * count
    triangles += [np.column_stack([after, here, np.full(count, tip)])]
    triangles += [np.column_stack([last + here, last + after, np.full(count, tip + 1)])]
    mesh = trimesh.Trimesh(np.vstack([*vertices, ends]), np.vstack(triangles), process=False)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    if not mesh.is_watertight or mesh.volume <= 0.0:
        raise MeshError(
            f"the rings enclose {mesh.volume:.3g} mm3; valid is a closed surface of counter-clockwise "
            "outlines"
        )
    return mesh


def polar(radius_mm: float | Callable[[Array], Array], points: int) -> Array:
    """Outline by its radius, a number or a function of the angle in radians. The first point lies on +x."""
    angle = 2.0 * np.pi * np.arange(points) / points
    radius = radius_mm(angle) if callable(radius_mm) else np.full(points, float(radius_mm))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def regular(corners: int, across_flats_mm: float, points: int) -> Array:
    """Outline of a regular polygon with a corner on +x; `points` is a multiple of `corners`."""
    if points % corners:
        raise MeshError(
            f"{points} points cannot be divided among {corners} corners; valid is a multiple of {corners}"
        )
    half_mm = 0.5 * across_flats_mm

    def radius(angle: Array) -> Array:
        return half_mm / np.cos((angle % (2.0 * np.pi / corners)) - np.pi / corners)

    return polar(radius, points)


def rectangle(width_mm: float, height_mm: float, points: int = 4, corner_mm: float = 0.0) -> Array:
    """Outline of a rectangle along x and y, its corners rounded by `corner_mm`; `points` is a multiple of 4.

    With rounded corners the points lie on the four arcs, with sharp corners along the sides.
    """
    if points % 4 or points < 4:
        raise MeshError(f"{points} points cannot be divided among 4 corners; valid is a multiple of 4")
    each = points // 4
    half = 0.5 * np.array([width_mm, height_mm])
    signs = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]])
    if corner_mm == 0.0:
        corners = signs * half
        along = np.arange(each)[:, None] / each
        sides = [
            corner + along * (following - corner)
            for corner, following in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        ]
        return np.vstack(sides)
    quarter = np.linspace(0.0, 0.5 * np.pi, each)
    arcs = [
        sign * (half - corner_mm)
        + corner_mm * np.column_stack([np.cos(start + quarter), np.sin(start + quarter)])
        for sign, start in zip(signs, 0.5 * np.pi * np.arange(-1, 3), strict=True)
    ]
    return np.vstack(arcs)
