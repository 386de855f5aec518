"""The live moment in Rerun: images, clouds, the part and the figures over time.

Rerun's viewer is started by its own command, since its SDK would have it listen on every network interface.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rerun

from gelstereo import Error, MarkerState
from gelstereo.live.latest import Latest
from gelstereo.live.sensing import ExpectedPart, LiveResult
from gelstereo.live.shown import Shown
from gelstereo.view.canvas import SALIENT
from gelstereo.view.picture import STATE_COLOURS, indentation_colours

_HOST, _PORT = "127.0.0.1", 9876
#: Moments a second that are logged. A recording keeps every frame; a viewer need not.
_MAX_RATE_HZ = 15.0
_MAX_PART_POINTS = 1500
_NS_PER_S = 1e9
#: Time for the viewer to start.
_START_S = 30.0


class RerunViewer:
    """Logs the newest moment to Rerun's viewer, or to a file for it; a context manager.

    Parameters
    ----------
    file
        An .rrd file to write. Without one Rerun's viewer is started, which needs a display.
    part
        The part whose pose is shown.
    """

    def __init__(self, file: Path | None = None, part: ExpectedPart | None = None) -> None:
        self._file = file
        self._part = part
        self._viewer: subprocess.Popen[bytes] | None = None
        self._stream: Any = rerun.RecordingStream("gelstereo_live")
        self._events = 0

    def __enter__(self) -> RerunViewer:
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(str(self._file))
        else:
            self._start_viewer()
        self._stream.log("sensor", rerun.ViewCoordinates.RDF, static=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The viewer stays open: whoever looks at it closes it. One that is gone takes nothing more.
        if self._viewer is None or self._viewer.poll() is None:
            self._stream.flush()
            self._stream.disconnect()

    def _start_viewer(self) -> None:
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise Error(
                "there is no display for Rerun's viewer; name a file for it by --rrd, or use --show web"
            )
        command = [sys.executable, "-m", "rerun", "--bind", _HOST, "--port", str(_PORT), "--expect-data-soon"]
        self._viewer = subprocess.Popen(command, start_new_session=True)
        deadline_s = time.monotonic() + _START_S
        while not _listens():
            self._has_ended()
            if time.monotonic() > deadline_s:
                raise Error(f"Rerun's viewer does not listen on port {_PORT} after {_START_S:g} s")
            time.sleep(0.1)
        self._stream.connect_grpc(f"rerun+http://{_HOST}:{_PORT}/proxy")

    def _has_ended(self) -> bool:
        """Whether somebody closed the viewer; one that failed is an error."""
        code = None if self._viewer is None else self._viewer.poll()
        if code:
            raise Error(
                f"Rerun's viewer ended with code {code}; its messages say why. --rrd FILE needs no viewer"
            )
        return code == 0

    def follow(self, newest: Latest[Shown]) -> None:
        """Log the newest moments until the run ends, or the viewer is closed."""
        number = 0
        while not newest.closed and not self._has_ended():
            started_s = time.monotonic()
            found = newest.newer_than(number, 0.5)
            if found is None:
                continue
            number, shown = found
            self.log(shown)
            time.sleep(max(0.0, started_s + 1.0 / _MAX_RATE_HZ - time.monotonic()))

    def log(self, shown: Shown) -> None:
        """Log one moment."""
        stream, result, reading = self._stream, shown.result, shown.reading
        stream.set_time("source", duration=result.frame.time_ns / _NS_PER_S)
        stream.set_time("sequence", sequence=result.frame.sequence)
        figures = {
            "rate_hz": reading.rate_hz,
            "latency_p50_ms": reading.p50_ms,
            "latency_p99_ms": reading.p99_ms,
            "dropped": reading.dropped,
            "stale": reading.stale,
        }
        for name, value in figures.items():
            stream.log(f"source/{name}", rerun.Scalars(float(value)))
        for event in reading.events:
            if event.number > self._events:
                stream.log("source/events", rerun.TextLog(event.text, level="WARN"))
                self._events = event.number
        if not result.frame.stale:
            stream.log("image/left", rerun.Image(result.frame.left))
        self._log_markers(result)
        self._log_part(result)

    def _log_markers(self, result: LiveResult) -> None:
        stream, sensed = self._stream, result.sensed
        if sensed is None or result.reference_px is None:
            return
        by_state = np.array([STATE_COLOURS[state][::-1] for state in MarkerState], dtype=np.uint8)
        colours = by_state[sensed.state]
        colours[sensed.salient] = SALIENT[::-1]
        # Rerun puts the image's corner at 0, not the centre of its first pixel.
        now, rest = sensed.left_px + 0.5, result.reference_px + 0.5
        stream.log("image/left/markers", rerun.Points2D(now, colors=colours, radii=3.0))
        moved = rerun.LineStrips2D(np.stack([rest, now], axis=1), colors=[255, 255, 255], radii=0.7)
        stream.log("image/left/motion", moved)
        heights, _ = indentation_colours(sensed.indentation_mm)
        gel = rerun.Points3D(sensed.points_mm, colors=heights[:, ::-1], radii=0.15)
        stream.log("sensor/gel", gel)
        stream.log("contact/motion_px", rerun.Scalars(float(sensed.motion_px)))
        deepest_mm = float(np.max(sensed.indentation_mm, initial=0.0))
        stream.log("contact/max_indentation_mm", rerun.Scalars(deepest_mm))

    def _log_part(self, result: LiveResult) -> None:
        if self._part is None or result.frame.stale:
            return
        if result.located is None:
            self._stream.log("sensor/part", rerun.Clear(recursive=False))
            return
        pose = result.located.t_sensor_object
        points_mm = self._part.thinned_mm(_MAX_PART_POINTS) @ pose[:3, :3].T + pose[:3, 3]
        self._stream.log("sensor/part", rerun.Points3D(points_mm, colors=[120, 235, 120], radii=0.1))


def _listens() -> bool:
    with contextlib.suppress(OSError), socket.create_connection((_HOST, _PORT), timeout=1.0):
        return True
    return False
