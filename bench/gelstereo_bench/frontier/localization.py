"""Success, error relative to the bound, and time of registration on parts in the gel, compared with other
libraries.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, STARTS, Grasp, Start, grasps
from gelstereo_bench.frontier.likelier import success_or_likelier
from gelstereo_bench.frontier.nees import nees_table
from gelstereo_bench.frontier.rivals import Method, rivals
from gelstereo_bench.frontier.rungs import Rung, rungs_of
from gelstereo_bench.frontier.table import Report, Table, Target, figure
from gelstereo_bench.frontier.timing import Times, time_side_by_side

__all__ = ["Tally", "measure_localization"]

Array = npt.NDArray[np.float64]

#: The rung to which the targets apply.
BEST = "surface_search"
#: The guess that needs no search: the truth.
_TRUTH = Start("the truth", 0.0, 0.0)
#: Search budgets of the best rung in lookups, in addition to the default.
_BUDGETS = (1_000_000, 200_000, 120_000, 80_000, 50_000)
#: Starts for other libraries, in addition to the near ones of the rungs with a single start.
_CLOSE = STARTS[0]
#: The rung with a single start: its intended start, and the target of its median time, ms.
_NEAR = {"surface_close": (_CLOSE, 0.5)}
#: Number of consecutive registrations per contact, and one in how many contacts is used.
_FRAMES, _ONE_OF = 8, 4
#: Samples of an efficient estimator per contact; the success rate is then known to 2 %.
_DRAWS = 500


@dataclass
class Tally:
    """Results of one method with one noise and one class of starts."""

    #: Successes by part.
    success: dict[str, list[bool]] = field(default_factory=dict)
    #: Squared error relative to the bound, and number of determined directions, of every success.
    squared: list[float] = field(default_factory=list)
    observable: list[int] = field(default_factory=list)
    refused: int = 0

    def add(self, grasp: Grasp, pose: Array | None) -> None:
        """Count one run; None instead of a pose is a refusal."""
        runs = self.success.setdefault(grasp.part, [])
        if pose is None or not np.all(np.isfinite(pose)):
            self.refused += 1
            runs.append(False)
            return
        score = grasp.score(pose)
        runs.append(score.success)
        if score.success:
            self.squared.append(score.squared)
            self.observable.append(score.observable)

    @property
    def rate(self) -> float:
        """Per cent of runs that succeed."""
        return 100.0 * float(np.mean([ok for runs in self.success.values() for ok in runs]))

    @property
    def over_bound(self) -> float:
        """Root mean square error of the successes over the Cramér-Rao bound."""
        return float(np.sqrt(sum(self.squared) / sum(self.observable))) if self.squared else float("nan")


def measure_localization(seeds: range, rounds: int, report: Report) -> tuple[list[Table], list[Target]]:
    """Run every method on every contact from every start.

    Parameters
    ----------
    seeds
        Seeds; each gives one contact per part and noise.
    rounds
        Timing rounds; in each, all methods register the next contact.
    """
    others, missing = rivals()
    methods = {rung.name: _native(rung) for rung in rungs_of("register")} | others
    tallies: dict[tuple[str, str, str], Tally] = {}
    contacts: dict[str, list[Grasp]] = {}
    for noise in NOISES:
        report(f"localization: contacts, {noise.name}")
        contacts[noise.name] = [grasp for press in GRASPED for grasp in grasps(press, noise, seeds)]
        for name, method in methods.items():
            report(f"localization: {name}, {noise.name}")
            for start in STARTS:
                tallies[name, noise.name, start.name] = _tally(method, contacts[noise.name], start)
    every = [grasp for grasps_of_noise in contacts.values() for grasp in grasps_of_noise]
    report(f"localization: times of {rounds} registrations by each method")
    times = time_side_by_side({name: _one_of(method, every) for name, method in methods.items()}, rounds)
    rows = []
    for name in methods:
        row = [name]
        for noise in NOISES:
            found = [tallies[name, noise.name, start.name] for start in STARTS]
            row += [" / ".join(f"{tally.rate:.0f}" for tally in found), figure(found[1].over_bound)]
        rows.append([*row, f"{times[name].median_ms:.2f}", f"{times[name].p99_ms:.2f}"])
    rows += [_from_truth(methods[BEST], contacts), _or_likelier(methods[BEST], contacts)]
    ideal = ["*an efficient estimate*"]
    for noise in NOISES:
        shares = [grasp.at_bound(_DRAWS, seed) for seed, grasp in enumerate(contacts[noise.name])]
        ideal += [f"{100.0 * float(np.mean(shares)):.0f}", "1"]
    rows.append([*ideal, "-", "-"])
    rows += _missing_rows(missing)
    head = [
        "method",
        *(cell for noise in NOISES for cell in (noise.name, "over the bound")),
        "median ms",
        "p99 ms",
    ]
    report("localization: times of parts that are followed")
    near, near_targets = _near_table(methods, list(others), every, rounds)
    report(f"localization: budgets of {BEST}")
    budgets = _budget_table(every, rounds)
    parts = _parts_table(methods, tallies)
    tables = [Table("localization", head, rows), near, budgets, parts, nees_table(contacts)]
    return tables, _targets(tallies, times) + near_targets


def _from_truth(method: Method, contacts: Mapping[str, Sequence[Grasp]]) -> list[str]:
    """Search from the truth: contacts that fail even so are unlikely to succeed from other starts."""
    row = ["*surface_search, guessed at the truth*"]
    for grasped in contacts.values():
        tally = _tally(method, grasped, _TRUTH)
        row += [f"{tally.rate:.0f}", figure(tally.over_bound)]
    return [*row, "-", "-"]


def _or_likelier(method: Method, contacts: Mapping[str, Sequence[Grasp]]) -> list[str]:
    """Success if poses that explain the heights better than the truth count as right, since heights cannot
    distinguish them.
    """
    row = ["*surface_search, or a pose likelier than the truth*"]
    for noise in NOISES:
        grasped = contacts[noise.name]
        poses = [
            [_pose(method, grasp, start, seed) for seed, grasp in enumerate(grasped)] for start in STARTS
        ]
        row += [" / ".join(f"{success_or_likelier(grasped, noise, found):.0f}" for found in poses), "-"]
    return [*row, "-", "-"]


def _missing_rows(missing: Mapping[str, str]) -> list[list[str]]:
    """Rows of the libraries that were not measured, with the reason."""
    dashes = ["-"] * (2 * len(NOISES) + 2)
    # A table's cell must be one line without vertical bars.
    return [
        [f"{name} ({' '.join(reason.replace('|', '/').split())})", *dashes]
        for name, reason in missing.items()
    ]


def _near_table(
    methods: Mapping[str, Method], others: Sequence[str], contacts: Sequence[Grasp], rounds: int
) -> tuple[Table, list[Target]]:
    """Success and times from near guesses, for a part registered in the previous frame."""
    near = {name: (methods[name], start) for name, (start, _) in _NEAR.items()}
    near |= {name: (methods[name], _CLOSE) for name in others}
    calls = {name: _frames_of(method, contacts, start) for name, (method, start) in near.items()}
    times = time_side_by_side(calls, max(rounds // _ONE_OF, 1), _FRAMES)
    rows = []
    for name, (method, start) in near.items():
        rate = f"{_tally(method, contacts, start).rate:.0f}"
        rows.append([name, start.name, rate, f"{times[name].median_ms:.3f}", f"{times[name].p99_ms:.3f}"])
    head = ["method", "guesses within", "success, %", "median ms", "p99 ms"]
    targets = [
        Target(f"localization, {name}, within {start.name}, median", limit, times[name].median_ms, "ms")
        for name, (start, limit) in _NEAR.items()
    ]
    return Table("near", head, rows), targets


def _budget_table(contacts: Sequence[Grasp], rounds: int) -> Table:
    """Success of the best rung from every start, over all noises, and times from the middle start, by search
    budget.
    """
    usual = next(_params(rung) for rung in rungs_of("register") if rung.name == BEST)
    budgets = sorted({usual.to_dict()["register"]["surface_search"]["budget"], *_BUDGETS}, reverse=True)
    params = {f"{budget}": usual.replace({"register.surface_search.budget": budget}) for budget in budgets}
    methods = {name: _with(each) for name, each in params.items()}
    times = time_side_by_side({name: _one_of(method, contacts) for name, method in methods.items()}, rounds)
    rows = []
    for name, method in methods.items():
        found = [f"{_tally(method, contacts, start).rate:.1f}" for start in STARTS]
        ends = [
            _end(grasp, grasp.guess(STARTS[1], seed), params[name]) for seed, grasp in enumerate(contacts)
        ]
        shares = [f"{100.0 * float(share):.0f}" for share in np.mean(ends, axis=0)]
        took = (f"{times[name].median_ms:.1f}", f"{times[name].p99_ms:.1f}")
        rows.append([name, " / ".join(found), *shares, *took])
    head = ["budget", "success, %", "converged, %", "may have more answers, %", "median ms", "p99 ms"]
    return Table("budgets", head, rows)


def _end(grasp: Grasp, guess: Array, params: Params) -> tuple[bool, bool]:
    """Whether a search converged, and whether it may have more answers; neither if it refuses."""
    try:
        found = grasp.registered(guess, params)
    except Error:
        return False, False
    return found.converged, found.alternatives_cut


def _parts_table(methods: Mapping[str, Method], tallies: Mapping[tuple[str, str, str], Tally]) -> Table:
    """Success by part, from the middle start."""
    rows = []
    for name in methods:
        tally = tallies[name, NOISES[0].name, STARTS[1].name]
        rows.append(
            [name, *(f"{100.0 * float(np.mean(tally.success[press.name])):.0f}" for press in GRASPED)]
        )
    return Table("parts", ["method", *(press.name for press in GRASPED)], rows)


def _targets(tallies: Mapping[tuple[str, str, str], Tally], times: Mapping[str, Times]) -> list[Target]:
    """Targets of the best rung."""
    if BEST not in times:
        return []
    targets = []
    for noise in NOISES:
        for start, limit in zip(STARTS, (99.0, 99.0, 98.0), strict=True):
            rate = tallies[BEST, noise.name, start.name].rate
            what = f"localization, {BEST}, starts within {start.name}, {noise.name}, success"
            targets.append(Target(what, limit, rate, "%", at_most=False))
        error = tallies[BEST, noise.name, STARTS[1].name].over_bound
        targets.append(Target(f"localization, {BEST}, {noise.name}, rms over the bound", 1.05, error, ""))
    targets.append(Target(f"localization, {BEST}, median", 5.0, times[BEST].median_ms, "ms"))
    targets.append(Target(f"localization, {BEST}, p99", 20.0, times[BEST].p99_ms, "ms"))
    return targets


def _tally(method: Method, contacts: Sequence[Grasp], start: Start) -> Tally:
    tally = Tally()
    for seed, grasp in enumerate(contacts):
        tally.add(grasp, _pose(method, grasp, start, seed))
    return tally


def _pose(method: Method, grasp: Grasp, start: Start, seed: int) -> Array | None:
    return _tried(method, grasp, grasp.guess(start, seed))


def _tried(method: Method, grasp: Grasp, guess: Array) -> Array | None:
    """A method's pose, or None if it refuses."""
    try:
        return method(grasp, guess)
    except (Error, np.linalg.LinAlgError, RuntimeError, ValueError):
        return None


def _one_of(method: Method, contacts: Sequence[Grasp]) -> Callable[[int], object]:
    # Drawing a guess takes as long as the fastest method.
    guesses = [grasp.guess(STARTS[1], turn) for turn, grasp in enumerate(contacts)]

    def call(turn: int) -> object:
        at = turn % len(contacts)
        return _tried(method, contacts[at], guesses[at])

    return call


def _frames_of(method: Method, contacts: Sequence[Grasp], start: Start) -> Callable[[int], object]:
    """Register some contacts of all parts and noises several times in a row, each time from another guess."""
    some = contacts[::_ONE_OF]
    guesses = [[grasp.guess(start, turn) for turn in range(_FRAMES)] for grasp in some]

    def call(turn: int) -> object:
        at, frame = turn // _FRAMES % len(some), turn % _FRAMES
        return _tried(method, some[at], guesses[at][frame])

    return call


def _native(rung: Rung) -> Method:
    return _with(_params(rung))


def _params(rung: Rung) -> Params:
    """Settings for guesses with larger errors than usual."""
    return rung.params().replace({"register.advanced.search_radius_mm": 8.0})


def _with(params: Params) -> Method:
    """Register with all sensed data of the contact."""
    return lambda grasp, guess: grasp.localized(guess, params)
