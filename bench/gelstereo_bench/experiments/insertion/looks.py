"""Further looks at a part whose first look does not tell enough: how the hand takes it again, and what that tells.

The first grasp is made while the part still stands in its holder. Where the chance of insertion is too low, the hand
opens, moves by a known amount, and closes on the standing part again. The look is chosen by what is unknown. Every
grasp that the part and its holder allow is predicted: the gel is pressed in the simulator as the robot's model, the
heights of the markers that touch are joined with what is believed so far, and the grasp with the highest chance of
insertion is made. A turn onto the next face of a peg tells by heights what its first face left to the edges.

Between two looks the part may move in its holder, the arm repeats its poses with an error, and the fingers' place
along the closing direction is known with an error. `Cell` states their sum.
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

#: The robot inserts when success is at least so probable: as often as it is meant to succeed.
MIN_CHANCE = 0.99
#: Looks at one part, the first included.
MAX_LOOKS = 3
#: Turns of the hand in the gel's plane: to either side of a row, where edges cross the rows of markers.
_PITCHES_RAD = (-0.2, 0.2)
#: What a marker in contact is known to along the gel's normal, mm.
_MARKER_SIGMA_MM = 0.0055


@dataclass(frozen=True)
class Cell:
    """What the robot's cell adds between two looks at a standing part: standard deviations of every component."""

    #: As arms of this size repeat a pose: 0.03 mm is a UR5e's by ISO 9283.
    shift_mm: float = 0.03
    #: About the middle of the grasp.
    turn_rad: float = 0.001

    def draw(self, point_mm: Array, random: np.random.Generator) -> Array:
        """Draw a motion (ω, v) of the part, in its own frame, whose turn is about a point of that frame, (3,) mm."""
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
    """How the hand takes a standing part again."""

    #: About the part's own axis, from the grasp before.
    turn_rad: float
    #: As in `Hold`.
    pitch_rad: float
    held_mm: float


@dataclass(frozen=True)
class Look:
    """One look at the part: where it truly was in the hand, and what was believed after it."""

    t_sensor_object: Array
    belief: Belief
    #: Of the belief; before the part is inserted by it.
    chance: float
    #: How the hand got there; the first look has none.
    regrasp: Regrasp | None = None


def regrasps(place: Workplace, belief: Belief) -> list[tuple[Regrasp, Array]]:
    """Grasps of the standing part that are possible now, and the pose in the sensor that each is to bring, (4, 4)."""
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
    """Look again until the chance reaches `MIN_CHANCE`, `MAX_LOOKS` times at most; all looks, the first included.

    `others` are the beliefs that the goal was taught by. A grasp in which the part is not found ends the search.
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
    """Chance that the part goes in by a goal that was taught by other beliefs, or is known exactly."""
    motions = belief.draw(random, SAMPLES)
    if others:
        motions = motions - drawn(others, random, SAMPLES)
    return chance(place.hole, place.fit.end, motions)


def _best(
    place: Workplace, belief: Belief, others: Sequence[Belief], cell: Cell, random: np.random.Generator
) -> tuple[Regrasp, Array]:
    """Choose the grasp after which the chance is expected to be the highest; the least turn of those alike."""
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
    """Covariance of the part's pose, in its own frame, (6, 6), after a look at it where it is to be."""
    contact = place.simulator.press(goal)
    points_mm = contact.points_mm[contact.in_contact]
    covariance = np.tile(_MARKER_SIGMA_MM**2 * np.eye(3), (len(points_mm), 1, 1))
    if place.is_ridged:
        # Which of two faces a row beside an edge lies on is what is unknown: one face counts.
        carry = adjoint(goal)
        heights = carry.T @ place.faces.information(goal, points_mm, covariance) @ carry
    else:
        points = (points_mm - goal[:3, 3]) @ goal[:3, :3]
        heights = heights_information(points, place.surface.normals(points), covariance)
    return np.asarray(np.linalg.inv(np.linalg.inv(belief.covariance + moved) + heights))


def _held_at(place: Workplace, regrasp: Regrasp) -> Array:
    """Point of the part's axis that lies in the middle of the hand, in the part's frame, (3,) mm."""
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
    """Take the part again, and fuse what that tells with what was believed.

    The hand goes where the believed part would be at `goal`; its fingers then close until they have pressed the part in
    as far as their force has it.
    """
    at = _held_at(place, regrasp)
    t_new_old = goal @ np.linalg.inv(last.belief.t_sensor_object)
    stood = t_new_old @ last.t_sensor_object @ np.asarray(se3_exp(cell.draw(at, random)))
    press_mm = float(random.uniform(*RANGES.press_mm))
    truth = place.reached(stood, press_mm)
    # The fingers' place is known to as much as `Cell` says.
    t_new_old[2, 3] += truth[2, 3] - stood[2, 3]
    before = last.belief.moved(t_new_old, cell.covariance(at))
    seed = int(random.integers(2**40))
    frame = place.senses.sense(method.preset, place.grasp(truth, press_mm, seed))
    _found, belief = place.find(method, frame, seed, before)
    return Look(truth, belief, chance_of(place, belief, others, random), regrasp)
