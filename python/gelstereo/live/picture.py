"""The live picture: left image with markers, motion, contact and pose, and the source's figures beside it.

Drawing takes a few milliseconds, without supersampling; `gelstereo.view` draws pictures for print.
"""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Localization, MarkerState, Rig
from gelstereo.extras import needs
from gelstereo.live.meter import Reading
from gelstereo.live.sensing import ExpectedPart, LiveResult, contact_of, markers_of
from gelstereo.view.canvas import FAINT, INK, PAPER, SALIENT, Colour, Image
from gelstereo.view.moment import pose_in_words
from gelstereo.view.picture import STATE_COLOURS, indentation_colours

Floats = npt.NDArray[np.float64]

_IMAGE_WIDTH, _SIDE_WIDTH, _MARGIN, _HEADER, _FOOTER = 760, 330, 16, 56, 30
_LINE, _TEXT_WIDTH = 19, 44  # pixels, and characters of the side column
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates
_ARROW: Colour = (255, 255, 255)
_PART: Colour = (120, 235, 120)
_ALARM: Colour = (40, 40, 205)
#: Colours (BGR) of the part's axes: x, y, z in red, green and blue, as usual in robotics.
_AXES: tuple[Colour, ...] = ((60, 60, 230), (70, 180, 70), (230, 120, 60))
_AXIS_MM = 4.0
_MAX_PART_POINTS = 1500


class LivePicture:
    """Draws live results of one sensor."""

    def __init__(self, rig: Rig, part: ExpectedPart | None = None, title: str = "gelstereo live") -> None:
        with needs(__name__):
            import cv2

        self._cv2: Any = cv2
        self._rig = rig
        self._title = title
        self._part_mm = np.zeros((0, 3)) if part is None else part.thinned_mm(_MAX_PART_POINTS)
        self._turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)

    def draw(self, result: LiveResult, reading: Reading, recording: str | None = None) -> Image:
        """Draw a result.

        Parameters
        ----------
        result : LiveResult
        reading : Reading
            Figures of the source at that time.
        recording : str, optional
            Status of a running recording, for example its size.

        Returns
        -------
        (H, W, 3) uint8
            Blue, green, red.
        """
        left = result.frame.left
        scale = _IMAGE_WIDTH / left.shape[1]
        image_height = round(left.shape[0] * scale)
        width = 3 * _MARGIN + _IMAGE_WIDTH + _SIDE_WIDTH
        canvas: Image = np.full((_HEADER + image_height + _FOOTER, width, 3), PAPER, dtype=np.uint8)
        size = (_IMAGE_WIDTH, image_height)
        view = self._cv2.cvtColor(self._cv2.resize(left, size), self._cv2.COLOR_GRAY2BGR)
        self._markers(view, result, scale)
        if result.located is not None and result.sensed is not None:
            self._pose(view, result.located, result.sensed.patch_points_mm, scale)
        if result.frame.stale:
            self._border(view)
        canvas[_HEADER : _HEADER + image_height, _MARGIN : _MARGIN + _IMAGE_WIDTH] = view
        self._header(canvas, result, reading, recording)
        self._side(canvas, result, reading, 2 * _MARGIN + _IMAGE_WIDTH)
        self._legend(canvas, result, _HEADER + image_height + 20)
        return canvas

    def _header(self, canvas: Image, result: LiveResult, reading: Reading, recording: str | None) -> None:
        self._text(canvas, self._title, _MARGIN, 24, 0.62, INK, 2)
        figures = f"{reading.rate_hz:.1f} Hz   latency {reading.p50_ms:.1f} ms (p99 {reading.p99_ms:.1f})"
        counts = f"dropped {reading.dropped}   stale {reading.stale}   failed {reading.failed}"
        self._text(canvas, f"{figures}   {counts}", _MARGIN, 46, 0.45, FAINT)
        right = 2 * _MARGIN + _IMAGE_WIDTH
        state = "STALE: no new frame" if result.frame.stale else f"frame {result.frame.sequence}"
        self._text(canvas, state, right, 24, 0.5, _ALARM if result.frame.stale else INK)
        if recording is not None:
            self._cv2.circle(canvas, (right + 5, 41), 5, _ALARM, -1, self._cv2.LINE_AA)
            self._text(canvas, recording, right + 16, 46, 0.45, INK)

    def _markers(self, view: Image, result: LiveResult, scale: float) -> None:
        sensed, reference_px = result.sensed, result.reference_px
        if sensed is None or reference_px is None:
            return
        # Pixel centres: (p + 0.5) scale - 0.5 in the picture.
        now, rest = ((px + 0.5) * scale - 0.5 for px in (sensed.left_px, reference_px))
        grid = reference_px.reshape(sensed.rows, sensed.cols, 2)
        pitch_px = float(np.median(np.linalg.norm(np.diff(grid, axis=1), axis=2)))
        ring = 0.42 * scale * pitch_px * np.stack([np.cos(self._turn), np.sin(self._turn)], axis=1)
        rings = now[:, None, :] + ring
        for state, colour in STATE_COLOURS.items():
            self._lines(view, rings[(sensed.state == state) & ~sensed.salient], colour, closed=True)
        self._lines(view, rings[sensed.salient], SALIENT, closed=True, width=2)
        self._arrows(view, rest, now)

    def _arrows(self, view: Image, start: Floats, end: Floats) -> None:
        along = end - start
        length = np.hypot(along[:, 0], along[:, 1])
        # Shorter arrows have no visible direction.
        long = length > 1.5
        start, end, along = start[long], end[long], along[long] / length[long, None]
        self._lines(view, np.stack([start, end], axis=1), _ARROW)
        back = end - np.minimum(6.0, 0.6 * length[long])[:, None] * along
        side = np.stack([-along[:, 1], along[:, 0]], axis=1) * 2.5
        self._lines(view, np.stack([back + side, end, back - side], axis=1), _ARROW)

    def _pose(self, view: Image, located: Localization, patch_mm: Floats, scale: float) -> None:
        pose = located.t_sensor_object
        points_px = self._rig.project(self._part_mm @ pose[:3, :3].T + pose[:3, 3])[0]
        points_px = (points_px[np.isfinite(points_px).all(axis=1)] + 0.5) * scale - 0.5
        if len(points_px):
            outline = self._cv2.convexHull(points_px.astype(np.float32)).reshape(1, -1, 2)
            self._lines(view, outline.astype(np.float64), _PART, closed=True, width=2)
        centre = patch_mm.mean(axis=0)
        tips = self._rig.project(np.vstack([centre, centre + _AXIS_MM * pose[:3, :3].T]))[0]
        tips = (tips + 0.5) * scale - 0.5
        for tip, colour in zip(tips[1:], _AXES, strict=True):
            self._lines(view, np.stack([tips[0], tip])[None], colour, width=2)

    def _side(self, canvas: Image, result: LiveResult, reading: Reading, x: int) -> None:
        y = _HEADER
        sensed = result.sensed
        if sensed is not None:
            colours, top_mm = indentation_colours(sensed.indentation_mm)
            cell = min(_SIDE_WIDTH / sensed.cols, 250.0 / sensed.rows)
            size = (round(cell * sensed.cols), round(cell * sensed.rows))
            cells = colours.reshape(sensed.rows, sensed.cols, 3)
            # Every marker is a separate cell, without interpolation.
            canvas[y : y + size[1], x : x + size[0]] = self._cv2.resize(
                cells, size, interpolation=self._cv2.INTER_NEAREST
            )
            self._text(canvas, f"indentation; yellow is {top_mm:.2f} mm", x, y + size[1] + 16, 0.42, FAINT)
            y += size[1] + 16
        y += _LINE + 6
        for text, colour in self._words(result, reading):
            for line in textwrap.wrap(text, _TEXT_WIDTH):
                if y < canvas.shape[0] - 6:
                    self._text(canvas, line, x, y, 0.42, colour)
                y += _LINE

    def _words(self, result: LiveResult, reading: Reading) -> list[tuple[str, Colour]]:
        words: list[tuple[str, Colour]] = []
        if result.sensed is not None:
            contact = contact_of(result.sensed)
            words.append((f"mean marker motion {contact['motion_px']:.2f} px", INK))
            touch = f"contact: {contact['salient']} markers, {contact['max_indentation_mm']:.2f} mm deep"
            words.append((touch if contact["salient"] else "no contact", INK))
        if result.located is not None:
            words.append((pose_in_words(result.located.t_sensor_object), INK))
            free = "; ".join(map(str, result.located.free)) or "nothing"
            words.append((f"{result.located.tracking or 'found'}; free, object frame: {free}", FAINT))
        if result.problem is not None and result.problem != result.frame.event:
            words.append((result.problem, _ALARM))
        words += [(f"{event.after_s:.1f} s: {event.text}", _ALARM) for event in reading.events[-3:]]
        return words

    def _legend(self, canvas: Image, result: LiveResult, y: int) -> None:
        if result.sensed is None:
            return
        x = _MARGIN
        counts = markers_of(result.sensed)
        items = [
            (f"{counts[state.name.lower()]} {state.name.lower()}", STATE_COLOURS[state])
            for state in MarkerState
        ]
        items.append((f"{contact_of(result.sensed)['salient']} salient", SALIENT))
        if result.located is not None:
            items.append(("part's outline; its axes x, y, z are red, green, blue", _PART))
        for text, colour in items:
            self._cv2.circle(canvas, (x + 6, y - 5), 5, colour, 2, self._cv2.LINE_AA)
            self._text(canvas, text, x + 17, y, 0.42, INK)
            x += 34 + 8 * len(text)
        self._text(canvas, "white arrows: motion since rest", x + 8, y, 0.42, FAINT)

    def _border(self, view: Image) -> None:
        end = (view.shape[1] - 2, view.shape[0] - 2)
        self._cv2.rectangle(view, (1, 1), end, _ALARM, 3)

    def _lines(
        self, view: Image, corners: Floats, colour: Colour, *, closed: bool = False, width: int = 1
    ) -> None:
        """Draw many polylines at once, (N, K, 2); those far outside or with NaN are left out."""
        good = np.isfinite(corners).all(axis=(1, 2)) & (np.abs(corners) < 1e4).all(axis=(1, 2))
        fixed = np.round(corners[good] * (1 << _SHIFT)).astype(np.int32)
        self._cv2.polylines(view, list(fixed), closed, colour, width, self._cv2.LINE_AA, _SHIFT)

    def _text(
        self, canvas: Image, text: str, x: int, y: int, size: float, colour: Colour, width: int = 1
    ) -> None:
        # OpenCV's fonts have ASCII alone.
        plain = text.encode("ascii", "replace").decode()
        font = self._cv2.FONT_HERSHEY_SIMPLEX
        self._cv2.putText(canvas, plain, (x, y), font, size, colour, width, self._cv2.LINE_AA)
