"""Rate, latency, drops and events of a live source."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gelstereo.live.sensing import LiveResult

#: Window for rate and latency, seconds before the last frame: long enough for a 99th percentile at 60 Hz,
#: short enough to show changes quickly.
_WINDOW_S = 2.0
_KEPT_EVENTS = 5


@dataclass(frozen=True)
class Event:
    """An event: its text, time in seconds after the start, and number from 1."""

    after_s: float
    text: str
    number: int


@dataclass(frozen=True)
class Reading:
    """Figures of a source so far.

    Attributes
    ----------
    frames, stale, dropped, failed : int
        Counts: new frames; calls without a new frame; lost frames; new frames that could not be sensed.
    rate_hz : float
        New frames per second.
    p50_ms, p99_ms : float
        Latency from the driver's timestamp (or arrival) to the result. 0 before the first frame.
    events : tuple of Event
        The most recent events, in order of time.
    """

    frames: int = 0
    stale: int = 0
    dropped: int = 0
    failed: int = 0
    rate_hz: float = 0.0
    p50_ms: float = 0.0
    p99_ms: float = 0.0
    events: tuple[Event, ...] = ()


@dataclass
class Meter:
    """Counts results; `clock` returns seconds."""

    clock: Callable[[], float] = time.monotonic
    _start_s: float | None = None
    _frames: int = 0
    _stale: int = 0
    _dropped: int = 0
    _failed: int = 0
    _recent: deque[tuple[float, float]] = field(default_factory=deque)
    _events: deque[Event] = field(default_factory=lambda: deque(maxlen=_KEPT_EVENTS))
    _event_count: int = 0

    def count(self, result: LiveResult) -> Reading:
        """Count a result; return the updated figures."""
        now_s = self.clock()
        self._start_s = now_s if self._start_s is None else self._start_s
        self._dropped += result.frame.dropped
        if result.frame.stale:
            self._stale += 1
        elif result.sensed is None:
            self._failed += 1
        if result.frame.event is not None:
            self._note(now_s, result.frame.event)
        elif result.sensed is None and result.problem is not None and not result.frame.stale:
            self._note(now_s, result.problem)
        if result.latency_ms is not None:
            self._frames += 1
            self._recent.append((now_s, result.latency_ms))
        while self._recent and self._recent[0][0] < now_s - _WINDOW_S:
            self._recent.popleft()
        return self._reading()

    def _note(self, now_s: float, text: str) -> None:
        after_s = now_s - (self._start_s or 0.0)
        # A repeated event only reports that the state persists.
        if not self._events or self._events[-1].text != text:
            self._event_count += 1
            self._events.append(Event(after_s, text, self._event_count))

    def _reading(self) -> Reading:
        latencies = [latency for _, latency in self._recent]
        p50, p99 = np.percentile(latencies, [50, 99]) if latencies else (0.0, 0.0)
        spread_s = self._recent[-1][0] - self._recent[0][0] if len(self._recent) > 1 else 0.0
        return Reading(
            frames=self._frames,
            stale=self._stale,
            dropped=self._dropped,
            failed=self._failed,
            rate_hz=(len(self._recent) - 1) / spread_s if spread_s > 0.0 else 0.0,
            p50_ms=float(p50),
            p99_ms=float(p99),
            events=tuple(self._events),
        )
