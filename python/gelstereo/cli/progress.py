"""A progress bar of a few lines, on standard error and only for people."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Protocol, TypeVar

T_co = TypeVar("T_co", covariant=True)


class Items(Protocol[T_co]):
    """What has a length and can be counted through: a list, a range, a simulator."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> T_co: ...


_WIDTH = 32


def progress(items: Items[T_co], what: str) -> Iterator[T_co]:
    """Iterate over `items` behind a bar; nothing is drawn when standard error is no terminal."""
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


def _draw(done: int, total: int, what: str) -> None:
    filled = _WIDTH * done // total
    sys.stderr.write(f"\r{what} [{'#' * filled}{'.' * (_WIDTH - filled)}] {done}/{total}")
    sys.stderr.flush()
