"""The tuner beside exhaustive search and Optuna, on simulated scenes.

Every setting is measured once on all takes: the table. Exhaustive search reads all of it, the tuner and
Optuna ask for entries. A method's cost is the processor time that measuring its entries takes. Optuna
receives an entry without noise and pays only once for equal sensing, which favours it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
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

__all__ = ["SCENES", "Measured", "measure_tuning"]

#: Scenes, and first seeds of their takes.
SCENES = (("grasp_cylinder", 1), ("grasp_cylinder", 101), ("usb_plug", 1), ("usb_plug", 101))
#: Takes of a scene, as in `gelstereo tune`: every third is held out, so the table has eight.
_TAKES = 12
#: Evaluations after which Optuna stops; there are 324 settings.
_MAX_TRIALS = 648


@dataclass
class Measured:
    """Figures of all settings on all takes of a scene, and what they cost."""

    name: str
    laboratory: Laboratory
    frames: int
    figures: dict[Setting, list[Figures]] = field(default_factory=dict)

    def outcome(self, setting: Setting) -> Outcome:
        """Of a setting on all takes."""
        return outcome_of(self.figures[setting])

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
        outcomes = [self.outcome(setting) for setting in self.figures if setting.register]
        fastest, best = (min(outcomes, key=key) for key in (_time_ms, _error_um))
        levels = np.array([0.2, 0.5, 0.8])
        budgets = _time_ms(fastest) * (_time_ms(best) / _time_ms(fastest)) ** levels
        errors = _error_um(best) * (_error_um(fastest) / _error_um(best)) ** levels
        found = [Goal(budget_ms=float(budget)) for budget in budgets]
        return [*found, *(Goal(error_um=float(error)) for error in errors), Goal(success=99.0)]

    def regret(self, goal: Goal, setting: Setting) -> float:
        """Relative excess over the goal's limits, or over the best cost within them, whichever is more."""
        outcome = self.outcome(setting)
        every = [self.outcome(each) for each in self.figures if each.register]
        best = min(every, key=goal.rank)
        return max(goal.excess(outcome) - goal.excess(best), goal.cost(outcome) / goal.cost(best) - 1.0, 0.0)


@dataclass(frozen=True)
class Run:
    """One search: its regret, and its cost as a share of that of exhaustive search."""

    regret: float
    share: float


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
    return Run(table.regret(goal, chosen), cost_ms / exhaustive_ms(table))


def exhaustive_ms(table: Measured) -> float:
    """Processor time of measuring everything."""
    takes = range(table.laboratory.takes)
    return table.cost_ms((setting, take) for setting in table.figures if setting.register for take in takes)


def searched(
    table: Measured, goal: Goal, ask: Callable[[Goal, int], Search], seed: int, regret: float
) -> Run:
    """Run a search of Optuna until its regret is no more than that of the tuner."""
    search = ask(goal, seed)
    takes = range(table.laboratory.takes)
    asked: dict[Setting, None] = {}
    reached = float("inf")
    for _ in range(_MAX_TRIALS):
        setting = search.next()
        asked[setting] = None
        search.tell(table.outcome(setting))
        reached = min(reached, table.regret(goal, setting))
        if reached <= regret + 1e-9:
            break
    cost_ms = table.cost_ms((setting, take) for setting in asked for take in takes)
    return Run(reached, cost_ms / exhaustive_ms(table))


class Search:
    """One study of Optuna: its next setting, and the outcome of it."""

    def __init__(self, goal: Goal, seed: int, is_genetic: bool) -> None:
        with needs(__name__):
            import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)

        def constraints(trial: optuna.trial.FrozenTrial) -> Sequence[float]:
            return (float(trial.user_attrs.get("excess", 0.0)),)

        self._goal = goal
        sampler: optuna.samplers.BaseSampler
        if is_genetic:
            # A population of 50, the default, would be the first sixth of all settings, at random.
            sampler = optuna.samplers.NSGAIISampler(
                population_size=20, seed=seed, constraints_func=constraints
            )
            self._study = optuna.create_study(directions=["minimize", "minimize"], sampler=sampler)
        else:
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constraints_func=constraints)
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
        self._trial.set_user_attr("excess", self._goal.excess(outcome))
        values = [outcome.time_ms, outcome.error_um] if self._is_genetic else [self._goal.cost(outcome)]
        self._study.tell(self._trial, values)


def measure_tuning(
    report: Report,
    scenes: Sequence[tuple[str, int]] = SCENES,
    seeds: int = 10,
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
    runs: dict[str, list[Run]] = {"gelstereo.tune": [], "Optuna, TPE": [], "Optuna, NSGA-II": []}
    ratios: dict[str, list[float]] = {name: [] for name in runs}
    for name, seed in scenes:
        report(f"tuning: all settings on {name}, seed {seed}")
        table = measured(name, seed, cache)
        for goal in table.goals():
            report(f"tuning: {name}, seed {seed}, {goal}")
            own = tuned(table, goal)
            runs["gelstereo.tune"].append(own)
            for label, is_genetic in (("Optuna, TPE", False), ("Optuna, NSGA-II", True)):
                for again in range(seeds):
                    ask = lambda goal, seed, genetic=is_genetic: Search(goal, seed, genetic)  # noqa: E731
                    found = searched(table, goal, ask, again, own.regret)
                    runs[label].append(found)
                    ratios[label].append(found.share / own.share)
    head = ["method", "regret, %", "largest regret, %", "time, % of exhaustive", "times as long as the tuner"]
    rows = [
        ["exhaustive search", "0", "0", "100", _ratio([1.0 / run.share for run in runs["gelstereo.tune"]])]
    ]
    for name, every in runs.items():
        regrets = [100.0 * run.regret for run in every]
        shares = [100.0 * run.share for run in every]
        rows.append(
            [
                name,
                f"{np.median(regrets):.1f}",
                f"{max(regrets):.1f}",
                f"{np.median(shares):.1f} (up to {max(shares):.1f})",
                _ratio(ratios[name]) if ratios[name] else "1",
            ]
        )
    return Table("tuning", head, rows)


def _time_ms(outcome: Outcome) -> float:
    return outcome.time_ms


def _error_um(outcome: Outcome) -> float:
    return outcome.error_um


def _ratio(values: Sequence[float]) -> str:
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
    return f"{middle:.1f} ({low:.1f} to {high:.1f})"
