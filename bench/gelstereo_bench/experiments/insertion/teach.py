"""Teaching of the goal: grasps of the part that stands in the hole (section V-A of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.experiments.insertion.belief import Belief
from gelstereo_bench.experiments.insertion.looks import Look, chance_of, look_until_known
from gelstereo_bench.experiments.insertion.sense import Method
from gelstereo_bench.experiments.insertion.workplace import Workplace, workplace

__all__ = ["Taught", "taught"]

Array = npt.NDArray[np.float64]

#: Seed of the taught grasps.
_SEED = 1


@dataclass(frozen=True)
class Taught:
    """Taught grasps over the hole: the true pose, and the method's belief about each."""

    t_sensor_object: Array
    beliefs: tuple[Belief, ...]
    #: Mean error of the estimated poses, as a motion in the part's frame.
    error: Array
    #: Cramér-Rao bound of that error, (6, 6), from heights alone, with one look each.
    bound: Array

    @property
    def pair(self) -> tuple[Array, Array]:
        """True and estimated pose, the input of `over_hole`."""
        return self.t_sensor_object, np.asarray(self.t_sensor_object @ np.asarray(se3_exp(self.error)))


@lru_cache(maxsize=32)
def taught(letter: str, method: Method) -> Taught:
    """Teach a method the hole: the part is held in the middle, stands ideally over the hole, and is
    localized.

    Each taught grasp has another rotation relative to the markers, because an edge along a row of markers is
    determined only to one pitch. A method that compares poses looks again if one look is not sufficient.
    """
    place = workplace(letter)
    errors, beliefs, bounds = [], [], []
    for number, turn_rad in enumerate(method.taught_rad):
        hold = replace(place.nominal, pitch_rad=turn_rad)
        t_sensor_object = place.lie(hold)
        grasp = place.grasp(t_sensor_object, hold.press_mm, _SEED)
        frame = place.senses.sense(method.preset, grasp)
        bounds.append(place.covariance_bound(t_sensor_object, grasp[-1], frame))
        belief = place.find(method, frame, _SEED)[1]
        last = _looked(place, method, Look(t_sensor_object, belief, 1.0), number)
        errors.append(np.asarray(se3_log(np.linalg.inv(last.t_sensor_object) @ last.belief.t_sensor_object)))
        beliefs.append(last.belief)
    return Taught(
        place.lie(place.nominal),
        tuple(beliefs),
        np.mean(errors, axis=0),
        np.sum(bounds, axis=0) / len(bounds) ** 2,
    )


def _looked(place: Workplace, method: Method, look: Look, number: int) -> Look:
    """Look again until the pose by itself is sufficiently certain."""
    if not method.tries_all:
        return look
    chance = chance_of(place, look.belief, (), np.random.default_rng([_SEED, 71, number]))
    first = Look(look.t_sensor_object, look.belief, chance)
    return look_until_known(place, method, first, (), _SEED + number)[-1]
