"""A slot for the newest value: the writer never waits, and readers skip intermediate values."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Latest(Generic[T]):
    """The newest of a sequence of values, and its number. Each reader waits for a value newer than its last
    one.
    """

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
        """Signal to readers that no newer value will follow."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def number(self) -> int:
        """Number of values so far."""
        return self._number

    @property
    def closed(self) -> bool:
        """Whether no newer value will follow."""
        return self._closed

    def newer_than(self, number: int, timeout_s: float) -> tuple[int, T] | None:
        """Wait for a value with a number above `number`; return both, or None after `timeout_s`
        or if closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._number > number or self._closed, timeout_s)
            if self._number > number and self._value is not None:
                return self._number, self._value
            return None
