"""A small progress bar on standard error, drawn only on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import TracebackType
from typing import Protocol, TypeVar

T_co = TypeVar("T_co", covariant=True)


class Items(Protocol[T_co]):
    """An iterable with a length: a list, a range, a simulator."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> T_co: ...


_WIDTH = 32


def progress(items: Items[T_co], what: str) -> Iterator[T_co]:
    """Iterate over `items` with a progress bar; nothing is drawn if standard error is no terminal."""
    shown = sys.stderr.isatty()
    total = len(items)
    try:
        for done in range(total):
            if shown:
                _draw(done, total, what)
            yield items[done]
        if shown and total:
            _draw(total, total, what)
    finally:
        if shown and total:
            sys.stderr.write("\n")


class Counter:
    """Progress updated by the caller: a bar on a terminal, otherwise a line at every tenth."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._shown = sys.stderr.isatty()
        self._tenth = -1
        self.done = self.total = 0

    def __call__(self, done: int, total: int) -> None:
        """Update the number of finished items."""
        self.done, self.total = done, total
        if self._shown:
            _draw(done, max(total, 1), self._what)
        elif total and 10 * done // total > self._tenth:
            self._tenth = 10 * done // total
            print(f"{self._what} {done}/{total}", file=sys.stderr, flush=True)

    def __enter__(self) -> Counter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown and self.total:
            sys.stderr.write("\n")


def _draw(done: int, total: int, what: str) -> None:
    filled = _WIDTH * done // total
    sys.stderr.write(f"\r{what} [{'#' * filled}{'.' * (_WIDTH - filled)}] {done}/{total}")
    sys.stderr.flush()
