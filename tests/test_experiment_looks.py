"""Further looks at a part: beliefs that are fused, against closed forms, and a grasp that one look does not
tell.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelstereo.geometry import se3_exp, se3_log
from gelstereo.view.html import Grid
from gelstereo_bench.experiments.insertion import analysis, trials
from gelstereo_bench.experiments.insertion.analysis import Verdict
from gelstereo_bench.experiments.insertion.belief import Belief
from gelstereo_bench.experiments.insertion.chance import Prior, adjoint
from gelstereo_bench.experiments.insertion.grasp import GraspRanges, Hold, lie
from gelstereo_bench.experiments.insertion.looks import (
    MIN_CHANCE,
    Cell,
    Look,
    Regrasp,
    look_until_known,
    regrasps,
)
from gelstereo_bench.experiments.insertion.looks_report import PACE, looks_blocks
from gelstereo_bench.experiments.insertion.sampling import InPlane, believed
from gelstereo_bench.experiments.insertion.sense import METHODS, Found
from gelstereo_bench.experiments.insertion.trial import run
from gelstereo_bench.experiments.insertion.workplace import workplace

POSE = np.array([[0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 1.0, -15.0], [1.0, 0.0, 0.0, 32.0], [0.0, 0.0, 0.0, 1.0]])
seeds = st.integers(0, 2**31)


def covariance(random: np.random.Generator, scale: float) -> np.ndarray:
    root = scale * random.normal(size=(6, 6))
    return root @ root.T + 1e-4 * scale * scale * np.eye(6)


def one(pose: np.ndarray, spread: np.ndarray) -> Belief:
    return Belief(pose, np.zeros((1, 6)), np.ones(1), spread)


@given(seed=seeds)
def test_two_normal_beliefs_are_fused_in_information_form(seed: int) -> None:
    random = np.random.default_rng(seed)
    first, second, apart = covariance(random, 1e-3), covariance(random, 1e-3), 1e-3 * random.normal(size=6)
    fused = one(POSE, first).fused([POSE @ np.asarray(se3_exp(apart))], np.ones(1), second)
    expected = np.linalg.inv(np.linalg.inv(first) + np.linalg.inv(second))
    assert np.allclose(fused.covariance, expected, rtol=1e-6, atol=1e-12)
    mean = np.asarray(se3_log(np.linalg.inv(POSE) @ fused.t_sensor_object))
    # Motions of 1e-3 commute but for their squares.
    assert np.allclose(mean, expected @ np.linalg.inv(second) @ apart, atol=1e-5)


@given(seed=seeds)
def test_fused_mixtures_are_the_product_of_their_densities(seed: int) -> None:
    """Along one slide, on a grid."""
    random = np.random.default_rng(seed)
    ours, theirs = np.sort(random.uniform(-0.3, 0.3, size=(2, 3)), axis=1)
    ours_weights, theirs_weights = random.dirichlet(np.ones(3), size=2)
    sigma, other = random.uniform(0.05, 0.2, size=2)
    tight = np.full(6, 1e-10)

    def spread(sigma_mm: float) -> np.ndarray:
        return np.diag([*tight[:3], sigma_mm**2, *tight[4:]])

    def slid(x: float) -> np.ndarray:
        return POSE @ np.asarray(se3_exp([0.0, 0.0, 0.0, x, 0.0, 0.0]))

    before = Belief.of([slid(x) for x in ours], ours_weights, spread(sigma))
    poses = [slid(x) for x in theirs]
    agreement = np.logaddexp.reduce(before.log_pairs(poses, spread(other)), axis=1)
    weights = theirs_weights * np.exp(agreement - agreement.max())
    fused = before.fused(poses, weights / weights.sum(), spread(other))
    x = np.linspace(-3.0, 3.0, 6001)

    def density(middles: np.ndarray, shares: np.ndarray, width: float) -> np.ndarray:
        return np.exp(-0.5 * ((x[:, None] - middles) / width) ** 2) @ shares

    product = density(ours, ours_weights, sigma) * density(theirs, theirs_weights, other)
    product /= product.sum()
    mean = float(product @ x)
    assert np.asarray(se3_log(np.linalg.inv(POSE) @ fused.t_sensor_object))[3] == pytest.approx(
        mean, abs=1e-4
    )
    assert fused.covariance[3, 3] == pytest.approx(float(product @ (x - mean) ** 2), rel=1e-3)


@given(seed=seeds)
def test_a_belief_that_moves_with_the_hand_keeps_its_poses(seed: int) -> None:
    random = np.random.default_rng(seed)
    belief = Belief.of(
        [POSE @ np.asarray(se3_exp(0.01 * random.normal(size=6))) for _ in range(4)],
        random.dirichlet(np.ones(4)),
        covariance(random, 1e-2),
    )
    hand = np.asarray(se3_exp(random.normal(size=6)))
    moved = belief.moved(hand, np.zeros((6, 6)))
    there = [moved.t_sensor_object @ np.asarray(se3_exp(motion)) for motion in moved.motions]
    here = [hand @ belief.t_sensor_object @ np.asarray(se3_exp(motion)) for motion in belief.motions]
    assert np.allclose(there, here) and np.allclose(moved.covariance, belief.covariance)


def test_what_a_cell_adds_is_about_the_middle_of_the_grasp() -> None:
    cell, point_mm = Cell(0.03, 0.001), np.array([0.0, 0.0, 15.0])
    random = np.random.default_rng(3)
    drawn = np.array([cell.draw(point_mm, random) for _ in range(20000)])
    expected = cell.covariance(point_mm)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # An element of a covariance of that many draws is known to 1 %.
    assert np.abs((np.cov(drawn.T) - expected) / scale).max() < 0.05
    there = np.eye(4)
    there[:3, 3] = -point_mm
    at_point = adjoint(there) @ expected @ adjoint(there).T
    assert np.allclose(np.sqrt(np.diag(at_point)), [0.001] * 3 + [0.03] * 3)


holds = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.2, 0.2), st.floats(-3.0, 3.0))


@given(angles=holds)
def test_the_angles_of_a_pose_are_those_it_was_made_of(angles: tuple[float, float, float]) -> None:
    # Points along the part's axis.
    surface_mm = np.linspace(0.0, 40.0, 81)[:, None] * [0.0, 0.0, 1.0]
    pose = lie(Hold(*angles, 0.5, 25.0, 1.0), surface_mm, np.array([4.0, 0.0, 28.7]), 40.0)
    found = Hold.of_pose(pose)
    assert np.allclose((found.pitch_rad, found.roll_rad, found.spin_rad), angles, atol=1e-9)


def face(pose: np.ndarray, log_likelihood: float) -> Found:
    """Face that is known by its heights alone: 100 markers over 8 x 16 mm, each to 0.01 mm."""
    centre_mm = np.array([3.0, 0.0, 28.0])
    x, y = np.meshgrid(np.linspace(-4.0, 4.0, 10), np.linspace(-8.0, 8.0, 10))
    points = centre_mm + np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    normal = np.array([0.0, 0.0, -1.0])
    rows = np.column_stack([np.cross(points, normal), np.tile(normal, (len(points), 1))])
    return Found(pose, rows.T @ rows / 0.01**2, True, (), centre_mm, log_likelihood)


@pytest.mark.parametrize("peaks_mm", [(0.0,), (-0.4, 0.4)])
def test_a_look_that_leaves_a_slide_open_takes_it_from_the_look_before(peaks_mm: tuple[float, ...]) -> None:
    """One flat likelihood 1 mm wide, or two peaks: the belief before says where on it the part is."""
    plane = InPlane.of(face(POSE, 0.0))
    before_mm, sigma_mm = 0.35, 0.05
    ways = np.diag([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1.0])
    across = np.asarray(plane.ways[:, 0])
    # The part's own frame: the slide is along its y.
    ways[4, 4] = sigma_mm**2
    before = one(plane.pose(np.array([before_mm, 0.0])), ways)
    assert abs(across[3:] @ POSE[:3, 1]) == pytest.approx(1.0, abs=0.01)

    def log_of(x: np.ndarray) -> float:
        turn = -0.5 * (x[1] / 0.05) ** 2
        if len(peaks_mm) == 1:
            return float(turn - (0.0 if abs(x[0]) < 0.5 else 50.0))
        return float(np.logaddexp.reduce(-0.5 * ((x[0] - np.array(peaks_mm)) / 0.05) ** 2) + turn)

    def held(guess: np.ndarray, _by_mm: float) -> Found:
        return face(guess, log_of(plane.along(guess)))

    expected = (before_mm, sigma_mm) if len(peaks_mm) == 1 else (0.375, sigma_mm / math.sqrt(2.0))
    found = []
    for seed in range(12):
        belief = believed([held(before.t_sensor_object, 0.0)], held, Prior(), seed, before=before)
        along = [plane.along(belief.t_sensor_object @ np.asarray(se3_exp(m)))[0] for m in belief.motions]
        mean = float(belief.weights @ along)
        found.append((mean, math.sqrt(belief.weights @ (np.array(along) - mean) ** 2 + belief.spread[4, 4])))
    mean, sigma = np.mean(found, axis=0)
    # 12 beliefs of 12 effective draws or more; likelihoods are tempered until as many count.
    assert mean == pytest.approx(expected[0], abs=4.0 * sigma_mm / 12.0)
    assert expected[1] * 0.75 < sigma < expected[1] * 1.5


def test_a_part_that_is_known_is_not_looked_at_again() -> None:
    first = Look(POSE, one(POSE, np.eye(6)), MIN_CHANCE)
    assert look_until_known(workplace("b"), METHODS[-1], first, (), 1) == [first]


def test_a_regrasp_turns_the_hand_about_the_parts_axis() -> None:
    place = workplace("b")
    hold = Hold.drawn(place.part, GraspRanges(), np.random.default_rng(5))
    belief = one(place.lie(hold), np.eye(6))
    for regrasp, goal in regrasps(place, belief):
        found = Hold.of_pose(goal)
        turn = found.spin_rad - hold.spin_rad - regrasp.turn_rad
        assert math.cos(turn) == pytest.approx(1.0, abs=1e-9)
        assert found.pitch_rad == pytest.approx(regrasp.pitch_rad) and found.roll_rad == pytest.approx(0.0)
        # The gel's middle lies over the part where it is to be held, behind its tip.
        held = goal[:2, 3] + (place.hole.tip_mm - regrasp.held_mm) * goal[:2, 2]
        assert held == pytest.approx(place.middle_mm[:2], abs=1e-9)


@pytest.mark.long
def test_a_square_peg_that_one_look_declines_goes_in_after_its_next_side_was_looked_at() -> None:
    """Simulated, noise 2 grey levels: its edges leave the slide open.

    Where it would have ended along the slide is chance: it differs between processors on which NumPy rounds
    otherwise, and the stated chance with it (below 0.5 and 0.6 on two of them). The decline does not.
    """
    [trial] = [t for t in trials(8, 22) if t.configuration == {"part": "b", "grasp": 6}]
    record = run(trial.configuration, trial.seed)
    [first] = [v for v in analysis.verdicts([trial], [record]) if v.method == METHODS[-1].name]
    assert not first.go and first.chance < 0.9
    assert first.last.go and first.last.inserted and first.last is not first
    [look] = first.further
    assert look.regrasp is not None and look.regrasp.turn_rad == pytest.approx(0.5 * math.pi)
    assert run(trial.configuration, trial.seed) == record


def grasp(chance: float, room_mm: float, *further: Verdict) -> Verdict:
    nothing = np.eye(4)
    pair = (nothing, nothing)
    return Verdict("b", "", {}, nothing, None, nothing, pair, room_mm, chance, (), "", further)


@settings(max_examples=20)
@given(counts=st.tuples(*[st.integers(1, 30)] * 4))
def test_the_table_of_further_looks_counts_attempts_and_insertions(counts: tuple[int, int, int, int]) -> None:
    at_once, second, third, never = counts
    turned = replace(grasp(1.0, 0.1), regrasp=Regrasp(0.5 * math.pi, 0.2, 25.0))
    unsure, failed = replace(turned, chance=0.5), replace(turned, room_mm=-0.1)
    ours = [
        *[grasp(1.0, 0.1)] * at_once,
        *[grasp(0.5, 0.1, turned)] * second,
        *[grasp(0.5, 0.1, unsure, failed)] * third,
        *[grasp(0.5, 0.1, unsure, unsure)] * never,
    ]
    [grid, kinds] = [block for block in looks_blocks(ours, ["b"]) if isinstance(block, Grid)]
    row = grid.rows[0]
    count, done = sum(counts), at_once + second + third
    assert row[1] == str(count)
    assert row[2:4] == [f"{100 * at_once / count:.1f}", f"{100 * (at_once + second) / count:.1f}"]
    assert row[4].split()[0] == f"{100 * done / count:.1f}"
    assert row[5].split()[0] == f"{100 * (at_once + second) / done:.1f}"
    assert row[6].split()[0] == f"{100 * second / (second + third):.1f}"
    looks = second + 2 * (third + never)
    each_s = PACE.regrasp_s(Regrasp(0.5 * math.pi, 0.2, 25.0))
    assert row[8] == f"{each_s * looks / (second + third + never):.1f} ({(2 * each_s):.1f})"
    assert kinds.rows[0][:3] == ["(b) peg square", "90", str(looks)]
