"""A place for the newest value: who writes never waits, who reads skips what came in between."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Latest(Generic[T]):
    """The newest of a sequence of values, and its number; each reader waits for one newer than it has."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._value: T | None = None
        self._number = 0
        self._closed = False

    def put(self, value: T) -> None:
        """Replace the value."""
        with self._changed:
            self._value = value
            self._number += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Tell readers that there will be no newer value."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def number(self) -> int:
        """How many values there have been."""
        return self._number

    @property
    def closed(self) -> bool:
        """Whether there will be no newer value."""
        return self._closed

    def newer_than(self, number: int, timeout_s: float) -> tuple[int, T] | None:
        """The newest value and its number, once that is larger than `number`; None after `timeout_s`, or if closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._number > number or self._closed, timeout_s)
            if self._number > number and self._value is not None:
                return self._number, self._value
            return None
