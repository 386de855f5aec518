"""Further looks at a part whose first look is not sufficient: choice of the next grasp, and fusion of the
results.

The first grasp is made while the part still stands in its holder. If the chance of insertion is too low, the
hand opens, moves by a known amount, and closes on the standing part again. The next grasp is selected to
reduce the uncertainty most. Every grasp that the part and its holder allow is predicted with the simulator as
the robot's model, and the heights of markers in contact are fused with the present belief. The grasp with the
highest expected chance of insertion is made. For example, heights on the next face of a peg determine what
its first face leaves to the edges.

Between two looks the part may move in its holder, the arm has a repeatability error, and the fingers'
position along the closing direction is uncertain. `Cell` states their sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gelstereo import RegisterError
from gelstereo.geometry import se3_exp
from gelstereo_bench.experiments.insertion.belief import Belief, drawn
from gelstereo_bench.experiments.insertion.bound import heights_information
from gelstereo_bench.experiments.insertion.chance import SAMPLES, adjoint, chance
from gelstereo_bench.experiments.insertion.grasp import Hold
from gelstereo_bench.experiments.insertion.sense import Method
from gelstereo_bench.experiments.insertion.workplace import RANGES, Workplace

__all__ = ["CELL", "MAX_LOOKS", "MIN_CHANCE", "Cell", "Look", "Regrasp", "look_until_known", "regrasps"]

Array = npt.NDArray[np.float64]

#: Minimum probability of success for an insertion: the intended success rate.
MIN_CHANCE = 0.99
#: Maximum number of looks at one part, including the first.
MAX_LOOKS = 3
#: Rotations of the hand in the gel's plane, to both sides of a row, so that edges cross the rows of markers.
_PITCHES_RAD = (-0.2, 0.2)
#: Standard deviation of a marker in contact along the gel's normal, mm.
_MARKER_SIGMA_MM = 0.0055


@dataclass(frozen=True)
class Cell:
    """Uncertainty added by the robot's cell between two looks at a standing part: standard deviations per
    component.
    """

    #: Repeatability of arms of this size: 0.03 mm is that of a UR5e by ISO 9283.
    shift_mm: float = 0.03
    #: Rotation about the middle of the grasp.
    turn_rad: float = 0.001

    def draw(self, point_mm: Array, random: np.random.Generator) -> Array:
        """Draw a motion (ω, v) of the part, in its own frame, that rotates about a point of that frame, (3,)
        mm.
        """
        return self._carry(point_mm) @ (self._sigma * random.normal(size=6))

    def covariance(self, point_mm: Array) -> Array:
        """Covariance of `draw`, (6, 6)."""
        carry = self._carry(point_mm)
        return np.asarray(carry @ np.diag(self._sigma**2) @ carry.T)

    @property
    def _sigma(self) -> Array:
        return np.repeat([self.turn_rad, self.shift_mm], 3)

    @staticmethod
    def _carry(point_mm: Array) -> Array:
        there = np.eye(4)
        there[:3, 3] = point_mm
        return adjoint(there)


#: The cell of the experiment.
CELL = Cell()


@dataclass(frozen=True)
class Regrasp:
    """A further grasp of a standing part."""

    #: Rotation about the part's axis, from the previous grasp.
    turn_rad: float
    #: As in `Hold`.
    pitch_rad: float
    held_mm: float


@dataclass(frozen=True)
class Look:
    """One look at the part: its true pose in the hand, and the belief after the look."""

    t_sensor_object: Array
    belief: Belief
    #: Predicted chance of insertion with the belief.
    chance: float
    #: The regrasp that led here; None for the first look.
    regrasp: Regrasp | None = None


def regrasps(place: Workplace, belief: Belief) -> list[tuple[Regrasp, Array]]:
    """Possible grasps of the standing part, and the intended pose in the sensor of each, (4, 4)."""
    now = Hold.of_pose(belief.t_sensor_object)
    found = []
    for turn_rad in place.part.again_rad:
        for pitch_rad in _PITCHES_RAD:
            for held_mm in place.part.held_mm:
                hold = replace(
                    place.nominal, pitch_rad=pitch_rad, spin_rad=now.spin_rad + turn_rad, held_mm=held_mm
                )
                found.append((Regrasp(turn_rad, pitch_rad, held_mm), place.lie(hold)))
    return found


def look_until_known(
    place: Workplace, method: Method, first: Look, others: Sequence[Belief], seed: int, cell: Cell = CELL
) -> list[Look]:
    """Look again until the chance reaches `MIN_CHANCE`, at most `MAX_LOOKS` times; returns all looks,
    including the first.

    `others` are the beliefs from teaching the goal. A grasp in which the part is not found ends the search.
    """
    looks = [first]
    while looks[-1].chance < MIN_CHANCE and len(looks) < MAX_LOOKS:
        random = np.random.default_rng([seed, 97, len(looks)])
        regrasp, goal = _best(place, looks[-1].belief, others, cell, random)
        try:
            looks.append(_again(place, method, looks[-1], regrasp, goal, others, cell, random))
        except RegisterError:
            break
    return looks


def chance_of(
    place: Workplace, belief: Belief, others: Sequence[Belief], random: np.random.Generator
) -> float:
    """Chance of insertion at a goal taught by other beliefs, or known exactly."""
    motions = belief.draw(random, SAMPLES)
    if others:
        motions = motions - drawn(others, random, SAMPLES)
    return chance(place.hole, place.fit.end, motions)


def _best(
    place: Workplace, belief: Belief, others: Sequence[Belief], cell: Cell, random: np.random.Generator
) -> tuple[Regrasp, Array]:
    """Choose the grasp with the highest expected chance; on ties, the smallest rotation."""
    seed = int(random.integers(2**31))
    taught = sum((b.covariance for b in others), np.zeros((6, 6))) / max(len(others), 1) ** 2
    possible = regrasps(place, belief)
    chances = []
    for regrasp, goal in possible:
        known = _expected(place, belief, goal, cell.covariance(_held_at(place, regrasp)))
        normal = np.random.default_rng(seed).multivariate_normal(
            np.zeros(6), known + taught, size=SAMPLES, method="cholesky"
        )
        chances.append(chance(place.hole, place.fit.end, normal))
    return max(zip(chances, possible, strict=True), key=lambda one: (one[0], -abs(one[1][0].turn_rad)))[1]


def _expected(place: Workplace, belief: Belief, goal: Array, moved: Array) -> Array:
    """Expected covariance of the part's pose, in its own frame, (6, 6), after a look at its intended pose."""
    contact = place.simulator.press(goal)
    points_mm = contact.points_mm[contact.in_contact]
    covariance = np.tile(_MARKER_SIGMA_MM**2 * np.eye(3), (len(points_mm), 1, 1))
    if place.is_ridged:
        # It is ambiguous which of two faces a row of markers beside an edge lies on, so only one face counts.
        carry = adjoint(goal)
        heights = carry.T @ place.faces.information(goal, points_mm, covariance) @ carry
    else:
        points = (points_mm - goal[:3, 3]) @ goal[:3, :3]
        heights = heights_information(points, place.surface.normals(points), covariance)
    return np.asarray(np.linalg.inv(np.linalg.inv(belief.covariance + moved) + heights))


def _held_at(place: Workplace, regrasp: Regrasp) -> Array:
    """Point of the part's axis at the middle of the hand, part frame, (3,) mm."""
    return np.array([0.0, 0.0, place.hole.tip_mm - regrasp.held_mm])


def _again(
    place: Workplace,
    method: Method,
    last: Look,
    regrasp: Regrasp,
    goal: Array,
    others: Sequence[Belief],
    cell: Cell,
    random: np.random.Generator,
) -> Look:
    """Grasp the part again, and fuse the result with the previous belief.

    The hand moves so that the part, according to the belief, would be at `goal`. The fingers then close until
    the part is pressed in to the depth given by their force.
    """
    at = _held_at(place, regrasp)
    t_new_old = goal @ np.linalg.inv(last.belief.t_sensor_object)
    stood = t_new_old @ last.t_sensor_object @ np.asarray(se3_exp(cell.draw(at, random)))
    press_mm = float(random.uniform(*RANGES.press_mm))
    truth = place.reached(stood, press_mm)
    # The uncertainty of the fingers' position is included in `Cell`.
    t_new_old[2, 3] += truth[2, 3] - stood[2, 3]
    before = last.belief.moved(t_new_old, cell.covariance(at))
    seed = int(random.integers(2**40))
    frame = place.senses.sense(method.preset, place.grasp(truth, press_mm, seed))
    _found, belief = place.find(method, frame, seed, before)
    return Look(truth, belief, chance_of(place, belief, others, random), regrasp)
