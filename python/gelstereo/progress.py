"""Progress of long jobs on standard error: by tqdm where it is installed, otherwise by a small bar of its
own.

Without a terminal or a notebook there is no bar, but a line at every tenth of a job.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Protocol, TypeVar

__all__ = ["Progress", "progress"]

T_co = TypeVar("T_co", covariant=True)

_WIDTH = 32
_NAME_WIDTH = 40


class Items(Protocol[T_co]):
    """An iterable with a length: a list, a range, a simulator."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[T_co]: ...


def progress(items: Items[T_co], what: str) -> Iterator[T_co]:
    """Iterate over `items` and show how many are done; without a terminal or a notebook nothing is shown."""
    total = len(items)
    if not (total and _shows_bars()):
        yield from items
        return
    with Progress(what) as shown:
        for done, item in enumerate(items):
            shown(done, total)
            yield item
        shown(total, total)


class Progress:
    """Shows how much of a job is done; a context manager, called with the items done and their total.

    Parameters
    ----------
    what
        The job, as a short phrase.

    Attributes
    ----------
    done, total : int
        As given last.

    Examples
    --------
    >>> with Progress("adding") as shown:
    ...     for done in range(4):
    ...         shown(done, 4)
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._bars = _shows_bars()
        self._tqdm: Any = _tqdm(what) if self._bars else None
        self._tenth = -1
        self.done = self.total = 0
        self._is_drawn = False

    def __call__(self, done: int, total: int, name: str = "") -> None:
        """Show that `done` of `total` items are done; `name` is the present one."""
        self.done, self.total = done, total
        if self._tqdm is not None:
            self._tqdm.total, self._tqdm.n = total, done
            self._tqdm.set_postfix_str(name, refresh=False)
            self._tqdm.refresh()
        elif self._bars:
            self._draw(done, max(total, 1), name)
        elif total and 10 * done // total != self._tenth:
            self._tenth = 10 * done // total
            print(f"{self._what} {done}/{total} {name}".rstrip(), file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._tqdm is not None:
            self._tqdm.close()
        elif self._is_drawn:
            sys.stderr.write("\n")

    def _draw(self, done: int, total: int, name: str) -> None:
        filled = _WIDTH * done // total
        bar = f"\r{self._what} [{'#' * filled}{'.' * (_WIDTH - filled)}] {done}/{total}"
        # Spaces cover a longer name before.
        sys.stderr.write(f"{bar} {name[:_NAME_WIDTH]:<{_NAME_WIDTH}}" if name else bar)
        sys.stderr.flush()
        self._is_drawn = True


def _in_notebook() -> bool:
    return "ipykernel" in sys.modules


def _shows_bars() -> bool:
    return sys.stderr.isatty() or _in_notebook()


def _tqdm(what: str) -> Any:
    """A bar of tqdm, a widget in a notebook; None if tqdm is not installed."""
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return None
    return tqdm(desc=what, total=0, leave=True)
