"""The tuner beside exhaustive search and Optuna, on simulated scenes.

Every setting is measured once on all takes: the table. Exhaustive search reads all of it, the tuner and
Optuna ask for entries. A method's cost is the processor time that measuring its entries takes. Optuna
receives an entry without noise and pays only once for equal sensing, which favours it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from gelstereo import Params, Scene
from gelstereo.extras import needs
from gelstereo.simulation import shipped_scene
from gelstereo.tune import (
    Figures,
    Goal,
    Laboratory,
    Outcome,
    Part,
    Setting,
    laboratory_of,
    simulated_takes,
    tune,
)
from gelstereo.tune.command import scene_part
from gelstereo.tune.measure import outcome_of
from gelstereo.tune.rungs import combinations
from gelstereo_bench.frontier.table import Report, Table

__all__ = ["SCENES", "Measured", "Run", "Search", "measure_tuning", "searched", "tuned"]

#: Scenes, and first seeds of their takes.
SCENES = (("grasp_cylinder", 1), ("grasp_cylinder", 101), ("usb_plug", 1), ("usb_plug", 101))
#: Takes of a scene, as in `gelstereo tune`: every third is held out, so the table has eight.
_TAKES = 12
#: Trials after which Optuna stops; there are 324 settings.
_MAX_TRIALS = 324


@dataclass
class Measured:
    """Figures of all settings on all takes of a scene, and what they cost."""

    name: str
    laboratory: Laboratory
    frames: int
    figures: dict[Setting, list[Figures]] = field(default_factory=dict)

    @cached_property
    def outcomes(self) -> dict[Setting, Outcome]:
        """Of every setting with registration, on all takes."""
        return {key: outcome_of(each) for key, each in self.figures.items() if key.register}

    def outcome(self, setting: Setting) -> Outcome:
        """Of a setting on all takes."""
        return self.outcomes[setting]

    def cost_ms(self, asked: Iterable[tuple[Setting, int]]) -> float:
        """Processor time of measuring settings on takes; equal sensing is measured once."""
        sensed: dict[tuple[Setting, int], float] = {}
        located_ms = 0.0
        for setting, take in asked:
            figures = self.figures[setting][take]
            sensed[setting.sensing, take] = self.frames * figures.sense_ms
            if setting.register is not None:
                located_ms += figures.trials * (figures.locate_ms or 0.0)
        return sum(sensed.values()) + located_ms

    def goals(self) -> list[Goal]:
        """Budgets and errors between the ends of the front, and a success rate."""
        fastest, best = (min(self.outcomes.values(), key=key) for key in (_time_ms, _error_um))
        levels = np.array([0.2, 0.5, 0.8])
        budgets = _time_ms(fastest) * (_time_ms(best) / _time_ms(fastest)) ** levels
        errors = _error_um(best) * (_error_um(fastest) / _error_um(best)) ** levels
        found = [Goal(budget_ms=float(budget)) for budget in budgets]
        return [*found, *(Goal(error_um=float(error)) for error in errors), Goal(success=99.0)]

    def regret(self, goal: Goal, setting: Setting) -> float:
        """Relative excess over the goal's limits, or over the best cost within them, whichever is more."""
        outcome = self.outcome(setting)
        best = min(self.outcomes.values(), key=goal.rank)
        return max(goal.excess(outcome) - goal.excess(best), goal.cost(outcome) / goal.cost(best) - 1.0, 0.0)


@dataclass(frozen=True)
class Run:
    """One search: its time as a share of that of exhaustive search, and the regret of its best setting, after
    each step.
    """

    shares: tuple[float, ...]
    regrets: tuple[float, ...]

    def regret_at(self, share: float) -> float:
        """Regret after a share of the time; before the first step, that of the first setting."""
        return self.regrets[max(int(np.searchsorted(self.shares, share, side="right")) - 1, 0)]

    def share_of(self, regret: float) -> float:
        """Time until the regret is no more than that; of the whole run if it never is."""
        good = np.flatnonzero(np.array(self.regrets) <= regret + 1e-9)
        return self.shares[int(good[0])] if good.size else self.shares[-1]


def measured(name: str, seed: int, cache: Path | None) -> Measured:
    """Measure all settings on a scene that comes with the package."""
    path = shipped_scene(name)
    scene = Scene.load(path).replace({"seed": seed})
    part = Part(scene_part(path).with_symmetries())
    takes = simulated_takes(scene, _TAKES)
    file = None if cache is None else cache / f"{name}-{seed}.json"
    laboratory = laboratory_of(takes, Params.preset("balanced"), part, cache=file)
    frames = len(takes.tuning[0].shots)
    found = Measured(f"{name}, seed {seed}", laboratory, frames)
    settings = [Setting.of(rungs) for rungs in combinations()]
    sensing = dict.fromkeys(setting.sensing for setting in settings)
    found.figures = laboratory.measure([*settings, *sensing], laboratory.takes)
    return found


def tuned(table: Measured, goal: Goal) -> Run:
    """Run the tuner on the table."""
    asked: list[list[tuple[Setting, int]]] = []
    measure = table.laboratory.measure

    def counted(settings: Iterable[Setting], takes: int) -> dict[Setting, list[Figures]]:
        known = {pair for call in asked for pair in call}
        settings = list(settings)
        pairs = [(setting, take) for setting in settings for take in range(takes)]
        asked.append([pair for pair in pairs if pair not in known])
        return measure(settings, takes)

    table.laboratory.measure = counted  # type: ignore[method-assign]
    try:
        chosen = tune(table.laboratory, goal).setting
    finally:
        del table.laboratory.measure
    cost_ms = sum(table.cost_ms(call) for call in asked)
    return Run((cost_ms / exhaustive_ms(table),), (table.regret(goal, chosen),))


def exhaustive_ms(table: Measured) -> float:
    """Processor time of measuring everything."""
    takes = range(table.laboratory.takes)
    return table.cost_ms((setting, take) for setting in table.figures if setting.register for take in takes)


def searched(table: Measured, goal: Goal, search: Search) -> Run:
    """Run a search of Optuna."""
    whole_ms, spent_ms = exhaustive_ms(table), 0.0
    asked: dict[Setting, None] = {}
    sensed: set[Setting] = set()
    best: Setting | None = None
    shares, regrets = [], []
    for _ in range(_MAX_TRIALS):
        setting = search.next()
        outcome = table.outcome(setting)
        search.tell(outcome)
        if setting in asked:
            continue  # an equal trial costs nothing
        asked[setting] = None
        spent_ms += _cost_ms(table, setting, sensed)
        if best is None or goal.rank(outcome) < goal.rank(table.outcome(best)):
            best = setting
        shares.append(spent_ms / whole_ms)
        regrets.append(table.regret(goal, best))
    return Run(tuple(shares), tuple(regrets))


def _cost_ms(table: Measured, setting: Setting, sensed: set[Setting]) -> float:
    """Processor time of one more setting on all takes, without sensing that was measured before."""
    takes = range(table.laboratory.takes)
    whole_ms = table.cost_ms((setting, take) for take in takes)
    if setting.sensing not in sensed:
        sensed.add(setting.sensing)
        return whole_ms
    return whole_ms - table.cost_ms((setting.sensing, take) for take in takes)


class Search:
    """One study of Optuna: its next setting, and the outcome of it."""

    def __init__(self, goal: Goal, seed: int, is_genetic: bool) -> None:
        with needs(__name__):
            import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)

        self._goal = goal
        sampler: optuna.samplers.BaseSampler
        if is_genetic:
            # A population of 50, the default, would be the first sixth of all settings, at random.
            sampler = optuna.samplers.NSGAIISampler(population_size=20, seed=seed)
            self._study = optuna.create_study(directions=["minimize", "minimize"], sampler=sampler)
        else:
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True)
            self._study = optuna.create_study(sampler=sampler)
        self._is_genetic = is_genetic
        self._settings = {tuple(rung.name for rung in rungs): Setting.of(rungs) for rungs in combinations()}
        self._names = [list(dict.fromkeys(names)) for names in zip(*self._settings, strict=True)]

    def next(self) -> Setting:
        """Ask for a setting."""
        self._trial = self._study.ask()
        names = [
            self._trial.suggest_categorical(stage, choices)
            for stage, choices in zip(("detect", "points", "contact", "register"), self._names, strict=True)
        ]
        return self._settings[tuple(names)]

    def tell(self, outcome: Outcome) -> None:
        """Report what it does."""
        self._trial.set_constraint("goal", self._goal.excess(outcome))
        values = [outcome.time_ms, outcome.error_um] if self._is_genetic else [self._goal.cost(outcome)]
        self._study.tell(self._trial, values)


def measure_tuning(
    report: Report,
    scenes: Sequence[tuple[str, int]] = SCENES,
    seeds: int = 5,
    cache: Path | None = None,
) -> Table:
    """Regret and cost of the tuner and of Optuna, over scenes and goals.

    Parameters
    ----------
    report
        Receives what is measured at present.
    scenes
        Names, and first seeds of their takes.
    seeds
        Runs of Optuna for each goal.
    cache
        Folder of kept measurements. Default: none.
    """
    own: list[Run] = []
    others: dict[str, list[list[Run]]] = {"Optuna, TPE": [], "Optuna, NSGA-II": []}
    for name, seed in scenes:
        report(f"tuning: all settings on {name}, seed {seed}")
        table = measured(name, seed, cache)
        for goal in table.goals():
            report(f"tuning: {name}, seed {seed}, {goal}")
            own.append(tuned(table, goal))
            for label, is_genetic in zip(others, (False, True), strict=True):
                found = [searched(table, goal, Search(goal, again, is_genetic)) for again in range(seeds)]
                others[label].append(found)
    head = [
        "method",
        "mean regret, %",
        "largest, %",
        "time, % of exhaustive search",
        "times as long for the tuner's mean regret",
        "run by run: median (10th to 90th percentile)",
    ]
    share = float(np.mean([run.shares[0] for run in own]))
    regrets = np.array([run.regrets[0] for run in own])
    rows = [
        ["exhaustive search", "0", "0", "100", f"{1.0 / share:.0f}", "-"],
        ["gelstereo tune", _percent(regrets.mean()), _percent(regrets.max()), _percent(share), "1", "1"],
    ]
    rows += [_row(label, own, runs, share, float(regrets.mean())) for label, runs in others.items()]
    return Table("tuning", head, rows)


def _row(
    label: str, own: Sequence[Run], runs: Sequence[Sequence[Run]], share: float, regret: float
) -> list[str]:
    """A method after the tuner's time, and how much longer it takes for the tuner's regret."""
    every = [run for group in runs for run in group]
    now = np.array([run.regret_at(share) for run in every])
    grid = np.unique([step for run in every for step in run.shares])
    mean = [float(np.mean([run.regret_at(step) for run in every])) for step in grid]
    reached = grid[int(np.argmax(np.array(mean) <= regret))] if min(mean) <= regret else grid[-1]
    ratios = [
        run.share_of(tuner.regrets[0]) / tuner.shares[0]
        for tuner, group in zip(own, runs, strict=True)
        for run in group
    ]
    low, middle, high = np.quantile(ratios, (0.1, 0.5, 0.9))
    return [
        label,
        f"{_percent(now.mean())} after the tuner's time",
        _percent(now.max()),
        _percent(float(reached)),
        f"{reached / share:.1f}",
        f"{middle:.1f} ({low:.1f} to {high:.1f})",
    ]


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f}"


def _time_ms(outcome: Outcome) -> float:
    return outcome.time_ms


def _error_um(outcome: Outcome) -> float:
    return outcome.error_um
