"""How far a measured figure may be off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Interval", "of_share", "of_take"]

#: Student's t, two-sided 95 %, by degrees of freedom from 1 on.
_T95 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179)
#: The same of the normal distribution.
_Z95 = 1.960


@dataclass(frozen=True)
class Interval:
    """Where a figure lies in 95 of 100 cases.

    Attributes
    ----------
    low, high : float
    """

    low: float
    high: float


def of_take(values: Sequence[float]) -> Interval:
    """Prediction interval (95 %) of a positive figure of one more take.

    The logarithms of the takes are taken to be normal: figures scatter by a factor.

    Parameters
    ----------
    values
        One per take. From a single take nothing is known about the scatter: 0 to infinity.
    """
    count = len(values)
    if count < 2 or min(values) <= 0.0 or not np.isfinite(values).all():
        return Interval(0.0, math.inf)
    logs = np.log(values)
    t = _T95[count - 2] if count - 2 < len(_T95) else _Z95
    half = t * float(np.std(logs, ddof=1)) * math.sqrt(1.0 + 1.0 / count)
    middle = float(np.mean(logs))
    return Interval(math.exp(middle - half), math.exp(middle + half))


def of_share(successes: int, trials: int) -> Interval:
    """Interval (95 %) of a success rate (Wilson 1927).

    Parameters
    ----------
    successes, trials
        Counted. Without trials, 0 to 1.
    """
    if trials == 0:
        return Interval(0.0, 1.0)
    share, z2 = successes / trials, _Z95**2
    middle = (share + 0.5 * z2 / trials) / (1.0 + z2 / trials)
    half = _Z95 * math.sqrt(share * (1.0 - share) / trials + 0.25 * z2 / trials**2) / (1.0 + z2 / trials)
    return Interval(max(middle - half, 0.0), min(middle + half, 1.0))
