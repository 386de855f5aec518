"""Tuning: measure each rung, predict all settings, and verify those nearest to the goal."""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from gelstereo._native import Params, __version__
from gelstereo.tune.cache import Conditions, Store, processor
from gelstereo.tune.contacts import Part
from gelstereo.tune.goal import Goal, Outcome, TuneError
from gelstereo.tune.halving import halve
from gelstereo.tune.measure import Figures, Laboratory, outcome_of
from gelstereo.tune.predict import (
    base_settings,
    nearest_to,
    predicted_front,
    reference_setting,
    rungs_beside,
    settings_to_measure,
)
from gelstereo.tune.result import ERROR_RATIO, TIME_RATIO, Tuned
from gelstereo.tune.setting import Setting
from gelstereo.tune.takes import Takes

__all__ = ["conditions_of", "laboratory_of", "tune"]

#: Takes on which every rung is measured, and candidates to verify. Two takes for the rungs cost 1.2 % more of
#: the time of exhaustive search, 8 candidates 0.2 %; neither lowers the regret on `grasp_cylinder` and
#: `usb_plug` (eight takes, 21 goals).
RUNG_TAKES, CANDIDATES = 1, 6
#: Settings that are better by the first share are verified, too, if they are predicted to miss the goal by
#: at most the second, the scatter of errors between takes; so many at most. On the same goals, 0, 4 and 8 of
#: them leave a largest regret of 49, 4 and 2 %.
_WORTHWHILE, _ERROR_SCATTER, _DOUBTED = 0.05, 0.1, 8


def conditions_of(takes: Takes, base: Params, part: Part | None) -> Conditions:
    """What measurements on this computer depend on."""
    width, height = takes.rig.size_px
    held = "none"
    if part is not None:
        guess = None if part.guess is None else part.guess.tolist()
        errors = (part.tolerance_mm, part.guess_error_deg, part.guess_error_mm)
        held = _digest(f"{part.template.digest} {guess} {errors}")
    return Conditions(
        processor=processor(),
        cores=str(os.cpu_count()),
        image_size=f"{width}x{height}",
        markers=f"{takes.lattice[0]}x{takes.lattice[1]}",
        version=__version__,
        sensor=_digest(takes.rig.to_toml() + base.to_toml()),
        frames=takes.digest,
        part=held,
    )


def laboratory_of(
    takes: Takes,
    base: Params | None = None,
    part: Part | None = None,
    *,
    cache: Path | None = None,
    measure_again: bool = False,
    clock: Callable[[], int] = time.thread_time_ns,
) -> Laboratory:
    """Measurements of settings on this computer.

    Parameters
    ----------
    takes
        From `simulated_takes` or `recorded_takes`.
    base
        Settings that are not tuned. Default: preset ``balanced``.
    part
        The part to register; without one, only sensing is measured.
    cache
        File that keeps what is measured. Default: none.
    measure_again
        Whether to replace the file.
    clock
        Time in nanoseconds.

    Raises
    ------
    StaleCache
        The file has measurements of another machine, image size, print, version or input.
    TuneError
        The part was not found in the recording.
    """
    base = base or Params.preset("balanced")
    store = Store(cache, conditions_of(takes, base, part), measure_again=measure_again)
    return Laboratory(takes, base, reference_setting(base, part is not None), part, store, clock)


def tune(laboratory: Laboratory, goal: Goal) -> Tuned:
    """Choose one rung per stage for a goal.

    Each rung is measured once; the front of time and error follows by dynamic programming. The points of the
    front that are nearest to the goal are verified by successive halving. If the best of them does not do
    what was predicted, its rungs are measured on all takes, and the front is predicted anew. Better points
    that are predicted to miss the goal by little are measured as well. The result is checked on frames that
    were held out.

    Parameters
    ----------
    laboratory
        Measures settings on the frames of a sensor.
    goal
        The limits.

    Returns
    -------
    Tuned
        Also if nothing reaches the goal: then it has the settings that miss it by least.

    Raises
    ------
    TuneError
        No way of detection can sense all frames, or the goal needs a part and there is none.
    """
    goal.check(laboratory.part is not None)
    front, verified = _searched(laboratory, goal)
    best = min(verified, key=lambda setting: goal.rank(verified[setting]))
    if goal.excess(verified[best]) <= 0.0:
        doubted = _doubted(goal, front, goal.cost(verified[best]))
        found = laboratory.measure(doubted, laboratory.takes)
        verified |= {setting: outcome_of(each) for setting, each in found.items()}
        best = min(verified, key=lambda setting: goal.rank(verified[setting]))
    return Tuned(
        goal=goal,
        setting=best,
        params=best.params(laboratory.base),
        figures=tuple(laboratory.measure([best], laboratory.takes)[best]),
        held_out=tuple(laboratory.check(best)),
        front=tuple(front),
        is_simulated=laboratory.is_simulated,
    )


def _searched(
    laboratory: Laboratory, goal: Goal
) -> tuple[list[tuple[Setting, Outcome]], dict[Setting, Outcome]]:
    """The predicted front, and the outcomes of the best settings on all takes."""
    base, figures = _rungs(laboratory)
    verified: dict[Setting, Outcome] = {}
    while True:
        front = predicted_front(figures, base)
        known = {setting for setting, each in figures.items() if len(each) == laboratory.takes}
        # What is known to miss the goal needs no verification.
        still_open = [
            (setting, outcome)
            for setting, outcome in front
            if goal.excess(outcome) <= 0.0 or rungs_beside(base, setting)[-1] not in known
        ]
        best = _verified(laboratory, goal, nearest_to(goal, still_open or front, CANDIDATES))
        verified[best] = outcome_of(laboratory.measure([best], laboratory.takes)[best])
        rungs = rungs_beside(base, best)
        if known.issuperset(rungs) or not _contradicts(goal, dict(front)[best], verified[best]):
            return front, verified
        figures |= laboratory.measure(rungs, laboratory.takes)


def _rungs(laboratory: Laboratory) -> tuple[Setting, dict[Setting, list[Figures]]]:
    """The base, and the figures of every rung beside it."""
    for base in base_settings(laboratory.base, laboratory.part is not None):
        figures = laboratory.measure(settings_to_measure(base), min(RUNG_TAKES, laboratory.takes))
        if math.isfinite(outcome_of(figures[base.sensing]).height_um):
            return base, figures
    raise TuneError(
        "no way of detection can sense all frames; `gelstereo inspect` states what an image shows, and "
        "`gelstereo setup` finds settings for it"
    )


def _verified(laboratory: Laboratory, goal: Goal, candidates: Sequence[Setting]) -> Setting:
    """The best of several settings by successive halving over the takes."""

    def ranks(settings: Sequence[Setting], effort: int) -> list[tuple[float, float]]:
        found = laboratory.measure(settings, effort)
        return [goal.rank(outcome_of(found[setting])) for setting in settings]

    first = min(RUNG_TAKES, laboratory.takes)
    return halve(candidates, efforts(first, laboratory.takes), ranks)[0]


def _doubted(goal: Goal, front: Sequence[tuple[Setting, Outcome]], cost: float) -> list[Setting]:
    """Settings that would be better, and are predicted to miss the goal by no more than errors scatter."""
    better = [
        (goal.excess(outcome), goal.cost(outcome), number)
        for number, (_, outcome) in enumerate(front)
        if goal.cost(outcome) < cost / (1.0 + _WORTHWHILE) and goal.excess(outcome) <= _ERROR_SCATTER
    ]
    return [front[number][0] for _, _, number in sorted(better)[:_DOUBTED]]


def _contradicts(goal: Goal, predicted: Outcome, measured: Outcome) -> bool:
    """Whether a measurement is worse than its prediction by more than held-out frames may be, or misses the
    goal unexpectedly.
    """
    return (
        measured.time_ms > TIME_RATIO * predicted.time_ms
        or measured.error_um > ERROR_RATIO * predicted.error_um
        or goal.excess(measured) > goal.excess(predicted) == 0.0
    )


def efforts(first: int, last: int) -> list[int]:
    """Numbers of takes, each twice the one before, up to the last."""
    found = [first]
    while found[-1] < last:
        found.append(min(2 * found[-1], last))
    return found


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
