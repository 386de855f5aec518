"""One grasp by every method: the part's pose, the estimates, and whether it goes into the hole."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, RegisterError
from gelstereo.geometry import se3_log
from gelstereo_bench.experiments.batch import Configuration
from gelstereo_bench.experiments.insertion.bound import Bound
from gelstereo_bench.experiments.insertion.chance import matters, weakest
from gelstereo_bench.experiments.insertion.grasp import Hold
from gelstereo_bench.experiments.insertion.looks import Look, chance_of, look_until_known
from gelstereo_bench.experiments.insertion.robot import over_hole
from gelstereo_bench.experiments.insertion.sense import METHODS, Method
from gelstereo_bench.experiments.insertion.teach import Taught, taught
from gelstereo_bench.experiments.insertion.workplace import RANGES, Workplace, workplace
from gelstereo_bench.experiments.store import Record

__all__ = ["run"]

Array = npt.NDArray[np.float64]

#: Seed of the frames of trial 0; lower seeds are those of the taught grasps.
_FIRST = 2


def run(configuration: Configuration, seed: int) -> Record:
    """Grasp a part, localize it by every method, and test whether it would go in.

    The record has the grasp, the true pose and the Cramér-Rao ``bound`` from the markers' heights. For each
    method it has the pose used for the insertion, ``room_mm`` between part and walls (below 0 it does not go
    in), the predicted ``chance`` and the number of ``poses`` in the belief (only of methods that compare
    poses). It also has the ``free`` directions of the contact's faces, which of them ``matters``, and the
    ``weakest`` motion over the hole; or ``refused``, the reason why there is no pose. A method that compares
    poses looks again if its chance is too low. ``looks`` then has the same data for all looks after the
    first, and the regrasp of each.
    """
    place = workplace(configuration["part"])
    hold = Hold.drawn(place.part, RANGES, np.random.default_rng(seed))
    t_sensor_object = place.lie(hold)
    grasp = place.grasp(t_sensor_object, hold.press_mm, _FIRST + seed)
    frames = {preset: place.senses.sense(preset, grasp) for preset in {m.preset for m in METHODS}}
    ours = METHODS[-1]
    covariance = place.covariance_bound(t_sensor_object, grasp[-1], frames[ours.preset])
    covariance = covariance + taught(place.part.letter, ours).bound
    random = np.random.default_rng([seed, 73])
    return {
        "hold": asdict(hold),
        "touching": int(np.count_nonzero(grasp[-1].in_contact)),
        "t_sensor_object": t_sensor_object.tolist(),
        "bound": asdict(Bound.of(place.hole, place.fit.end, covariance, random)),
        "methods": {
            method.name: _judged(place, method, frames[method.preset], t_sensor_object, seed)
            for method in METHODS
        },
    }


def _judged(place: Workplace, method: Method, frame: Frame, t_sensor_object: Array, seed: int) -> Record:
    """Result of one method, and of the insertion by a robot that moves exactly."""
    try:
        found, belief = place.find(method, frame, seed)
        goal = taught(place.part.letter, method)
    except RegisterError as error:
        return {"refused": str(error)}
    common = {
        "taught": [pose.tolist() for pose in goal.pair],
        "converged": found.converged,
        "free": [str(free) for free in found.free],
        "matters": [str(free) for free in found.free if matters(place.hole, place.fit.end, free)],
    }
    if not method.tries_all:
        return {**common, **_acted(place, Look(t_sensor_object, belief, 0.0), goal)}
    chance = chance_of(place, belief, goal.beliefs, np.random.default_rng([seed, 71]))
    looks = look_until_known(place, method, Look(t_sensor_object, belief, chance), goal.beliefs, seed)
    first, *further = [_looked(place, look, goal) for look in looks]
    return {**common, **first, "looks": further}


def _looked(place: Workplace, look: Look, goal: Taught) -> Record:
    """Result of one look, for a method that compares poses."""
    record = {
        **_acted(place, look, goal),
        "chance": look.chance,
        "poses": len(look.belief.weights),
    }
    if look.regrasp is None:
        return record
    return {**record, "truth": look.t_sensor_object.tolist(), "regrasp": asdict(look.regrasp)}


def _acted(place: Workplace, look: Look, goal: Taught) -> Record:
    """Result of an insertion based on a look."""
    t_hole_object = over_hole(look.t_sensor_object, look.belief.t_sensor_object, goal.pair)
    covariance = look.belief.covariance + sum(b.covariance for b in goal.beliefs) / len(goal.beliefs) ** 2
    return {
        "t_sensor_object": look.belief.t_sensor_object.tolist(),
        "error": np.asarray(se3_log(t_hole_object)).tolist(),
        "room_mm": place.fit.room_mm(t_hole_object),
        "weakest": weakest(place.hole, place.fit.end, covariance),
    }
