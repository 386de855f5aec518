"""The insertion: holes against brute force, chances against closed forms, robot errors, physics, and whole
trials.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from gelstereo import Error
from gelstereo.geometry import se3_exp, se3_log
from gelstereo.view.html import Figure, Grid
from gelstereo_bench.experiments.insertion import EXPERIMENT, analysis, physics_check, report, trials
from gelstereo_bench.experiments.insertion.analysis import Verdict
from gelstereo_bench.experiments.insertion.chance import SAMPLES, adjoint, chance, matters, weakest
from gelstereo_bench.experiments.insertion.grasp import GRASPED, GraspRanges, Hold, fit_of, guesses, lie
from gelstereo_bench.experiments.insertion.hole import Hole
from gelstereo_bench.experiments.insertion.physics import Hand, descend
from gelstereo_bench.experiments.insertion.physics_check import limit
from gelstereo_bench.experiments.insertion.robot import RobotErrors, over_hole
from gelstereo_bench.experiments.insertion.trial import run

FITS = {letter: fit_of(letter) for letter in GRASPED}

letters = st.sampled_from(sorted(GRASPED))
small = st.floats(-0.02, 0.02)
lengths = st.floats(-0.4, 0.4)
twists = st.tuples(small, small, small, lengths, lengths, st.floats(-5.0, 5.0)).map(np.array)


def pose(twist: np.ndarray) -> np.ndarray:
    return np.asarray(se3_exp(np.asarray(twist, float)))


def dense_room_mm(letter: str, placed: np.ndarray) -> float:
    """Room of a part by looking at very many points of its edges instead of at where they pass the mouth."""
    fit = FITS[letter]
    share = np.linspace(0.0, 1.0, 4001)[:, None, None]
    ends = fit.end.vertices_mm[fit.end.edges]
    # Only edges that reach the inserted end.
    ends = ends[ends[..., 2].max(axis=1) > fit.hole.mouth_mm - 1.0]
    points = (ends[:, 0] + share * (ends[:, 1] - ends[:, 0])).reshape(-1, 3) @ placed[:3, :3].T + placed[
        :3, 3
    ]
    points[:, 2] += fit.hole.tip_mm - points[:, 2].max()
    below = points[points[:, 2] >= fit.hole.mouth_mm][:, :2]
    return float(np.min(fit.hole.offsets_mm - (below @ fit.hole.normals.T).max(axis=0)))


@pytest.mark.parametrize("letter", sorted(GRASPED))
def test_the_ideal_part_has_half_the_clearance_on_every_side(letter: str) -> None:
    fit = FITS[letter]
    assert fit.room_mm(np.eye(4)) == pytest.approx(0.5 * fit.part.clearance_mm, abs=1e-9)
    # At any height: it is lowered until its tip is at the bottom.
    assert fit.room_mm(pose(np.array([0, 0, 0, 0, 0, 7.0]))) == pytest.approx(
        fit.room_mm(np.eye(4)), abs=1e-9
    )


@settings(max_examples=20)
@given(letter=st.sampled_from(["b", "d"]), twist=twists)
def test_room_agrees_with_very_many_points(letter: str, twist: np.ndarray) -> None:
    # Edges are at most 40 mm long and lean by at most 0.08: points 0.01 mm apart along them miss less than
    # 1e-3 mm.
    placed = pose(twist)
    assert FITS[letter].room_mm(placed) == pytest.approx(dense_room_mm(letter, placed), abs=1e-3)


@given(letter=letters, twist=twists)
def test_many_motions_at_once_have_the_rooms_of_each(letter: str, twist: np.ndarray) -> None:
    fit, motion = FITS[letter], pose(twist * [1, 1, 1, 1, 1, 0])
    (many,) = fit.hole.rooms_mm(fit.end, motion[None])
    # The mouth cuts a part that leans at another height, by the lean times its half width and more.
    lean = float(np.hypot(*twist[:2]))
    assert many == pytest.approx(fit.room_mm(motion), abs=12.0 * lean * lean + 1e-9)


def test_a_shifted_and_a_turned_square_meet_the_walls_where_geometry_says() -> None:
    fit = FITS["b"]
    for shift in (0.0, 0.05, 0.124, 0.2):
        assert fit.room_mm(pose(np.array([0, 0, 0, shift, 0, 0]))) == pytest.approx(0.125 - shift, abs=1e-9)
    for turn in (0.01, 0.05):
        # A corner of a square of half width a, turned: a (cos + sin).
        corner = 4.0 * (math.cos(turn) + math.sin(turn))
        assert fit.room_mm(pose(np.array([0, 0, turn, 0, 0, 0]))) == pytest.approx(4.125 - corner, abs=1e-9)


@pytest.mark.parametrize(
    ("depth_mm", "clearance_mm", "said"), [(0.0, 0.2, "depth"), (50.0, 0.2, "depth"), (9.0, 0.0, "clear")]
)
def test_a_hole_without_sense_is_refused(depth_mm: float, clearance_mm: float, said: str) -> None:
    with pytest.raises(Error, match=said):
        Hole.around(FITS["a"].end, depth_mm, clearance_mm)


@given(twist=twists, other=twists)
def test_the_adjoint_takes_twists_through_poses(twist: np.ndarray, other: np.ndarray) -> None:
    carried = adjoint(pose(other)) @ twist
    there = pose(other) @ pose(twist) @ np.linalg.inv(pose(other))
    assert np.allclose(pose(carried), there, atol=1e-12)


def normal_motions(covariance: np.ndarray, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).multivariate_normal(np.zeros(6), covariance, size=SAMPLES)


@pytest.mark.parametrize("sigma_mm", [0.03, 0.1, 0.3])
def test_chance_of_a_square_that_shifts_is_that_of_two_normals(sigma_mm: float) -> None:
    fit = FITS["b"]
    covariance = np.diag([0, 0, 0, sigma_mm**2, sigma_mm**2, 9.0])
    expected = (2.0 * stats.norm.cdf(0.125 / sigma_mm) - 1.0) ** 2
    # Four standard deviations of a share of that many draws.
    slack = 4.0 * math.sqrt(expected * (1.0 - expected) / SAMPLES) + 1e-9
    assert abs(chance(fit.hole, fit.end, normal_motions(covariance, 5)) - expected) <= slack


@pytest.mark.parametrize(
    ("axis", "sigma", "said"),
    [
        (0, 0.02, "lean about x, known to 1.1 deg"),
        (2, 0.05, "spin about z, known to 2.9 deg"),
        (3, 0.3, "slide along x, known to 0.30 mm"),
        (4, 0.3, "slide along y, known to 0.30 mm"),
    ],
)
def test_the_motion_that_costs_most_is_named(axis: int, sigma: float, said: str) -> None:
    hole, end = FITS["b"].hole, FITS["b"].end
    # About the middle of the hole; what slides along its axis costs nothing.
    about = adjoint(pose(np.array([0, 0, 0, 0, 0, 0.5 * (hole.tip_mm + hole.mouth_mm)])))
    alone = np.diag([1e-8, 1e-8, 1e-8, 1e-4, 1e-4, 25.0])
    alone[axis, axis] = sigma * sigma
    assert weakest(hole, end, about @ alone @ about.T) == said


def test_a_round_pegs_spin_is_never_what_is_known_too_little() -> None:
    hole, end = FITS["a"].hole, FITS["a"].end
    about = adjoint(pose(np.array([0, 0, 0, 0, 0, 0.5 * (hole.tip_mm + hole.mouth_mm)])))
    covariance = np.diag([1e-8, 1e-8, 1.0, 1e-3, 1e-4, 25.0])
    assert weakest(hole, end, about @ covariance @ about.T) == "slide along x, known to 0.03 mm"


def test_spin_and_slide_of_a_round_peg_cost_no_chance() -> None:
    fit = FITS["a"]
    drawn = normal_motions(np.diag([0, 0, 1.0, 0, 0, 25.0]), 3)
    assert chance(fit.hole, fit.end, drawn) == 1.0
    square = FITS["b"]
    assert chance(square.hole, square.end, drawn) < 0.1


@dataclass(frozen=True)
class Free:
    """A direction as a registration gives it: a turn about a point, or a slide; the part's frame."""

    omega: np.ndarray
    v: np.ndarray
    centre_mm: np.ndarray


@pytest.mark.parametrize(
    ("letter", "omega", "v", "centre_mm", "expected"),
    [
        ("a", (0, 0, 0), (0, 0, 1), (4, 0, 15), False),
        ("a", (0, 0, 0), (0, 1, 0), (4, 0, 15), True),
        # About the part's own axis; what a turn about the contact's middle shifts is in v.
        ("a", (0, 0, 1), (0, 4, 0), (4, 0, 15), False),
        ("b", (0, 0, 1), (0, 4, 0), (4, 0, 15), True),
        # A round shaft that rolls about a line beside its axis is carried off it.
        ("c", (0, 0, 1), (0, 0, 0), (4, 0, 15), True),
        ("d", (1, 0, 0), (0, 0, 0), (4, 0, 15), True),
    ],
)
def test_a_free_direction_matters_if_it_keeps_the_part_out(
    letter: str, omega: tuple, v: tuple, centre_mm: tuple, expected: bool
) -> None:
    fit = FITS[letter]
    free = Free(*(np.array(x, float) for x in (omega, v, centre_mm)))
    assert matters(fit.hole, fit.end, free) is expected


@given(truth=twists, found=twists, taught=twists, learned=twists, mount=twists)
def test_a_robot_without_errors_repeats_what_was_taught(
    truth: np.ndarray, found: np.ndarray, taught: np.ndarray, learned: np.ndarray, mount: np.ndarray
) -> None:
    x, y = pose(truth), pose(taught)
    # Found without error, both times: the part stands as taught, whatever is wrong with the mount when
    # nothing turns.
    assert np.allclose(over_hole(x, x, (y, y)), np.eye(4), atol=1e-12)
    assert np.allclose(over_hole(y, y, (y, y), mount=mount), np.eye(4), atol=1e-11)
    # An error that is the same both times, in the part's frame, cancels.
    bias = pose(found)
    assert np.allclose(over_hole(x, x @ bias, (y, y @ bias)), np.eye(4), atol=1e-12)
    # Otherwise the product says it.
    expected = np.linalg.inv(y) @ pose(learned) @ np.linalg.inv(pose(found)) @ x
    assert np.allclose(over_hole(x, pose(found), (y, pose(learned))), expected, atol=1e-12)


def test_robot_errors_have_their_standard_deviations() -> None:
    errors = RobotErrors(0.01, 0.2, 0.02, 0.1).times(2.0)
    draws = np.array([np.concatenate(errors.draw(robot, 3)) for robot in range(4000)])
    sigma = np.repeat([0.02, 0.4, 0.04, 0.2], 3)
    # A standard deviation of 4000 draws is known to 1.1 %.
    assert np.allclose(draws.std(axis=0) / sigma, 1.0, atol=0.05)
    assert np.allclose(errors.draw(7, 1)[0], errors.draw(7, 2)[0])


def verdict(
    chance_predicted: float, room_mm: float, weakest: str = "", matters: tuple[str, ...] = ()
) -> Verdict:
    nothing = np.eye(4)
    pair = (nothing, nothing)
    return Verdict("b", "", {}, nothing, None, nothing, pair, room_mm, chance_predicted, matters, weakest)


def test_a_range_ends_where_the_share_falls_and_is_not_of_one_lucky_grasp() -> None:
    def grasp(angle: float, room_mm: float) -> Verdict:
        return replace(verdict(1.0, room_mm), hold={"roll_rad": angle})

    falls = [grasp(0.01 * k * (-1) ** k, 0.1 if k <= 12 else -0.1) for k in range(1, 21)]
    # 12 of the first 12 go in, and 12 of 13 and 12 of 14; the last that goes in ends the range.
    assert analysis.allowed(falls, "roll_rad", 0.85) == pytest.approx(0.12)
    lucky = [grasp(0.001, 0.1), *(grasp(0.01 * k, -0.1) for k in range(1, 20))]
    assert analysis.allowed(lucky, "roll_rad", 0.85) is None


@given(grasps=st.integers(1, 60), chance_predicted=st.floats(0.01, 0.99))
def test_expected_insertions_of_equal_chances_are_binomial(grasps: int, chance_predicted: float) -> None:
    (found,) = analysis.expected([verdict(chance_predicted, 0.0)] * grasps)
    law = stats.binom(grasps, chance_predicted)
    # A count whose cumulative law is the quantile itself may go either way with round-off.
    for count, quantile in zip(found, (0.025, 0.975), strict=True):
        assert law.cdf(count) >= quantile - 1e-9 and law.cdf(count - 1) <= quantile + 1e-9


def test_a_refusal_begins_with_the_motion_that_matters_and_leaves_harmless_ones_out() -> None:
    free = ("slide along y through (0.0, 0.0, 1.0) mm", "spin about x through (0.0, -0.1, 14.9) mm")
    assert report.reason(verdict(0.1, 0.0, "slide along y, known to 0.30 mm", free)) == (
        "slide along y is too uncertain (no face determines slide along y and spin about x)"
    )
    assert report.reason(verdict(0.1, 0.0, "lean about x, known to 1.1 deg")) == (
        "lean about x is too uncertain"
    )


@given(trials=st.integers(1, 2000), share=st.floats(0.0, 1.0))
def test_intervals_are_wilsons(trials: int, share: float) -> None:
    successes = round(share * trials)
    expected = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    assert np.allclose(analysis.wilson(successes, trials), (expected.low, expected.high), atol=1e-6)


def test_break_even_is_where_a_falling_curve_passes_the_goal() -> None:
    found = analysis.break_even(lambda x: 1.0 - x, 1.0, goal=0.8)
    assert found is not None and abs(found - 0.2) < 1.0 / 2**8
    assert analysis.break_even(lambda _: 0.5, 1.0, goal=0.8) is None
    assert analysis.break_even(lambda _: 1.0, 1.0, goal=0.8) is None


@pytest.mark.parametrize(
    ("twist", "said"),
    [
        ([0, 0, 0, 0.3, 0, 0], "beside the hole by 0.30 mm"),
        ([0, 0, 0.06, 0, 0, 0], "turned by 3.4 deg"),
    ],
)
def test_a_failure_says_its_cause(twist: list[float], said: str) -> None:
    fit = FITS["b"]
    placed = pose(np.array(twist, float))
    assert fit.room_mm(placed) < 0.0
    assert analysis.cause(fit, placed) == said


@pytest.mark.parametrize("letter", sorted(GRASPED))
def test_a_grasp_reaches_into_the_gel_and_is_guessed_from_its_patch(letter: str) -> None:
    part, ranges = GRASPED[letter], GraspRanges()
    surface_mm = FITS[letter].end.vertices_mm
    fine = np.vstack([surface_mm, *(0.5 * (surface_mm[FITS[letter].end.edges].sum(axis=1)),)])
    middle = np.array([4.0, 0.0, 28.7])
    hold = Hold.drawn(part, ranges, np.random.default_rng(4))
    assert abs(hold.pitch_rad) <= ranges.pitch_rad and part.held_mm[0] <= hold.held_mm <= part.held_mm[1]
    t_sensor_object = lie(hold, fine, middle, FITS[letter].hole.tip_mm)
    placed = fine @ t_sensor_object[:3, :3].T + t_sensor_object[:3, 3]
    over = np.all(np.abs(placed[:, :2] - middle[:2]) < 10.0, axis=1)
    assert placed[over, 2].min() == pytest.approx(28.7 - hold.press_mm, abs=1e-9)
    # A patch along the part's axis: the first guess lies along it.
    axis = t_sensor_object[:3, 2]
    along = np.linspace(-8.0, 8.0, 40)[:, None] * axis + [4.0, 0.0, 28.0]
    patch = np.vstack([along, along + 0.5 * np.array([-axis[1], axis[0], 0.0])])
    first = guesses(Hold.nominal(part, ranges), fine, patch, FITS[letter].hole.tip_mm)[0]
    assert np.dot(first[:3, 2], axis) > math.cos(abs(hold.roll_rad) + 0.02)


@pytest.mark.parametrize("letter", ["b", "e"])
def test_physics_lets_in_what_is_aligned_and_stops_what_is_far_off(letter: str) -> None:
    fit = FITS[letter]
    assert descend(fit.hole, fit.end, np.eye(4), Hand(), 25.0) == pytest.approx(fit.part.depth_mm, abs=0.1)
    # Beyond clearance and chamfer.
    aside = pose(np.array([0, 0, 0, 1.5, 0, 0]))
    assert descend(fit.hole, fit.end, aside, Hand(), 25.0) < 1.0
    # A quarter of the time step changes nothing that matters.
    fine = Hand(step_s=0.25 * Hand().step_s)
    assert descend(fit.hole, fit.end, np.eye(4), fine, 25.0) == pytest.approx(fit.part.depth_mm, abs=0.1)


@given(bound=st.floats(0.0, 5.0), halvings=st.integers(1, 12))
def test_a_limit_is_found_to_its_step(bound: float, halvings: int) -> None:
    found = limit(lambda scale: scale <= bound, 4.0, halvings)
    assert found == 4.0 if bound >= 4.0 else found <= bound < found + 4.0 / 2**halvings


@pytest.mark.parametrize("letter", ["b", "e"])
def test_physics_lets_in_what_geometry_just_lets_in(letter: str) -> None:
    fit = FITS[letter]
    twist = np.array([0.004, -0.003, 0.006, 0.0, 0.0, 0.0])
    scale = limit(lambda s: fit.room_mm(pose(s * twist)) >= 0.0, 10.0, 20)
    assert 0.0 < scale < 10.0
    placed = pose(0.98 * scale * twist)
    assert descend(fit.hole, fit.end, placed, Hand(), 25.0) == pytest.approx(fit.part.depth_mm, abs=0.1)


def test_the_report_of_physics_draws_its_table() -> None:
    hands = [name.removeprefix("hand ") for name in physics_check.inputs()]
    held, known = physics_check.trials(2, 1), {"a": [2.0, 4.0], "b": [1.0, 1.0]}
    chosen = [trial for trial in held if trial.configuration["part"] in known]

    def record(letter: str, pose: int) -> dict[str, object]:
        limits = {name: known[letter][pose - 1] * (1.5 if "compliant" in name else 1.0) for name in hands}
        return {"geometry": 1.0, "depths_mm": dict.fromkeys(hands, 10.0), "physics": limits}

    records = [record(trial.configuration["part"], trial.configuration["pose"]) for trial in chosen]
    made = physics_check.report(chosen, records, physics_check.inputs())
    [grid] = [block for block in made.findings if isinstance(block, Grid)]
    assert [row[1:3] for row in grid.rows] == [
        ["2 of 2", "3.00 (2.00 to 4.00)"],
        ["2 of 2", "1.00 (1.00 to 1.00)"],
    ]
    assert [row[grid.head.index("twice as compliant: change of the limit, %")] for row in grid.rows] == [
        "+50.0 (+50.0 to +50.0)"
    ] * 2
    [figure] = [block for block in made.findings if isinstance(block, Figure)]
    # A panel for every hand; a box for each of two parts.
    drawn = ElementTree.fromstring(figure.content)
    assert sum(group.get("id", "").startswith("axes_") for group in drawn.iter()) == len(hands)
    assert made == physics_check.report(chosen, records, physics_check.inputs())


def test_trials_are_those_of_the_paper_and_of_fewer_repeats_among_those_of_more() -> None:
    paper = trials(36, 1)
    counts = {letter: sum(t.configuration["part"] == letter for t in paper) for letter in GRASPED}
    assert counts == {"a": 36, "b": 36, "c": 36, "d": 36, "e": 10}
    assert {t.digest for t in trials(8, 1)} <= {t.digest for t in paper}
    assert not {t.digest for t in trials(8, 2)} & {t.digest for t in paper}


def test_a_grasped_plug_is_located_and_goes_in_the_same_every_time() -> None:
    """Simulated, noise 2 grey levels: the plug's body and shoulders leave no direction free."""
    (trial,) = [t for t in trials(1, 1) if t.configuration["part"] == "e"]
    record = run(trial.configuration, trial.seed)
    assert json.loads(json.dumps(record)) == run(trial.configuration, trial.seed)
    ours = record["methods"]["surface search"]
    assert ours["room_mm"] > 0.0 and ours["chance"] > analysis.MIN_CHANCE and ours["free"] == []
    (verdict,) = [v for v in analysis.verdicts([trial], [record]) if v.method == "surface search"]
    assert verdict.inserted and verdict.go
    assert np.allclose(se3_log(verdict.placed()), ours["error"], atol=1e-12)
    page = EXPERIMENT.report([trial], [record])
    assert "simulated" in page.conditions
