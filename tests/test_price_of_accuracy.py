"""The front of accuracy against time of whole pipelines: `gelstereo frontier pipeline`."""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

import gelstereo
from gelstereo.geometry import se3_exp
from gelstereo_bench.frontier.page import check_page
from gelstereo_bench.frontier.pipeline import budgets, locators, study, topic
from gelstereo_bench.frontier.pipeline.budget_report import lost_and_won, time_share
from gelstereo_bench.frontier.pipeline.budgets import Budget
from gelstereo_bench.frontier.pipeline.cases import Case, Take
from gelstereo_bench.frontier.pipeline.front import is_near_front, is_on_front
from gelstereo_bench.frontier.pipeline.intervals import Interval, bootstrap, wilson
from gelstereo_bench.frontier.pipeline.kept import Kept, key_of
from gelstereo_bench.frontier.pipeline.labels import label_corners
from gelstereo_bench.frontier.pipeline.locators import combined
from gelstereo_bench.frontier.pipeline.sensing import is_lost, measure_sensing
from gelstereo_bench.frontier.pipeline.sensors import OPENCV, PAPER, sensing_methods, sensing_preset
from gelstereo_bench.frontier.pipeline.simulated import SIMULATED, simulated_cases
from gelstereo_bench.frontier.pipeline.summary import Point, depth_point, front_of, named_of, pose_point
from gelstereo_bench.frontier.pipeline.tables import PIPELINE_SECTIONS
from gelstereo_bench.frontier.pipeline.topic import Extent, run_pipeline
from gelstereo_bench.frontier.pipeline.traced import traced_cases

#: Few different values, so that ties are frequent.
VALUES = st.sampled_from([0.5, 1.0, 1.01, 1.05, 1.2, 2.0, 5.0, float("inf"), float("nan")])
METHODS = st.lists(st.tuples(VALUES, VALUES), max_size=12)


def beats(other: tuple[float, float], own: tuple[float, float]) -> bool:
    """At least as good in both, and better in one; a method without figures beats nothing."""
    as_good = other[0] <= own[0] and other[1] <= own[1]
    return bool(np.all(np.isfinite(other))) and as_good and other != own


@given(METHODS)
def test_the_front_is_what_no_other_method_beats(methods: list[tuple[float, float]]) -> None:
    found = is_on_front([ms for ms, _ in methods], [error for _, error in methods])
    expected = [
        bool(np.all(np.isfinite(own))) and not any(beats(other, own) for other in methods) for own in methods
    ]
    assert found.tolist() == expected


@given(METHODS)
def test_a_price_without_a_gain_is_off_the_near_front(methods: list[tuple[float, float]]) -> None:
    def is_wasted(own: tuple[float, float]) -> bool:
        return any(
            (other[0] < 0.9 * own[0] and other[1] <= 1.02 * own[1])
            or (other[1] < 0.9 * own[1] and other[0] <= 1.02 * own[0])
            for other in methods
        )

    found = is_near_front([ms for ms, _ in methods], [error for _, error in methods])
    assert found.tolist() == [bool(np.all(np.isfinite(own))) and not is_wasted(own) for own in methods]


@given(st.integers(0, 60), st.integers(1, 60))
def test_success_has_the_score_interval(successes: int, runs: int) -> None:
    successes = min(successes, runs)
    found = wilson(successes, runs)
    other = binomtest(successes, runs).proportion_ci(method="wilson")
    assert (found.low, found.high) == pytest.approx((other.low, other.high), abs=1e-6)
    assert found.low <= found.value <= found.high


def test_the_bootstrap_covers_the_truth() -> None:
    random = np.random.default_rng(5)

    def mean(groups: Any) -> float:
        return float(np.mean([np.mean(seeds) for seeds in groups]))

    covered = []
    for _ in range(60):
        found = bootstrap([[random.normal(size=2) for _ in range(12)] for _ in range(2)], mean)
        assert found.low <= found.value <= found.high
        covered.append(found.low <= 0.0 <= found.high)
    # Of 60 intervals of 95 %, fewer than 50 cover with a probability of 1e-4; those of 12 seeds are narrow.
    assert 48 <= sum(covered) <= 60
    same = bootstrap([[np.ones(3)] * 4], mean)
    assert same.low == same.value == same.high == 1.0


BOXES = st.lists(
    st.tuples(st.floats(60.0, 940.0), st.floats(60.0, 940.0), st.floats(10.0, 90.0), st.floats(5.0, 15.0)),
    max_size=8,
)


@given(BOXES)
def test_labels_cover_neither_each_other_nor_points(boxes: list[tuple[float, float, float, float]]) -> None:
    values = np.array(boxes).reshape(-1, 4)
    anchors, sizes = values[:, :2], values[:, 2:]
    points = np.hstack([anchors - 5.0, anchors + 5.0])
    corners = label_corners(anchors, sizes, (0.0, 0.0, 1000.0, 1000.0), points)
    labels = np.hstack([corners, corners + sizes])
    assert np.all(labels[:, :2] >= 0.0) and np.all(labels[:, 2:] <= 1000.0)
    for one, other in [*itertools.combinations(labels, 2), *itertools.product(labels, points)]:
        apart = one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]
        assert apart


def test_results_survive_an_interruption_and_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "out" / "pipeline.jsonl"
    with Kept(path) as kept:
        kept.add("a", {"scene": "x"}, {"value": 1})
        kept.add("b", {"scene": "x"}, {"value": 2})
        with pytest.raises(gelstereo.Error, match="in use by another run"):
            Kept(path)
    path.write_bytes(path.read_bytes() + b'{"key": "c", "resu')
    with Kept(path) as kept:
        assert kept.get("a") == {"value": 1} and kept.get("c") is None
        kept.add("c", {}, 3)
    with Kept(path) as kept:
        assert kept.get("b") == {"value": 2} and kept.get("c") == 3
    path.write_text(path.read_text().replace('"key": "b"', '"kex": "b"'))
    with pytest.raises(gelstereo.Error, match="line 2, is damaged"):
        Kept(path)
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1}) != key_of({"a": 1, "b": 3})


# Scenes


@pytest.mark.parametrize("case", simulated_cases(), ids=lambda case: case.name)
def test_simulated_parts_lie_where_the_truth_says(case: Case) -> None:
    take, contact = case.take(3), next(each for each in SIMULATED if each.name == case.name)
    assert not take.shots[0].touching.any()
    (index,) = take.judged
    shot = take.shots[index]
    assert shot.patch is not None and shot.body is not None and shot.t_sensor_object is not None
    back = (shot.patch.points_mm - shot.t_sensor_object[:3, 3]) @ shot.t_sensor_object[:3, :3]
    assert np.abs(shot.body.template.closest(back).distances_mm).max() < 1e-3
    deepest = float((take.shots[0].points_mm - shot.points_mm)[:, 2].max())
    # The deepest marker is at most a pitch from the deepest point of the part.
    assert 0.4 * contact.depth_mm < deepest <= contact.depth_mm + 1e-6
    assert shot.pose_error_mm(shot.t_sensor_object) < 1e-9
    another = case.take(4).shots[index].t_sensor_object
    assert another is not None and np.abs(another - shot.t_sensor_object).max() > 1e-3


def test_scenes_are_what_their_names_say() -> None:
    takes = {case.name: case.take(1) for case in simulated_cases()}
    assert len(takes["dense lattice"].shots[0].points_mm) == 45**2
    assert [name for name, take in takes.items() if take.is_layered] == ["refraction"]
    assert takes["low light"].shots[0].left.max() < 100 < takes["small part"].shots[0].left.max()
    first, last = (takes["deep press, shear"].shots[k].points_mm for k in (0, -1))
    # Markers that stick to the part move along with it.
    assert np.abs((last - first)[:, 0]).max() > 0.9


@pytest.mark.parametrize("case", traced_cases()[3:6], ids=lambda case: case.name)
def test_path_traced_parts_lie_where_the_truth_says(case: Case) -> None:
    take = case.take(1)
    assert take.judged and take.is_layered
    for index in take.judged:
        shot = take.shots[index]
        assert shot.patch is not None and shot.body is not None and shot.t_sensor_object is not None
        back = (shot.patch.points_mm - shot.t_sensor_object[:3, 3]) @ shot.t_sensor_object[:3, :3]
        off_mm = shot.body.template.closest(back).distances_mm
        # Gel solved by finite elements of 0.3 mm lies on the part to some micrometres.
        assert np.sqrt(np.mean(off_mm**2)) < 0.012


def test_only_the_half_for_work_is_used() -> None:
    from outside.images import names

    assert len(traced_cases()) == len(names("w")) == 8


def test_without_the_rendered_pairs_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "outside"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "outside", None)
    with pytest.raises(gelstereo.Error, match="PYTHONPATH=bench"):
        traced_cases()


def test_a_pose_that_a_symmetry_maps_onto_the_truth_is_right() -> None:
    case = next(case for case in simulated_cases() if case.name == "symmetric part")
    take = case.take(1)
    shot = take.shots[take.judged[0]]
    assert shot.t_sensor_object is not None
    for sixths, limit in ((1, 1e-6), (2, 1e-6)):
        turned = shot.t_sensor_object @ se3_exp([0.0, 0.0, sixths * np.pi / 3.0, 0.0, 0.0, 0.0])
        assert shot.pose_error_mm(turned) < limit
    off = shot.t_sensor_object @ se3_exp([0.0, 0.0, np.deg2rad(10.0), 0.0, 0.0, 0.0])
    assert shot.pose_error_mm(off) > 0.1


# Methods


def few_methods() -> list[Any]:
    """Presets fast and balanced, the paper's method, and OpenCV."""
    wanted = ("fast", "balanced")
    return [m for m in sensing_methods() if set(sensing_preset(m)) & set(wanted) or m.name in (PAPER, OPENCV)]


def test_all_combinations_and_all_presets_are_measured() -> None:
    methods = sensing_methods()
    assert len([m for m in methods if m.rungs]) == 6 * 3 * 3
    presets = [name for method in methods for name in sensing_preset(method)]
    assert sorted(presets) == ["balanced", "exact", "fast"]
    combinations, _ = combined([m for m in methods if sensing_preset(m) or m.name == PAPER])
    named = [each for each in combinations if each.params is not None]
    for name in ("paper", "fast", "balanced", "exact"):
        whole = gelstereo.Params.preset(name).to_toml()
        assert sum(each.params.to_toml() == whole for each in named if each.params) == 1


def test_what_assumes_straight_light_receives_the_positions_at_rest() -> None:
    take = next(case for case in simulated_cases() if case.name == "refraction").take(1)
    records = measure_sensing(take, few_methods(), 1)
    rms_um = {name: np.sqrt(each["squared_um2"] / each["markers"]) for name, each in records.items()}
    assert not any(is_lost(record) for record in records.values())
    # Depths behind the layers are about 30 % too small; positions themselves are off by 2.7 mm.
    assert 20.0 < rms_um[PAPER] < 300.0 and 20.0 < rms_um[OPENCV] < 300.0
    assert all(error < 12.0 for name, error in rms_um.items() if name not in (PAPER, OPENCV))
    assert all(len(record["ms"]) == len(take.shots) - 1 for record in records.values())


def test_a_refused_frame_and_lost_markers_are_no_measurement() -> None:
    record = {"refused": "", "counted": 100, "markers": 95}
    assert not is_lost(record)
    assert is_lost(record | {"refused": "too dark"})
    assert is_lost(record | {"markers": 89}) and is_lost(record | {"counted": 0, "markers": 0})


# Points


def no_take(seed: int) -> Take:
    raise AssertionError("records are given")


def sensed(squared_um2: float, ms: float, refused: str = "") -> dict[str, Any]:
    counts = {"markers": 100, "counted": 100, "contact": [8, 10, 10]}
    return {"squared_um2": 100.0 * squared_um2, "ms": [ms, ms, 9.0 * ms], "refused": refused, **counts}


def test_a_point_is_the_geometric_mean_over_scenes_that_worked() -> None:
    method = next(m for m in sensing_methods() if "fast" in sensing_preset(m))
    cases = [Case(name, "simulated", no_take) for name in ("a", "b", "c")]
    blocks = {
        "a": [{method.name: sensed(4.0, 1.0)}, {method.name: sensed(4.0, 1.0)}],
        "b": [{method.name: sensed(100.0, 4.0)}, {method.name: sensed(300.0, 4.0)}],
        "c": [{method.name: sensed(1.0, 2.0)}, {method.name: sensed(1.0, 2.0, "too dark")}],
    }
    two = depth_point(method, cases[:2], blocks)
    assert two.error.value == pytest.approx(np.sqrt(2.0 * np.sqrt(200.0)))
    assert two.error.low < two.error.value < two.error.high and two.ms == pytest.approx(2.0)
    assert two.is_complete and two.label == "fast"
    three = depth_point(method, cases, blocks)
    assert three.error.value == two.error.value and not three.is_complete
    assert three.ms == pytest.approx(2.0)


def test_a_refusal_is_a_failure_and_both_times_count() -> None:
    methods = [m for m in sensing_methods() if m.name == PAPER]
    (each,), _ = combined(methods)
    case = Case("a", "simulated", no_take)
    sensing = {"a": [{PAPER: sensed(1.0, 2.0)}]}
    locating = {"a": [{each.name: {"error_mm": [0.1, 0.2, None], "ms": [3.0, 5.0]}}]}
    point = pose_point(each, [case], sensing, locating)
    assert point.success is not None and point.success.value == pytest.approx(1.0 / 3.0)
    assert point.error.value == 0.2 and point.ms == pytest.approx(2.0 + 4.0)
    nothing = {"a": [{each.name: {"error_mm": [None, None], "ms": []}}]}
    point = pose_point(each, [case], sensing, nothing)
    assert np.isinf(point.error.value) and not point.is_complete and point.label == "paper"


def point(name: str, ms: float, error: float, presets: tuple[str, ...] = (), works: bool = True) -> Point:
    scene = {"a": (error if works else float("nan"), 1.0)}
    return Point(name, name, "fit", presets, ms, Interval(error, error, error), None, scene)


def test_names_are_given_to_presets_and_to_steps_of_the_front() -> None:
    points = [
        point("slow", 9.0, 5.0),
        point("best", 8.0, 1.0),
        point("hardly better", 3.0, 9.5),
        point("fast", 1.0, 10.0),
        point("preset", 7.0, 4.0, ("balanced",)),
        point("fails", 0.1, 0.1, works=False),
    ]
    on_front = {each.name for each, flag in zip(points, front_of(points), strict=True) if flag}
    assert on_front == {"fast", "hardly better", "preset", "best"}
    assert [each.name for each in named_of(points)] == ["fast", "preset", "best"]
    # What differs from a preset by chance alone is not named besides it.
    alike = [*points, point("like the preset", 6.9, 3.99)]
    assert front_of(alike)[-1] and [each.name for each in named_of(alike)] == ["fast", "preset", "best"]


def test_budgets_are_compared_by_pairs() -> None:
    usual = Budget(success=[True, True, False, True], ms=[10.0, 20.0, 30.0, 40.0])
    other = Budget(success=[True, False, True, False], ms=[5.0, 10.0, 15.0, 80.0])
    assert lost_and_won(other, usual) == (2, 1) and lost_and_won(usual, usual) == (0, 0)
    assert time_share(other, usual) == 0.5 and time_share(usual, usual) == 1.0
    # A refused search has no time, so pairs cannot be told.
    assert np.isnan(time_share(Budget(success=[False], ms=[]), usual))


# The topic


TINY = Extent(every=1, seeds=1, traced_seeds=1, starts=1, budget_seeds=1, law_seeds=1)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder of pages, and few scenes and methods; other libraries are absent."""
    missing = {"Open3D": "open3d is not | installed"}
    monkeypatch.setattr(topic, "simulated_cases", lambda: simulated_cases()[4:5])
    monkeypatch.setattr(topic, "traced_cases", lambda: traced_cases()[3:4])
    monkeypatch.setattr(topic, "sensing_methods", few_methods)
    monkeypatch.setattr(locators, "rivals", lambda: ({}, missing))
    monkeypatch.setattr(budgets, "BUDGETS", (60_000, 370_000))
    monkeypatch.setattr(budgets, "GRASPED", budgets.GRASPED[:1])
    monkeypatch.setattr(budgets, "NOISES", budgets.NOISES[:1])
    monkeypatch.setattr(budgets, "_laws", lambda: [("none", "round peg")])
    (tmp_path / "pictures").mkdir()
    return tmp_path


def test_the_topic_fills_its_page_and_resumes(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[str] = []

    def counted(name: str) -> None:
        inner = getattr(study, name)

        def call(*arguments: Any) -> Any:
            if len(measured) == 1:
                measured.append("stopped")
                raise KeyboardInterrupt
            measured.append(name)
            return inner(*arguments)

        monkeypatch.setattr(study, name, call)

    counted("measure_sensing")
    counted("measure_locating")
    results = tiny / "out"
    with pytest.raises(KeyboardInterrupt):
        run_pipeline(tiny, results, TINY)
    page = run_pipeline(tiny, results, TINY)
    assert measured == ["measure_sensing", "stopped", "measure_sensing"] + 2 * ["measure_locating"]
    run_pipeline(tiny, results, TINY)
    assert len(measured) == 5
    stages = [json.loads(line)["stage"] for line in (results / "pipeline.jsonl").read_text().splitlines()]
    assert stages == 2 * ["sensing"] + 2 * ["locating"] + 3 * ["budgets"]
    check_page(page, PIPELINE_SECTIONS)
    text = page.read_text()
    assert (
        "**preset fast**" in text
        and "| 370000 (default) |" in text
        and "Open3D (open3d is not / installed)" in text
    )
    for name in ("price-of-accuracy.png", "search-budget.png"):
        assert (tiny / "pictures" / name).stat().st_size > 20_000
