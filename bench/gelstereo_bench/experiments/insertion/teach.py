"""How a method learns where the part must go: grasps of the part that stands in the hole (section V-A of the paper)."""

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

#: Seed of the grasps that are taught.
_SEED = 1


@dataclass(frozen=True)
class Taught:
    """Grasps over the hole, from which a method learned where the part must go: truth, and what it believes of each."""

    t_sensor_object: Array
    beliefs: tuple[Belief, ...]
    #: By how much the poses found differ from the true ones, a motion in the part's frame: their mean.
    error: Array
    #: The least covariance of that, (6, 6), if heights are all that is read, of the first look of each.
    bound: Array

    @property
    def pair(self) -> tuple[Array, Array]:
        """True and found pose, as `over_hole` wants them."""
        return self.t_sensor_object, np.asarray(self.t_sensor_object @ np.asarray(se3_exp(self.error)))


@lru_cache(maxsize=32)
def taught(letter: str, method: Method) -> Taught:
    """Teach a method the hole: the part is held in the middle, stands ideally over it, and is found by it.

    So often as the method is taught, every time turned otherwise among the markers: an edge that lies along a row of
    them is known to a pitch only. A method that weighs poses looks again where one look does not tell enough.
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
    """Look again until the pose is known well enough by itself."""
    if not method.tries_all:
        return look
    chance = chance_of(place, look.belief, (), np.random.default_rng([_SEED, 71, number]))
    first = Look(look.t_sensor_object, look.belief, chance)
    return look_until_known(place, method, first, (), _SEED + number)[-1]
