"""The three-dimensional view: the gel's surface, the salient points and the located part."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gelstereo.view.canvas import INK, PAPER, SALIENT, Canvas, Colour
from gelstereo.view.moment import Moment, Part

Floats = npt.NDArray[np.float64]

#: View direction: azimuth about the sensor's z axis and elevation above its image plane.
_AZIMUTH_RAD, _ELEVATION_RAD = np.radians(-62.0), np.radians(28.0)
_PART_COLOUR = np.array([206.0, 178.0, 148.0])
_PART_OPACITY = 0.62


class Projection:
    """Orthographic, with the sensor's z axis upwards, fitted to points."""

    def __init__(self, points_mm: Floats, width: int, height: int, margin: float = 0.06) -> None:
        turn, lift = _AZIMUTH_RAD, _ELEVATION_RAD
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        towards = np.array([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)])
        self.axes = np.stack([right, -np.cross(towards, right), towards])
        flat = points_mm @ self.axes[:2].T
        low, high = flat.min(axis=0), flat.max(axis=0)
        extent = np.maximum(high - low, 1e-6)
        self.scale = float(min(width / extent[0], height / extent[1]) * (1.0 - 2.0 * margin))
        self.offset = np.array([width, height]) / 2.0 - self.scale * (low + high) / 2.0

    def __call__(self, points_mm: Floats) -> Floats:
        """Picture coordinates, (..., 2)."""
        out: Floats = points_mm @ self.axes[:2].T * self.scale + self.offset
        return out

    def nearness(self, points_mm: Floats) -> Floats:
        """Depth order: larger values are nearer to the viewer."""
        out: Floats = points_mm @ self.axes[2]
        return out


def draw_solid(moment: Moment, colours: npt.NDArray[np.uint8], width: int, height: int) -> Canvas:
    """Draw the gel's surface in its markers' colours, (N, 3), with the part and the salient points on it."""
    shown = moment.points_mm if moment.part is None else _within_reach(moment.points_mm, moment.part)
    project = Projection(shown, width, height)
    canvas = Canvas(width, height)
    _draw_gel(canvas, project, moment, colours)
    if moment.part is not None:
        layer = Canvas(width, height)
        draw_part(layer, project, moment.part)
        canvas.blend(layer, _PART_OPACITY, PAPER)
    points = moment.points_mm[moment.salient]
    for index in np.argsort(project.nearness(points), kind="stable"):
        canvas.circle(project(points[index]), 2.6, SALIENT)
    draw_axes(canvas, height)
    return canvas


def _within_reach(points_mm: Floats, part: Part) -> Floats:
    """The gel, and as much of the part as fits while the gel stays large enough to see."""
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    reach = 0.35 * float((high - low).max())
    return np.vstack([points_mm, np.clip(part.vertices_mm, low - reach, high + reach)])


def _draw_gel(canvas: Canvas, project: Projection, moment: Moment, colours: npt.NDArray[np.uint8]) -> None:
    grid = moment.points_mm.reshape(moment.rows, moment.cols, 3)
    shades = colours.reshape(moment.rows, moment.cols, 3).astype(np.float64)
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, 3)
    shade = (shades[:-1, :-1] + shades[:-1, 1:] + shades[1:, 1:] + shades[1:, :-1]).reshape(-1, 3) / 4.0
    flat = project(corners)
    for index in np.argsort(project.nearness(corners.mean(axis=1)), kind="stable"):
        canvas.polygon(flat[index], _colour(shade[index]))
        for start, end in zip(flat[index], np.roll(flat[index], -1, axis=0), strict=True):
            canvas.line(start, end, _colour(0.85 * shade[index]), 0.5)


def draw_part(canvas: Canvas, project: Projection, part: Part) -> None:
    """Draw the faces towards the viewer, the farthest first, lit from above."""
    corners = part.vertices_mm[part.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    facing, shade = project.nearness(normals), _lit(normals)
    flat = project(corners)
    front = np.flatnonzero(facing > 0.0)
    for index in front[np.argsort(project.nearness(corners[front].mean(axis=1)), kind="stable")]:
        canvas.polygon(flat[index], _colour(_PART_COLOUR * shade[index]))


def draw_surfels(
    canvas: Canvas, project: Projection, points_mm: Floats, normals: Floats, spacing_mm: float
) -> None:
    """Draw points that face the viewer as discs of the neighbours' distance, the farthest first, lit from
    above.
    """
    shade, flat = _lit(normals), project(points_mm)
    # Discs of this radius leave no gap between neighbours on a square grid.
    radius = project.scale * spacing_mm / np.sqrt(2.0)
    front = np.flatnonzero(project.nearness(normals) > 0.0)
    for index in front[np.argsort(project.nearness(points_mm[front]), kind="stable")]:
        canvas.circle(flat[index], radius, _colour(_PART_COLOUR * shade[index]))


def _lit(normals: Floats) -> Floats:
    """Brightness of the part's colour on faces with these unit normals, lit from above."""
    shade: Floats = 0.62 + 0.38 * np.clip(normals @ np.array([0.35, -0.45, 0.82]), 0.0, 1.0)
    return shade


def draw_axes(canvas: Canvas, height: int) -> None:
    """Draw the frame's axes in the lower left corner."""
    axes = Projection(np.eye(3), 1, 1).axes
    origin, length = np.array([34.0, height - 30.0]), 22.0
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = origin + length * (axes[:2] @ direction)
        canvas.arrow(origin, tip, INK)
        x, y = origin + 1.35 * (tip - origin)
        canvas.text(name, x - 3.0, y + 4.0, 12.0)


def _colour(shade: Floats) -> Colour:
    blue, green, red = (int(v) for v in np.clip(np.round(shade), 0, 255))
    return blue, green, red
