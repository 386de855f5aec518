"""The complete picture: left image with markers, indentation map, and three-dimensional view."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gelstereo.states import MarkerState
from gelstereo.view.canvas import FAINT, HELD, INK, LOST, RULE, SALIENT, SEEN, Canvas, Colour, Image
from gelstereo.view.moment import Moment
from gelstereo.view.solid import draw_solid

#: Colour of a marker in each state.
STATE_COLOURS: dict[MarkerState, Colour] = {
    MarkerState.SEEN: SEEN,
    MarkerState.HELD: HELD,
    MarkerState.LOST: LOST,
}
_MARGIN, _GAP, _HEADER, _LINE = 28, 24, 92, 18
_LEFT_WIDTH, _RIGHT_WIDTH, _MAP_HEIGHT = 860, 460, 300
_ARROW: Colour = (255, 255, 255)
_PART: Colour = (90, 220, 90)


def draw(moment: Moment) -> Image:
    """Draw a moment.

    Parameters
    ----------
    moment : Moment

    Returns
    -------
    (H, W, 3) uint8
        Blue, green, red, as ``cv2.imwrite`` takes it.
    """
    height_px, width_px = moment.left.shape
    top = _HEADER + _LINE * max(0, len(moment.notes) - 2)
    image_height = round(_LEFT_WIDTH * height_px / width_px)
    body = max(image_height + 34, 2 * _MAP_HEIGHT)
    canvas = Canvas(2 * _MARGIN + _LEFT_WIDTH + _GAP + _RIGHT_WIDTH, top + body + _MARGIN)
    _draw_header(canvas, moment)
    _draw_image(canvas, moment, _MARGIN, top, image_height)
    _draw_legend(canvas, moment, _MARGIN, top + image_height + 22)
    right = _MARGIN + _LEFT_WIDTH + _GAP
    colours, top_mm = indentation_colours(moment.indentation_mm)
    solid_height = body - _MAP_HEIGHT - _GAP
    _draw_map(canvas, moment, colours, top_mm, right, top)
    solid_title = "sensor frame: x right in the image, y down, z away from the camera"
    canvas.text(solid_title, right, top + _MAP_HEIGHT + 12, 13.0, FAINT)
    solid = draw_solid(moment, colours, _RIGHT_WIDTH, solid_height).finished()
    canvas.image(solid, right, top + _MAP_HEIGHT + _GAP, _RIGHT_WIDTH, solid_height)
    return canvas.finished()


def indentation_colours(indentation_mm: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.uint8], float]:
    """Colours of heights, (N, 3), and the height of the brightest colour (at least 0.5 mm)."""
    import cv2

    top_mm = max(0.5, float(np.max(indentation_mm, initial=0.0)))
    levels = np.clip(np.round(255.0 * indentation_mm / top_mm), 0, 255).astype(np.uint8)
    colours: npt.NDArray[np.uint8] = cv2.applyColorMap(levels.reshape(-1, 1), cv2.COLORMAP_VIRIDIS)[:, 0]
    return colours, top_mm


def _draw_header(canvas: Canvas, moment: Moment) -> None:
    canvas.text(moment.title or "gelstereo", _MARGIN, 40, 22.0, INK, bold=True)
    for line, note in enumerate(moment.notes):
        canvas.text(note, _MARGIN, 62 + _LINE * line, 13.5, FAINT)


def _draw_image(canvas: Canvas, moment: Moment, x: int, y: int, height: int) -> None:
    canvas.image(moment.left, x, y, _LEFT_WIDTH, height)
    scale = _LEFT_WIDTH / moment.left.shape[1]
    # Pixel centres: (p + 0.5) scale - 0.5 in the picture.
    now = (moment.left_px + 0.5) * scale - 0.5 + [x, y]
    rest = (moment.reference_px + 0.5) * scale - 0.5 + [x, y]
    radius = 0.42 * scale * _pitch_px(moment)
    for centre, state, salient in zip(now, moment.state, moment.salient, strict=True):
        colour = SALIENT if salient else STATE_COLOURS[MarkerState(state)]
        canvas.circle(centre, radius, colour, 1.6 if salient else 1.0)
    for start, end in zip(rest, now, strict=True):
        canvas.arrow(start, end, _ARROW)
    if moment.part_edges_px is not None:
        edges = (moment.part_edges_px + 0.5) * scale - 0.5
        for start, end in edges[_within(edges, _LEFT_WIDTH, height)]:
            canvas.line(start + [x, y], end + [x, y], _PART, 2.0)


def _within(edges: npt.NDArray[np.float64], width: int, height: int) -> npt.NDArray[np.bool_]:
    """Mask of the edges (E, 2, 2) that lie inside the picture."""
    inside = (edges >= 0.0) & (edges < [width, height])
    return np.asarray(inside.all(axis=(1, 2)))


def _pitch_px(moment: Moment) -> float:
    grid = moment.reference_px.reshape(moment.rows, moment.cols, 2)
    return float(np.median(np.linalg.norm(np.diff(grid, axis=1), axis=2)))


def _draw_legend(canvas: Canvas, moment: Moment, x: int, y: int) -> None:
    counts = {state: int(np.sum(moment.state == state)) for state in MarkerState}
    items = [(f"{count} {state.name.lower()}", STATE_COLOURS[state]) for state, count in counts.items()]
    items.append((f"{int(np.sum(moment.salient))} salient", SALIENT))
    for text, colour in items:
        canvas.circle((x + 6, y - 5), 5.0, colour, 1.6)
        canvas.text(text, x + 17, y, 13.0)
        x += 34 + 8 * len(text)
    part = "" if moment.part_edges_px is None else "; green: the part"
    canvas.text(f"left image; white arrows: motion{part}", x + 8, y, 13.0, FAINT)


def _draw_map(
    canvas: Canvas, moment: Moment, colours: npt.NDArray[np.uint8], top_mm: float, x: int, y: int
) -> None:
    canvas.text("indentation towards the cameras, by row and column", x, y - 8, 13.0, FAINT)
    side = _MAP_HEIGHT - _GAP
    cell = min(side / moment.rows, (_RIGHT_WIDTH - 90) / moment.cols)
    width, height = round(cell * moment.cols), round(cell * moment.rows)
    cells = colours.reshape(moment.rows, moment.cols, 3)
    # Every marker is a separate cell, without interpolation.
    canvas.image(np.kron(cells, np.ones((16, 16, 1), dtype=np.uint8)), x, y, width, height)
    _draw_bar(canvas, top_mm, x + width + 18, y, height)


def _draw_bar(canvas: Canvas, top_mm: float, x: int, y: int, height: int) -> None:
    import cv2

    ramp = np.arange(255, -1, -1, dtype=np.uint8).reshape(-1, 1)
    canvas.image(cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS), x, y, 14, height)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        level = y + height * (1.0 - share)
        canvas.line((x + 14, level), (x + 19, level), RULE, 1.0)
        canvas.text(f"{share * top_mm:.2f}", x + 23, level + 4, 11.5)
    canvas.text("mm", x + 62, y + 4, 11.5, FAINT)
