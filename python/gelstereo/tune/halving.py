"""Successive halving (Jamieson and Talwalkar 2016): more measurement for fewer candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

__all__ = ["halve"]

Candidate = TypeVar("Candidate")
Rank = TypeVar("Rank", bound="tuple[float, ...]")


def halve(
    candidates: Sequence[Candidate],
    efforts: Sequence[int],
    ranks: Callable[[Sequence[Candidate], int], Sequence[Rank]],
) -> list[Candidate]:
    """Measure all candidates with little effort, then the better half of them with more, and so on.

    Parameters
    ----------
    candidates
        At least one.
    efforts
        Effort of each round, ascending.
    ranks
        Ranks of candidates at an effort; the least is the best.

    Returns
    -------
    list
        Candidates of the last round, the best first. A tie keeps their order.
    """
    kept = list(candidates)
    for number, effort in enumerate(efforts):
        found = ranks(kept, effort)
        order = sorted(range(len(kept)), key=lambda index: found[index])
        is_last = number == len(efforts) - 1
        kept = [kept[index] for index in order[: len(kept) if is_last else -(-len(kept) // 2)]]
    return kept
