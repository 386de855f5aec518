"""How late a busy computer lets processes run, measured beside a task."""

from __future__ import annotations

import threading
import time
from types import TracebackType

SLEEP_S = 0.002


class Lateness:
    """A thread that sleeps and wakes; `longest_s` is the longest time by which it woke late."""

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _watch(self) -> None:
        while not self._over.is_set():
            slept = time.monotonic()
            time.sleep(SLEEP_S)
            self.longest_s = max(self.longest_s, time.monotonic() - slept - SLEEP_S)

    def __enter__(self) -> Lateness:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
