"""What edges tell of a grasped part: markers that err together, and faces that only seem to be touched."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import Template, parts
from gelstereo.geometry import se3_exp
from gelstereo_bench.experiments.insertion import analysis, trials
from gelstereo_bench.experiments.insertion.bound import heights_information
from gelstereo_bench.experiments.insertion.chance import SAMPLES, Prior, chance
from gelstereo_bench.experiments.insertion.face import Faces, is_ridged
from gelstereo_bench.experiments.insertion.grasp import GRASPED, Hold
from gelstereo_bench.experiments.insertion.robot import over_hole
from gelstereo_bench.experiments.insertion.rows import markers_alike
from gelstereo_bench.experiments.insertion.sampling import InPlane, believed
from gelstereo_bench.experiments.insertion.sense import METHODS, Found
from gelstereo_bench.experiments.insertion.teach import taught
from gelstereo_bench.experiments.insertion.workplace import RANGES, workplace

PITCH_MM = 0.9
#: A contact of 9 x 18 mm on a lattice along x and y.
PATCH_MM = np.array([[x, y, 0.0] for x in range(-5, 6) for y in range(-10, 11)]) * PITCH_MM


def alike(turn_rad: float, patch_mm: np.ndarray = PATCH_MM) -> float:
    return markers_alike(np.array([-math.sin(turn_rad), math.cos(turn_rad), 0.0]), patch_mm, PITCH_MM)


def test_an_edge_along_a_row_a_diagonal_or_a_knights_way_has_all_of_its_markers_alike() -> None:
    for across, along in ((0, 1), (1, 1), (1, 2)):
        turn_rad = math.atan2(across, along)
        along_edge = np.array([-math.sin(turn_rad), math.cos(turn_rad), 0.0])
        reach = np.ptp(PATCH_MM @ along_edge) / PITCH_MM
        assert alike(turn_rad) == pytest.approx(reach / math.hypot(across, along), rel=1e-9)
    # 15 degrees from a row and 12 from a knight's way: markers lie at all distances from the edge.
    assert alike(math.radians(15.0)) == 1.0


@given(turn_rad=st.floats(-0.8, 0.8))
def test_markers_alike_are_those_whose_distances_from_the_edge_differ_little(turn_rad: float) -> None:
    edge = np.array([-math.sin(turn_rad), math.cos(turn_rad)])
    longest = 0
    for a in range(-2, 3):
        for b in range(-2, 3):
            # A way of the lattice, once, whose step is none of another's doubled.
            if math.gcd(a, b) != 1 or (a, b) < (0, 0) or math.hypot(a, b) > 2.5:
                continue
            step = np.array([a, b], float)
            most = np.ptp(PATCH_MM[:, :2] @ edge) / PITCH_MM / np.linalg.norm(step)
            apart = [abs(k * (step[0] * edge[1] - step[1] * edge[0])) for k in range(40)]
            longest = max(longest, sum(1 for k, x in enumerate(apart) if k < most and x < 0.06))
    assert abs(alike(turn_rad) - max(longest, 1)) <= 1.0
    # The lattice looks the same after a quarter turn, and in a mirror.
    turned = PATCH_MM @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert alike(turn_rad + 0.5 * math.pi, turned) == pytest.approx(alike(turn_rad), rel=1e-6)
    assert alike(-turn_rad) == pytest.approx(alike(turn_rad), rel=1e-6)


@pytest.mark.parametrize("letter", sorted(GRASPED))
def test_only_the_hexagonal_peg_has_a_next_face_to_lie_on(letter: str) -> None:
    """Round and irregular pegs have no edges, the plug's are rounded, and a square peg's sides
    stand upright.
    """
    assert is_ridged(GRASPED[letter].make()) == (letter == "d")


#: A hexagonal peg on the gel: its axis along the sensor's y, a flat towards the camera.
_FLAT_UP = np.array(
    [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -20.0], [1.0, 0.0, 0.0, 30.0], [0.0, 0.0, 0.0, 1.0]]
)


def hexagon_on_the_gel() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose of the peg, markers on its lowest face, and a row of them on the next one: (4, 4), (N, 3), (M, 3)
    mm.
    """
    pose = _FLAT_UP @ np.asarray(se3_exp([0.0, 0.0, math.pi / 6.0, 0.0, 0.0, 0.0]))
    y = np.arange(-8.1, 8.2, PITCH_MM)
    half_mm, side_mm = 4.0, 4.0 / math.sqrt(3.0)
    x, along = np.meshgrid([-1.8, -0.9, 0.0, 0.9, 1.8], y)
    face = np.column_stack([x.ravel(), along.ravel(), np.full(x.size, 30.0 - half_mm)])
    beyond_mm = 0.3
    row = np.column_stack(
        [
            np.full(len(y), side_mm + beyond_mm),
            y,
            np.full(len(y), 30.0 - half_mm + math.sqrt(3.0) * beyond_mm),
        ]
    )
    return pose, face, row


def test_a_row_that_seems_to_lie_on_the_next_face_does_not_roll_a_part_that_slides() -> None:
    pose, face_mm, row_mm = hexagon_on_the_gel()
    points_mm = np.vstack([face_mm, row_mm])
    covariance_mm2 = np.tile(0.005**2 * np.eye(3), (len(points_mm), 1, 1))
    faces = Faces(Template.from_mesh(parts.peg_hexagonal(), units="mm", spacing_mm=0.3))
    told = faces.information(pose, points_mm, covariance_mm2)
    # Heights of the face alone, in closed form.
    toward_camera = np.tile([0.0, 0.0, -1.0], (len(face_mm), 1))
    expected = heights_information(face_mm, toward_camera, covariance_mm2[: len(face_mm)])
    assert np.allclose(told, expected, rtol=1e-6, atol=1e-3 * np.abs(expected).max() * 1e-6)
    next_face = np.tile([0.5 * math.sqrt(3.0), 0.0, -0.5], (len(row_mm), 1))
    both = expected + heights_information(row_mm, next_face, covariance_mm2[len(face_mm) :])
    found = Found(pose, both, True, (), points_mm.mean(axis=0), 0.0)
    # Turns of the part about its axis by a slide across it of 1 mm: (ω, v) of the sensor's frame, its y.
    assert abs(InPlane.of(found).ways[1, 0]) > math.radians(2.0)
    assert abs(InPlane.of(found, told).ways[1, 0]) < math.radians(0.01)


@pytest.mark.parametrize("count", [1.0, 10.0])
def test_many_markers_that_are_alike_weigh_as_one(count: float) -> None:
    """Two peaks 0.4 mm apart, the second one less likely by 20: of one another ten markers are a tenth as
    sure.
    """
    pose, face_mm, _row_mm = hexagon_on_the_gel()
    toward_camera = np.tile([0.0, 0.0, -1.0], (len(face_mm), 1))
    told = heights_information(face_mm, toward_camera, np.tile(0.005**2 * np.eye(3), (len(face_mm), 1, 1)))
    plane = InPlane.of(Found(pose, told, True, (), face_mm.mean(axis=0), 0.0))

    def held(guess: np.ndarray, _by_mm: float) -> Found:
        x = plane.along(guess)
        logs = -0.5 * ((x[0] - np.array([0.0, 0.4])) ** 2 + x[1] ** 2) / 0.02**2 - [0.0, 20.0]
        return Found(guess, told, True, (), face_mm.mean(axis=0), float(np.logaddexp.reduce(logs)))

    tried = [held(plane.pose(np.array([x, 0.0])), 0.0) for x in (0.0, 0.4)]
    shares = []
    for seed in range(12):
        belief = believed(tried, held, Prior(), seed, told, count)
        x = [
            plane.along(belief.t_sensor_object @ np.asarray(se3_exp(motion)))[0] for motion in belief.motions
        ]
        shares.append(float(belief.weights[np.array(x) > 0.2].sum()))
    # Widths are alike, so shares are as the likelihoods at the peaks.
    less = math.exp(-20.0 / count)
    # 12 beliefs of 12 effective draws or more: three standard deviations of a share.
    share = less / (1.0 + less)
    assert np.mean(shares) == pytest.approx(share, abs=3.0 * math.sqrt(share / 144.0) + 1e-3)


def sensed(seed: int, number: int) -> tuple[float, float]:
    """Chance that the surface search predicts for a hexagonal peg, and the room it has in the hole, mm."""
    [trial] = [t for t in trials(250, seed) if t.configuration == {"part": "d", "grasp": number}]
    place, ours = workplace("d"), METHODS[-1]
    hold = Hold.drawn(place.part, RANGES, np.random.default_rng(trial.seed))
    t_sensor_object = place.lie(hold)
    # Frames as the experiment numbers them.
    grasp = place.grasp(t_sensor_object, hold.press_mm, 2 + trial.seed)
    _found, belief = place.find(ours, place.senses.sense(ours.preset, grasp), trial.seed)
    goal = taught("d", ours)
    mean = sum(b.draw(np.random.default_rng(k), SAMPLES) for k, b in enumerate(goal.beliefs)) / len(
        goal.beliefs
    )
    motions = belief.draw(np.random.default_rng(9), SAMPLES) - mean
    room_mm = place.fit.room_mm(over_hole(t_sensor_object, belief.t_sensor_object, goal.pair))
    return chance(place.hole, place.fit.end, motions), room_mm


def test_a_peg_whose_end_the_gel_just_reaches_is_found_where_it_is() -> None:
    """Simulated, noise 2 grey levels: it was found 4.6 mm along its axis and 1.3 degrees off."""
    _chance_predicted, room_mm = sensed(3, 206)
    assert room_mm > 0.0


def test_a_row_that_may_hang_beside_an_edge_or_lie_on_the_next_face_is_no_reason_to_go() -> None:
    """Simulated, noise 2 grey levels: a pose 0.4 mm and 0.8 degrees off is likelier by 41 in logarithms."""
    chance_predicted, room_mm = sensed(3, 113)
    # With better centres the right pose is the likelier one: then it may go, and goes in.
    assert chance_predicted < analysis.MIN_CHANCE or room_mm > 0.0
