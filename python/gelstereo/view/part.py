"""A picture of a part: its faces, its axes, and notes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from gelstereo._native import Symmetry
from gelstereo.view.canvas import FAINT, SALIENT, Canvas, Image
from gelstereo.view.moment import Part
from gelstereo.view.solid import Projection, draw_axes, draw_part, draw_surfels

_WIDTH, _HEIGHT, _HEADER, _MARGIN = 640, 560, 76, 28
_LINE = 20


def draw_template(
    vertices_mm: npt.NDArray[np.float64],
    triangles: npt.NDArray[np.int64],
    title: str,
    notes: Sequence[str],
    symmetries: Sequence[Symmetry] = (),
) -> Image:
    """Draw a mesh part in its own frame.

    Parameters
    ----------
    vertices_mm : (V, 3) float64
        Object frame.
    triangles : (F, 3) int64
        Counter-clockwise seen from outside.
    title, notes
        A heading, and lines under it.
    symmetries
        Symmetries whose axes are drawn through the part.

    Returns
    -------
    (H, W, 3) uint8
        Blue, green, red, as ``cv2.imwrite`` takes it.
    """
    part = Part(vertices_mm, triangles)
    return _picture(
        vertices_mm, lambda view, project: draw_part(view, project, part), title, notes, symmetries
    )


def draw_scan(
    points_mm: npt.NDArray[np.float64],
    normals: npt.NDArray[np.float64],
    spacing_mm: float,
    title: str,
    notes: Sequence[str],
) -> Image:
    """Draw a part given by points; each is drawn as wide as the distance of its neighbours.

    Parameters
    ----------
    points_mm, normals : (N, 3) float64
        Object frame; outward.
    spacing_mm
        Distance between neighbours.
    title, notes
        As in `draw_template`.

    Returns
    -------
    (H, W, 3) uint8
        Blue, green, red, as ``cv2.imwrite`` takes it.
    """
    return _picture(
        points_mm,
        lambda view, project: draw_surfels(view, project, points_mm, normals, spacing_mm),
        title,
        notes,
        (),
    )


def _picture(
    vertices_mm: npt.NDArray[np.float64],
    draw: Callable[[Canvas, Projection], None],
    title: str,
    notes: Sequence[str],
    symmetries: Sequence[Symmetry],
) -> Image:
    top = _HEADER + _LINE * max(0, len(notes) - 1)
    canvas = Canvas(_WIDTH, top + _HEIGHT)
    canvas.text(title, _MARGIN, 40, 20.0, bold=True)
    for line, note in enumerate(notes):
        canvas.text(note, _MARGIN, 64 + _LINE * line, 13.0, FAINT)
    view = Canvas(_WIDTH, _HEIGHT)
    project = Projection(vertices_mm, _WIDTH, _HEIGHT, margin=0.14)
    draw(view, project)
    for symmetry in symmetries:
        # The part's extent along the axis, and a margin at both ends.
        along = (vertices_mm - symmetry.centre_mm) @ symmetry.axis
        more = 0.08 * float(np.ptp(along))
        ends = [symmetry.centre_mm + symmetry.axis * end for end in (along.min() - more, along.max() + more)]
        view.line(project(ends[0]), project(ends[1]), SALIENT, 1.2 if symmetry.order is None else 0.6)
    draw_axes(view, _HEIGHT)
    canvas.image(view.finished(), 0, top, _WIDTH, _HEIGHT)
    return canvas.finished()
