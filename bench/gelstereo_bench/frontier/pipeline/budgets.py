"""Success, error and time of the search over its budget."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from gelstereo import Error, Params
from gelstereo.progress import Progress
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, STARTS, Grasp, Noise, Press, grasps
from gelstereo_bench.frontier.pipeline.evaluation import outside
from gelstereo_bench.frontier.pipeline.intervals import Interval, wilson
from gelstereo_bench.frontier.pipeline.kept import Kept, code_digest, key_of

__all__ = ["BUDGETS", "NEAR", "OTHER_LAWS", "SIMULATED", "Budget", "measure_budgets"]

#: In work units of the search, as the setting.
BUDGETS = (60_000, 80_000, 100_000, 120_000, 150_000, 200_000, 240_000, 370_000, 1_000_000)
#: Contact seeds; those of docs/localization.md and of the tables of covariance are others.
_FIRST_SEED = 30_000
#: Whose contacts they are.
SIMULATED, NEAR, OTHER_LAWS = "simulated gel", "the same, near guesses", "gels of other laws"
#: Search radius for guesses off by up to 5 mm, and for near ones: the default, mm.
_FAR_MM, _NEAR_MM = 8.0, 3.0


@dataclass
class Budget:
    """Results with one budget on contacts of one kind."""

    success: list[bool] = field(default_factory=list)
    #: Squared error relative to the Cramér-Rao bound, and determined directions, of the successes.
    squared: list[float] = field(default_factory=list)
    directions: list[int] = field(default_factory=list)
    converged: list[bool] = field(default_factory=list)
    cut: list[bool] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    @property
    def rate(self) -> Interval:
        """Success rate."""
        return wilson(sum(self.success), len(self.success))

    @property
    def over_bound(self) -> float:
        """Root mean square error of the successes over the bound."""
        return float(np.sqrt(sum(self.squared) / sum(self.directions))) if self.squared else float("nan")

    def extend(self, record: dict[str, list[Any]]) -> None:
        """Add the results of one block."""
        for name, values in record.items():
            getattr(self, name).extend(values)


def measure_budgets(kept: Kept, seeds: int, law_seeds: int, every: int = 1) -> dict[str, dict[int, Budget]]:
    """Run the search with every budget on every contact from all starts; budgets take turns.

    Parameters
    ----------
    kept
        Holds the results of finished blocks.
    seeds
        Simulated contacts of each part and noise.
    law_seeds
        Contacts of each part and law of ``bench/outside``, half `w`; at most 16 or 32 are stored.
    every
        One in so many parts with a noise or law is used.

    Returns
    -------
    dict
        Results by kind of contacts and budget.
    """
    found = {kind: {budget: Budget() for budget in BUDGETS} for kind in (SIMULATED, NEAR, OTHER_LAWS)}
    code, blocks = code_digest("budgets"), list(_blocks(seeds, law_seeds))[::every]
    with Progress("frontier pipeline: budgets") as shown:
        for done, (kind, name, count, contacts) in enumerate(blocks):
            shown(done, len(blocks), name)
            about = {"stage": "budgets", "scene": name, "seed": count}
            key = key_of({**about, "code": code, "budgets": BUDGETS, "kind": kind})
            records = kept.get(key)
            if records is None:
                records = _run(contacts(), kind)
                kept.add(key, about, records)
            for budget in BUDGETS:
                found[kind][budget].extend(records[str(budget)])
        shown(len(blocks), len(blocks))
    return found


_Block = tuple[str, str, int, Callable[[], Sequence[Grasp]]]


def _blocks(seeds: int, law_seeds: int) -> Iterator[_Block]:
    """Kind, name and number of contacts of every block, and a function that makes them."""
    for press in GRASPED:
        for noise in NOISES:
            make = partial(_pressed, press, noise, seeds)
            for kind in (SIMULATED, NEAR):
                yield kind, f"{press.name}, {noise.name}", seeds, make
    for law, part in _laws() if law_seeds else ():
        yield OTHER_LAWS, f"{law}, {part}", law_seeds, partial(_of_law, law, part, law_seeds)


def _laws() -> list[tuple[str, str]]:
    """Laws and parts of ``bench/outside``, half `w`.

    Raises
    ------
    Error
        The folder ``bench`` is not on Python's path.
    """
    jobs = outside("grasped").jobs()
    entries = [entry for entry, _, _ in jobs.values() if entry["half"] == "w"]
    return list(dict.fromkeys((entry["law"], entry["part"]) for entry in entries))


def _pressed(press: Press, noise: Noise, seeds: int) -> Sequence[Grasp]:
    return list(grasps(press, noise, range(_FIRST_SEED, _FIRST_SEED + seeds)))


def _of_law(law: str, part: str, count: int) -> Sequence[Grasp]:
    """Contacts of a part under a law, evenly from all that are stored."""
    group = [one.grasp for one in _stored() if (one.law, one.grasp.part) == (law, part)]
    return group[:: max(1, len(group) // count)][:count]


@cache
def _stored() -> list[Any]:
    from outside.judge_registration import contacts

    return list(contacts("w"))


def _run(contacts: Sequence[Grasp], kind: str) -> dict[str, dict[str, list[Any]]]:
    """Near guesses are off by up to 5 degrees and 1 mm; others by up to 10 and 2, and 30 and 5, as well."""
    starts, radius_mm = (STARTS[:1], _NEAR_MM) if kind == NEAR else (STARTS, _FAR_MM)
    usual = Params.preset("balanced").replace({"register.advanced.search_radius_mm": radius_mm})
    params = {b: usual.replace({"register.surface_search.budget": b}) for b in BUDGETS}
    results = {budget: Budget() for budget in BUDGETS}
    for turn, grasp in enumerate(contacts):
        for start in starts:
            guess = grasp.guess(start, turn)
            for k in range(len(BUDGETS)):
                budget = BUDGETS[(k + turn) % len(BUDGETS)]
                _search(grasp, guess, params[budget], results[budget])
    return {str(budget): dict(vars(result)) for budget, result in results.items()}


def _search(grasp: Grasp, guess: Any, params: Params, result: Budget) -> None:
    try:
        begin = time.perf_counter_ns()
        found = grasp.registered(guess, params)
        result.ms.append(1e-6 * (time.perf_counter_ns() - begin))
    except Error:
        result.success.append(False)
        return
    score = grasp.score(np.asarray(found.t_sensor_object))
    result.success.append(score.success)
    result.converged.append(found.converged)
    result.cut.append(found.alternatives_cut)
    if score.success:
        result.squared.append(score.squared)
        result.directions.append(score.observable)
