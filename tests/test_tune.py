"""`gelstereo tune`: its search against brute force, its figures against truth, and its refusals.

Times come from a counter in place of a clock, so that no test depends on the machine.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

import gelstereo as gs
from gelstereo.tune import (
    Conditions,
    Figures,
    Goal,
    Outcome,
    Setting,
    StaleCache,
    TuneError,
    tune,
)
from gelstereo.tune.cache import Store
from gelstereo.tune.front import front, undominated
from gelstereo.tune.halving import halve
from gelstereo.tune.intervals import of_share, of_take
from gelstereo.tune.measure import outcome_of
from gelstereo.tune.predict import base_settings, predicted_front, settings_to_measure
from gelstereo.tune.run import efforts
from gelstereo.tune.rungs import combinations
from gelstereo_bench.frontier.tuning import Measured, searched, tuned

SETTINGS = [Setting.of(rungs) for rungs in combinations()]
#: Small whole numbers, so that equal sums and ties occur.
MEASURE = st.integers(0, 6).map(float)
POINT = st.tuples(MEASURE, MEASURE, MEASURE)


# The front


def dominates(one: tuple[float, ...], other: tuple[float, ...], margin: float) -> bool:
    return one[0] + margin <= other[0] and all(a <= b for a, b in zip(one[1:], other[1:], strict=True))


@given(points=st.lists(POINT, max_size=30), margin=st.sampled_from([0.0, 1.0, 2.5]))
def test_what_is_removed_is_dominated_by_what_is_kept(points: list[tuple[float, ...]], margin: float) -> None:
    indices = undominated(points, margin)
    kept = [points[index] for index in indices]
    assert not any(dominates(one, other, margin) for one, other in itertools.permutations(kept, 2))
    removed = [point for index, point in enumerate(points) if index not in indices]
    assert all(any(dominates(one, point, margin) for one in kept) for point in removed)


@given(points=st.lists(POINT, min_size=1, max_size=10), bad=st.sampled_from([math.nan, math.inf]))
def test_what_could_not_be_measured_is_never_on_the_front(
    points: list[tuple[float, ...]], bad: float
) -> None:
    assert undominated([*points, (0.0, bad, 0.0)]) == undominated(points)


@given(
    stages=st.lists(st.lists(POINT, min_size=1, max_size=5), min_size=1, max_size=4),
    margin=st.sampled_from([0.0, 1.0, 2.5]),
)
def test_dynamic_programming_finds_the_front_of_all_paths(
    stages: list[list[tuple[float, ...]]], margin: float
) -> None:
    def add(state: tuple[float, ...], option: tuple[float, ...]) -> tuple[float, ...]:
        # Monotone, but not a sum: the last measure depends on the one before.
        return state[0] + option[0], state[1] + option[1], state[2] + option[2] * (1.0 + state[1])

    def total(path: Iterable[tuple[float, ...]]) -> tuple[float, ...]:
        state = (0.0, 0.0, 0.0)
        for option in path:
            state = add(state, option)  # type: ignore[assignment]
        return state

    every = [total(path) for path in itertools.product(*stages)]
    found = front(stages, (0.0, 0.0, 0.0), add, lambda state: state, margin)
    assert {state for _, state in found} == {every[index] for index in undominated(every, margin)}
    assert all(total(path) == state for path, state in found)


# Successive halving


@given(values=st.lists(st.integers(-50, 50), min_size=1, max_size=20, unique=True), rounds=st.integers(1, 5))
def test_halving_finds_the_best_where_ranks_are_true(values: list[int], rounds: int) -> None:
    sizes = []

    def ranks(kept: list[int], effort: int) -> list[tuple[float, ...]]:
        sizes.append(len(kept))
        return [(float(value),) for value in kept]

    found = halve(values, list(range(1, rounds + 1)), ranks)  # type: ignore[arg-type]
    assert found[0] == min(values)
    assert sizes == [-(-len(values) // 2**number) for number in range(rounds)]


@given(first=st.integers(1, 9), more=st.integers(0, 40))
def test_efforts_double_up_to_all_takes(first: int, more: int) -> None:
    found = efforts(first, first + more)
    assert found[0] == first and found[-1] == first + more
    assert all(a < b <= 2 * a for a, b in itertools.pairwise(found))


# Goals


def test_a_goal_without_a_limit_or_sense_is_refused() -> None:
    with pytest.raises(TuneError, match="at least one of budget_ms"):
        Goal()
    for wrong in ({"budget_ms": 0.0}, {"error_um": math.nan}, {"success": 101.0}, {"budget_ms": -1.0}):
        with pytest.raises(TuneError, match="valid is"):
            Goal(**wrong)


OUTCOME = st.builds(
    Outcome,
    time_ms=st.floats(0.1, 10.0),
    height_um=st.floats(0.1, 10.0),
    pose_um=st.floats(0.1, 10.0),
    success=st.floats(0.0, 1.0),
)
LIMIT = st.none() | st.floats(0.1, 10.0)


@given(budget_ms=LIMIT, error_um=LIMIT, success=st.none() | st.floats(1.0, 100.0), outcome=OUTCOME)
def test_an_outcome_keeps_the_limits_or_says_which_it_misses(
    budget_ms: float | None, error_um: float | None, success: float | None, outcome: Outcome
) -> None:
    assume((budget_ms, error_um, success) != (None, None, None))
    goal = Goal(budget_ms, error_um, success)
    keeps = (budget_ms is None or outcome.time_ms <= budget_ms) and (
        error_um is None or outcome.error_um <= error_um
    )
    percent = 100.0 * (outcome.success or 0.0)
    if success is not None:
        assume(abs(percent - success) > 1e-6)  # else it depends on rounding
    keeps = keeps and (success is None or percent >= success)
    assert (goal.excess(outcome) == 0.0) == keeps == (goal.misses(outcome) == [])


# Intervals


@given(trials=st.integers(1, 500), data=st.data())
def test_interval_of_a_share_is_wilsons(trials: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, trials))
    found = of_share(successes, trials)
    expected = stats.binomtest(successes, trials).proportion_ci(0.95, "wilson")
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-4)


@given(values=st.lists(st.floats(0.5, 2.0), min_size=2, max_size=13), scale=st.floats(0.1, 10.0))
def test_interval_of_a_take_is_that_of_student(values: list[float], scale: float) -> None:
    found = of_take([scale * value for value in values])
    logs = np.log(values)
    half = stats.t.ppf(0.975, len(values) - 1) * logs.std(ddof=1) * math.sqrt(1.0 + 1.0 / len(values))
    expected = scale * np.exp(logs.mean() + np.array([-half, half]))
    assert (found.low, found.high) == pytest.approx(tuple(expected), rel=1e-2)


def test_one_take_says_nothing_about_another() -> None:
    assert (of_take([3.0]).low, of_take([3.0]).high) == (0.0, math.inf)


# Kept measurements

CONDITIONS = Conditions("processor", "2", "640x480", "25x25", "1.0", "a" * 64, "b" * 64, "none")


@given(changed=st.sets(st.sampled_from(list(vars(CONDITIONS))), min_size=1), which=st.booleans())
def test_measurements_of_other_conditions_are_refused(
    tmp_path_factory: pytest.TempPathFactory, changed: set[str], which: bool
) -> None:
    path = tmp_path_factory.mktemp("cache") / "kept.json"
    Store(path, CONDITIONS).keep({"a": 1})
    other = replace(CONDITIONS, **dict.fromkeys(changed, "another"))
    with pytest.raises(StaleCache, match="--measure-again") as caught:
        Store(path, other)
    assert all(name.replace("_", " ") in str(caught.value) for name in changed)
    assert Store(path, CONDITIONS).values == {"a": 1}
    Store(path, other, measure_again=True).keep({"b": 2})
    assert Store(path, other).values == {"b": 2}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"values": {}}', '{"conditions": 3, "values": {}}'])
def test_a_file_of_something_else_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "kept.json").write_text(text)
    with pytest.raises(StaleCache, match="no measurements of gelstereo"):
        Store(tmp_path / "kept.json", CONDITIONS)


# Prediction and search, in a world where the stages are independent


def named(setting: Setting) -> list[str]:
    return [f"{rung.stage}: {rung.name}" for rung in setting.rungs]


class World:
    """A laboratory whose figures follow from one number per rung; it counts what is asked for."""

    part = object()
    base = gs.Params.preset("balanced")
    takes = 8
    is_simulated = True

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.names = list(dict.fromkeys(name for setting in SETTINGS for name in named(setting)))
        count = len(self.names)
        self.times = dict(zip(self.names, random.uniform(0.1, 4.0, count), strict=True))
        self.errors = dict(zip(self.names, random.uniform(1.0, 40.0, count), strict=True))
        # The first way to detect is the noisiest one.
        self.errors[self.names[0]] = 60.0
        self.failures = dict(zip(self.names, random.integers(0, 40, count), strict=True))
        self.share = float(random.uniform())
        self.asked: set[tuple[Setting, int]] = set()

    def figures(self, setting: Setting) -> Figures:
        names = named(setting)
        height = self.errors[names[0]] + self.errors[names[1]]
        usual = sum(self.errors[name] for name in named(base_settings(self.base, False)[0])[:2])
        sense_ms = sum(self.times[name] for name in names[:3])
        if setting.register is None:
            return Figures(sense_ms, height)
        pose = self.errors[names[2]] * self.errors[names[3]]
        successes = 1000 - int(self.failures[names[3]])
        share = 1.0 - self.share + self.share * height / usual
        return Figures(sense_ms, height, self.times[names[3]], pose * share, successes, 1000)

    def measure(self, settings: Iterable[Setting], takes: int) -> dict[Setting, list[Figures]]:
        found = list(settings)
        self.asked |= {(setting, take) for setting in found for take in range(takes)}
        return {setting: [self.figures(setting)] * takes for setting in found}

    def check(self, setting: Setting) -> list[Figures]:
        return [self.figures(setting)] * 4


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_predictions_are_exact_where_stages_are_independent(seed: int) -> None:
    world = World(seed)
    base = base_settings(world.base, True)[0]
    found = predicted_front(world.measure(settings_to_measure(base), 2), base)
    for setting, predicted in found:
        true = outcome_of([world.figures(setting)])
        np.testing.assert_allclose(
            [predicted.time_ms, predicted.height_um, predicted.pose_um, predicted.success],
            [true.time_ms, true.height_um, true.pose_um, true.success],
            rtol=1e-9,
        )


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), data=st.data())
def test_tuning_finds_the_best_of_all_with_a_tenth_of_the_measurements(
    seed: int, data: st.DataObject
) -> None:
    world = World(seed)
    every = [outcome_of([world.figures(setting)]) for setting in SETTINGS]
    some = data.draw(st.sampled_from(every))
    kinds = [Goal(some.time_ms), Goal(None, some.error_um), Goal(success=100.0 * (some.success or 0.0))]
    goal = data.draw(st.sampled_from([*kinds, Goal(some.time_ms, some.error_um)]))
    found = tune(world, goal)  # type: ignore[arg-type]
    best = min(every, key=goal.rank)
    assert found.is_reached and found.is_confirmed
    assert goal.cost(found.outcome) <= goal.cost(best) * (1.0 + 1e-9)
    assert len(world.asked) <= len(SETTINGS) * world.takes // 10


class Treacherous(World):
    """Nothing fails but the cheapest registrations, and these only after the first take."""

    def measure(self, settings: Iterable[Setting], takes: int) -> dict[Setting, list[Figures]]:
        found = super().measure(settings, takes)
        return {setting: self.spoilt(setting, figures) for setting, figures in found.items()}

    def spoilt(self, setting: Setting, figures: list[Figures]) -> list[Figures]:
        whole = [replace(each, successes=each.trials) for each in figures]
        if setting.register is None or setting.register.name != "surface_close":
            return whole
        failed = {"successes": 900, "pose_um2": 1e6}
        return [whole[0], *(replace(each, **failed) for each in whole[1:])]  # type: ignore[arg-type]

    def check(self, setting: Setting) -> list[Figures]:
        return self.spoilt(setting, super().check(setting))


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), limit=st.sampled_from([Goal(success=99.0), Goal(error_um=100.0)]))
def test_failures_that_the_first_take_does_not_show_are_avoided(seed: int, limit: Goal) -> None:
    world = Treacherous(seed)
    world.times = {name: 0.1 if "surface_close" in name else 1.0 + time for name, time in world.times.items()}
    found = tune(world, limit)  # type: ignore[arg-type]
    true = World.measure(world, SETTINGS, world.takes)
    safe = [
        outcome_of(world.spoilt(setting, figures)).time_ms
        for setting, figures in true.items()
        if limit.excess(outcome_of(world.spoilt(setting, figures))) == 0.0
    ]
    assert found.is_reached and found.setting.register.name != "surface_close"  # type: ignore[union-attr]
    assert found.outcome.time_ms <= min(safe) * (1.0 + 1e-9)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_goal_out_of_reach_gets_the_nearest_settings_and_says_so(seed: int) -> None:
    world = World(seed)
    goal = Goal(error_um=1e-3)
    found = tune(world, goal)  # type: ignore[arg-type]
    least = min(outcome_of([world.figures(setting)]).error_um for setting in SETTINGS)
    assert not found.is_reached and found.outcome.error_um == pytest.approx(least)
    assert "instead of at most 0.001" in str(found)


# The benchmark


class InOrder:
    """Asks for every setting once."""

    def __init__(self) -> None:
        self._settings = iter(SETTINGS)

    def next(self) -> Setting:
        return next(self._settings)

    def tell(self, outcome: Outcome) -> None:
        assert outcome.success is not None


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_benchmark_finds_no_regret_where_predictions_are_exact(seed: int) -> None:
    world = World(seed)
    table = Measured("world", world, 46)  # type: ignore[arg-type]
    table.figures = world.measure([*SETTINGS, *(setting.sensing for setting in SETTINGS)], world.takes)
    for goal in table.goals():
        own = tuned(table, goal)
        assert own.regrets[0] < 1e-9 and own.shares[0] < 0.1
        whole = searched(table, goal, InOrder())  # type: ignore[arg-type]
        # Everything asked for costs as much as exhaustive search, and has no regret.
        assert whole.shares[-1] == pytest.approx(1.0) and whole.regrets[-1] == 0.0
        assert whole.share_of(0.0) <= 1.0 + 1e-9 and whole.regret_at(2.0) == 0.0
