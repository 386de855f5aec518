"""The front of accuracy against time: the methods that no other method beats in both."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["is_near_front", "is_on_front"]

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def is_on_front(ms: npt.ArrayLike, errors: npt.ArrayLike) -> Flags:
    """Mask of the methods on the front (Pareto 1906).

    A method is off the front if another is at least as good in both time and error, and better in one.

    Parameters
    ----------
    ms
        (N,) times.
    errors
        (N,) errors. A method whose time or error is not finite is off the front.
    """
    times, values = np.asarray(ms, np.float64), np.asarray(errors, np.float64)
    found = np.zeros(len(times), bool)
    finite = np.flatnonzero(np.isfinite(times) & np.isfinite(values))
    best, best_ms = np.inf, np.nan
    for index in finite[np.lexsort((values[finite], times[finite]))]:
        if values[index] < best:
            best, best_ms = values[index], times[index]
        found[index] = values[index] == best and times[index] == best_ms
    return found


def is_near_front(
    ms: npt.ArrayLike, errors: npt.ArrayLike, *, gain: float = 0.1, tolerance: float = 0.02
) -> Flags:
    """Mask of the methods that are worth their price.

    A method is not if another one is better by more than `gain` in time or error, and worse by at most
    `tolerance` in the other, as shares. Unlike `is_on_front`, a chance difference in error does not justify a
    long time.

    Parameters
    ----------
    ms, errors
        (N,) each, as for `is_on_front`.
    gain, tolerance
        Shares. Repeated runs differ by 2 % in depth errors (bootstrap over seeds) and by up to 10 % in times.
    """
    times, values = np.asarray(ms, np.float64), np.asarray(errors, np.float64)
    faster = times[None] < (1.0 - gain) * times[:, None]
    better = values[None] < (1.0 - gain) * values[:, None]
    as_fast = times[None] <= (1.0 + tolerance) * times[:, None]
    as_good = values[None] <= (1.0 + tolerance) * values[:, None]
    beaten = ((faster & as_good) | (better & as_fast)).any(axis=1)
    return np.isfinite(times) & np.isfinite(values) & ~beaten
