"""95 % intervals of success rates and of errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Interval", "bootstrap", "wilson"]

Array = npt.NDArray[np.float64]

#: Two-sided 95 % quantile of the normal distribution.
_Z = 1.959964
#: With 400 draws, the standard deviation of a 2.5 % quantile is 0.8 % in probability.
_DRAWS = 400


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


def wilson(successes: int, runs: int) -> Interval:
    """Success rate with its score interval (Wilson 1927); NaN without runs."""
    if runs == 0:
        return Interval(float("nan"), 0.0, 1.0)
    rate = successes / runs
    spread = _Z**2 / runs
    middle = (rate + 0.5 * spread) / (1.0 + spread)
    half = _Z / (1.0 + spread) * np.sqrt(rate * (1.0 - rate) / runs + 0.25 * spread / runs)
    # The interval contains the rate; at 0 and 1 its end equals it, but for rounding.
    return Interval(
        rate, min(rate, max(0.0, float(middle - half))), max(rate, min(1.0, float(middle + half)))
    )


def bootstrap(
    groups: Sequence[Sequence[Array]], statistic: Callable[[Sequence[Sequence[Array]]], float]
) -> Interval:
    """Value of a statistic with its percentile interval (Efron 1979).

    Parameters
    ----------
    groups
        For each scene, one array for each seed. Seeds are drawn again within their scene; a seed keeps
        its values together, because they share noise.
    statistic
        Maps such groups to a value.
    """
    random = np.random.default_rng(20211)
    draws = [
        statistic([[seeds[k] for k in random.integers(len(seeds), size=len(seeds))] for seeds in groups])
        for _ in range(_DRAWS)
    ]
    low, high = np.percentile(draws, (2.5, 97.5), method="nearest")
    return Interval(statistic(groups), float(low), float(high))
