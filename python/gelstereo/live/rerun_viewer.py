"""Live view in Rerun: images, clouds, the part and the figures over time."""

from __future__ import annotations

import time
from pathlib import Path
from types import TracebackType

from gelstereo.extras import needs
from gelstereo.live.latest import Latest
from gelstereo.live.sensing import ExpectedPart, LiveResult
from gelstereo.live.shown import Shown
from gelstereo.view.rerun_stream import RerunStream

with needs(__name__):
    import rerun

#: Moments logged per second. A recording keeps every frame; a viewer does not need to.
_MAX_RATE_HZ = 15.0
_MAX_PART_POINTS = 1500
_NS_PER_S = 1e9


class RerunViewer:
    """Logs the newest moment to Rerun's viewer, or to a file for it; a context manager.

    Parameters
    ----------
    file
        An .rrd file to write. Without a file, Rerun's viewer is started, which needs a display.
    part
        The part whose pose is shown.
    """

    def __init__(self, file: Path | None = None, part: ExpectedPart | None = None) -> None:
        self._part = part
        self._sink = RerunStream("gelstereo_live", file, "name a file for it by --rrd, or use --show web")
        self._events = 0

    def __enter__(self) -> RerunViewer:
        self._sink.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._sink.__exit__(kind, error, trace)

    def follow(self, newest: Latest[Shown]) -> None:
        """Log the newest moments until the run ends or the viewer is closed."""
        number = 0
        while not newest.closed and not self._sink.has_ended():
            started_s = time.monotonic()
            found = newest.newer_than(number, 0.5)
            if found is None:
                continue
            number, shown = found
            self.log(shown)
            time.sleep(max(0.0, started_s + 1.0 / _MAX_RATE_HZ - time.monotonic()))

    def log(self, shown: Shown) -> None:
        """Log one moment."""
        stream, result, reading = self._sink.stream, shown.result, shown.reading
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
        sensed = result.sensed
        if sensed is None or result.reference_px is None:
            return
        self._sink.log_markers(sensed.left_px, result.reference_px, sensed.state, sensed.salient)
        self._sink.log_gel(sensed.points_mm, sensed.indentation_mm)
        self._sink.stream.log("contact/motion_px", rerun.Scalars(float(sensed.motion_px)))

    def _log_part(self, result: LiveResult) -> None:
        if self._part is None or result.frame.stale:
            return
        if result.located is None:
            self._sink.stream.log("sensor/part", rerun.Clear(recursive=False))
            return
        pose = result.located.t_sensor_object
        points_mm = self._part.thinned_mm(_MAX_PART_POINTS) @ pose[:3, :3].T + pose[:3, 3]
        self._sink.stream.log("sensor/part", rerun.Points3D(points_mm, colors=[120, 235, 120], radii=0.1))
