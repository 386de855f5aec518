"""A live run: one thread senses and records, and viewers show the newest moment."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from gelstereo.live.latest import Latest
from gelstereo.live.meter import Meter, Reading
from gelstereo.live.sensing import LiveResult, LiveSensor
from gelstereo.live.shown import Shown
from gelstereo.live.source import LiveSource

if TYPE_CHECKING:
    # It needs the extra `recording`.
    from gelstereo.live.record import LiveRecorder

_BYTES_PER_MB = 1e6


class LiveRun:
    """Senses every frame of a source in its own thread; a context manager.

    Attributes
    ----------
    newest : Latest of Shown
        The moment for viewers. It is closed when the run ends.
    recorder : LiveRecorder or None
        Must be set before the start. It receives every result, and is closed when the run ends.
    reading : Reading
        The figures so far.
    recording_error : str or None
        Reason why the recording ended before the run.
    """

    def __init__(
        self,
        source: LiveSource,
        sensor: LiveSensor,
        max_frames: int | None = None,
    ) -> None:
        self.newest: Latest[Shown] = Latest()
        self.recorder: LiveRecorder | None = None
        self.reading = Reading()
        self.recording_error: str | None = None
        self._source = source
        self._sensor = sensor
        self._max_frames = max_frames
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="sensing", daemon=True)

    def __enter__(self) -> LiveRun:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the end and return whether the run has ended. An error that ended it is raised
        here, once.
        """
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            return False
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure
        return True

    def stop(self) -> None:
        """End the run after the current frame, and close source and recording."""
        self._stop.set()
        self._source.close()
        self._thread.join()

    def _work(self) -> None:
        meter = Meter()
        try:
            for frame in self._source:
                if self._stop.is_set():
                    break
                result = self._sensor.process(frame)
                self.reading = meter.count(result)
                self._record(result)
                self.newest.put(Shown(result, self.reading, self._recording()))
                if self._max_frames is not None and self.reading.frames >= self._max_frames:
                    break
            if self.recorder is not None:
                self.recorder.close()
        except BaseException as error:  # raised in the waiting thread
            self._failure = error
            if self.recorder is not None:
                self.recorder.abandon()
        finally:
            self.newest.close()
            self._source.close()

    def _record(self, result: LiveResult) -> None:
        if self.recorder is None:
            return
        try:
            self.recorder.write(result)
        except OSError as error:
            # A full disk ends the recording but not the sensing.
            self.recording_error = f"the recording ended after frame {self.reading.frames}: {error}"
            self.recorder.abandon()
            self.recorder = None

    def _recording(self) -> str | None:
        if self.recorder is None:
            return self.recording_error
        size_mb = self.recorder.size_bytes / _BYTES_PER_MB
        return f"recording {self.recorder.path.name}, {size_mb:.1f} MB"
