"""The front of time and error over all choices of one rung per stage, by dynamic programming.

Bellman's principle holds because every stage changes a state monotonically: a start that is worse in every
measure cannot become better by the same later choices. So dominated states are removed stage by stage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

__all__ = ["front", "undominated"]

State = TypeVar("State")
Option = TypeVar("Option")


def undominated(measures: Sequence[tuple[float, ...]], margin: float = 0.0) -> list[int]:
    """Indices of the points that no other point dominates: none is at least as good in every measure.

    Parameters
    ----------
    measures
        Points; smaller is better. A point with a measure that is not finite is never kept.
    margin
        By how much a point must be better in the first measure to dominate. With 0, only the first of equal
        points is kept.

    Returns
    -------
    list of int
        In ascending order of the measures.
    """
    order = sorted(
        (index for index, point in enumerate(measures) if np.isfinite(point).all()),
        key=lambda index: (measures[index], index),
    )
    kept: list[int] = []
    for index in order:
        # A point that dominates this one precedes it in lexicographic order, and so does one that dominates
        # that point: the kept ones suffice.
        least, *rest = measures[index]
        if not any(
            measures[other][0] + margin <= least
            and all(a <= b for a, b in zip(measures[other][1:], rest, strict=True))
            for other in kept
        ):
            kept.append(index)
    return kept


def front(
    stages: Sequence[Sequence[Option]],
    start: State,
    add: Callable[[State, Option], State],
    measures: Callable[[State], tuple[float, ...]],
    margin: float = 0.0,
) -> list[tuple[tuple[Option, ...], State]]:
    """Choices of one option per stage that no other choice dominates.

    Parameters
    ----------
    stages
        The options of each stage, in order.
    start
        State before the first stage.
    add
        State after an option. It must be monotone: if one state is at least as good as another in every
        measure, it stays so after any option. With a margin, options must add to the first measure.
    measures
        Of a state; smaller is better.
    margin
        As in `undominated`.

    Returns
    -------
    list of (options, state)
        In ascending order of the measures.
    """
    paths: list[tuple[tuple[Option, ...], State]] = [((), start)]
    for options in stages:
        grown = [((*path, option), add(state, option)) for path, state in paths for option in options]
        paths = [grown[index] for index in undominated([measures(state) for _, state in grown], margin)]
    return paths
