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
from gelstereo.tune.measure import Laboratory, outcome_of
from gelstereo.tune.predict import (
    base_settings,
    nearest_to,
    predicted_front,
    reference_setting,
    settings_to_measure,
)
from gelstereo.tune.result import Tuned
from gelstereo.tune.setting import Setting
from gelstereo.tune.takes import Takes

__all__ = ["conditions_of", "laboratory_of", "tune"]

#: Takes on which every rung is measured, and candidates to verify. Tried on `grasp_cylinder` (two seeds, seven
#: goals each, four takes): 4, 6 and 8 candidates have a mean regret of 0.9, 0.8 and 0.7 %, for 2.6, 3.0 and
#: 3.2 % of the time of exhaustive search. Two takes for the rungs cost 2 % more.
RUNG_TAKES, CANDIDATES = 1, 6


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
    front that are nearest to the goal are verified by successive halving, and the best of them on frames that
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
        The frames cannot be sensed with the usual settings, or the goal needs a part and there is none.
    """
    has_part = laboratory.part is not None
    goal.check(has_part)
    takes = min(RUNG_TAKES, laboratory.takes)
    front = _front(laboratory, takes)
    candidates = nearest_to(goal, front, CANDIDATES)

    def ranks(settings: Sequence[Setting], effort: int) -> list[tuple[float, float]]:
        found = laboratory.measure(settings, effort)
        return [goal.rank(outcome_of(found[setting])) for setting in settings]

    best = halve(candidates, efforts(takes, laboratory.takes), ranks)[0]
    expected: dict[Setting, Outcome] = dict(front)
    measured = laboratory.measure([best], laboratory.takes)[best]
    return Tuned(
        goal=goal,
        setting=best,
        params=best.params(laboratory.base),
        predicted=expected[best],
        figures=tuple(measured),
        held_out=tuple(laboratory.check(best)),
        front=tuple(front),
        is_simulated=laboratory.is_simulated,
    )


def _front(laboratory: Laboratory, takes: int) -> list[tuple[Setting, Outcome]]:
    for base in base_settings(laboratory.base, laboratory.part is not None):
        figures = laboratory.measure(settings_to_measure(base), takes)
        if math.isfinite(outcome_of(figures[base.sensing]).height_um):
            return predicted_front(figures, base)
    raise TuneError(
        "no way of detection can sense all frames; `gelstereo inspect` states what an image shows, and "
        "`gelstereo setup` finds settings for it"
    )


def efforts(first: int, last: int) -> list[int]:
    """Numbers of takes, each twice the one before, up to the last."""
    found = [first]
    while found[-1] < last:
        found.append(min(2 * found[-1], last))
    return found


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
