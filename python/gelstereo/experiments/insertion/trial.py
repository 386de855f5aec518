"""One grasp, by every method: where the part lies, what is found, and whether it goes into the hole."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, RegisterError, Scene, SimulatedFrame, Simulator, Template
from gelstereo.experiments.batch import Configuration
from gelstereo.experiments.insertion.belief import Belief, believed, drawn
from gelstereo.experiments.insertion.bound import Bound, SmoothSurface, least_covariance
from gelstereo.experiments.insertion.chance import SAMPLES, Prior, chance, matters, weakest
from gelstereo.experiments.insertion.face import Faces, is_ridged
from gelstereo.experiments.insertion.grasp import GraspRanges, Hold, fit_of, guesses, lie
from gelstereo.experiments.insertion.robot import over_hole
from gelstereo.experiments.insertion.rows import markers_alike
from gelstereo.experiments.insertion.sense import METHODS, Found, Method, Registering, Senses
from gelstereo.experiments.store import Record
from gelstereo.frontier.scenes import VGA
from gelstereo.geometry import se3_exp, se3_log
from gelstereo.states import MarkerState

__all__ = ["PRIOR", "RANGES", "Workplace", "run", "sensor_scene", "workplace"]

Array = npt.NDArray[np.float64]

#: Seeds of the grasp that is taught, and of trial 0.
_TAUGHT, _FIRST = 1, 2
#: Frames while the fingers close: at 30 a second, a press of 1 mm at 7 mm/s.
_CLOSING = 4


#: Where parts may lie, and what is known of it before it is sensed.
RANGES, PRIOR = GraspRanges(), Prior()


def sensor_scene() -> Scene:
    """Show the sensor that all parts are pressed on."""
    return VGA.scene()


@dataclass(frozen=True)
class Taught:
    """Grasps over the hole, from which a method learned where the part must go: truth, and what it believes of each."""

    t_sensor_object: Array
    beliefs: tuple[Belief, ...]
    #: By how much the poses found differ from the true ones, a motion in the part's frame: their mean.
    error: Array
    #: The least covariance of that, (6, 6), if heights are all that is read.
    least: Array

    @property
    def pair(self) -> tuple[Array, Array]:
        """True and found pose, as `over_hole` wants them."""
        return self.t_sensor_object, np.asarray(self.t_sensor_object @ np.asarray(se3_exp(self.error)))


class Workplace:
    """A part, its hole, the sensor, and the grasps that were taught; the same for the same part."""

    def __init__(self, letter: str) -> None:
        self.fit = fit_of(letter)
        self.part, self.hole = self.fit.part, self.fit.hole
        self.template = Template.from_mesh(self.fit.mesh, units="mm", spacing_mm=0.3).with_grid()
        scene = sensor_scene()
        gel = scene.to_dict()["gel"]
        self.pitch_mm = gel["pitch_mm"]
        self.middle_mm = np.array([*gel["centre_mm"], gel["surface_mm"]])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "part.stl"
            self.fit.mesh.export(path)
            indenter = {"kind": "mesh", "path": str(path), "units": "mm"}
            self.simulator = Simulator(scene.replace({"indenter": indenter}))
        self.senses = Senses(self.simulator, {method.preset for method in METHODS})
        self.surface = SmoothSurface(self.fit.mesh)
        self.faces, self.is_ridged = Faces(self.template), is_ridged(self.fit.mesh)
        self.nominal = Hold.nominal(self.part, RANGES)
        self._taught: dict[str, Taught] = {}

    def lie(self, hold: Hold) -> Array:
        """Pose of the part that is held so, (4, 4) t_sensor_object."""
        return lie(hold, np.asarray(self.template.points_mm), self.middle_mm, self.hole.tip_mm)

    def grasp(self, t_sensor_object: Array, press_mm: float, seed: int) -> list[SimulatedFrame]:
        """Fingers that close on a part until it is there, having pressed it in so far: markers are followed by the way.

        Frames of a seed have numbers of their own, and noise with these.
        """
        frames = []
        for step in range(1, _CLOSING + 1):
            pose = np.array(t_sensor_object)
            pose[2, 3] += press_mm * (1.0 - step / _CLOSING)
            frames.append(self.simulator.press(pose, frame=_CLOSING * seed + step))
        return frames

    def find(self, method: Method, frame: Frame, seed: int) -> tuple[Found, Belief]:
        """Find the part from a frame of its contact, and what to believe of its pose."""
        surface_mm, patch_mm = np.asarray(self.template.points_mm), np.asarray(frame.patch_points_mm)
        if len(patch_mm) < _LEAST_PATCH:
            raise RegisterError(
                f"only {len(patch_mm)} markers are in contact; valid is {_LEAST_PATCH} or more: press deeper"
            )
        registering = Registering(method, frame, self.template)
        tried = registering.found(guesses(self.nominal, surface_mm, patch_mm, self.hole.tip_mm))
        if not method.tries_all:
            return tried[0], Belief.normal(tried[0], PRIOR)
        if not self.is_ridged:
            return tried[0], believed(tried, registering.held, PRIOR, seed)
        tried = registering.again(tried)
        pose = tried[0].t_sensor_object
        told = self.faces.information(
            pose, patch_mm, np.asarray(frame.covariance_mm2)[np.asarray(frame.patch)]
        )
        alike = markers_alike(pose[:3, 2], patch_mm, self.pitch_mm)
        return tried[0], believed(tried, registering.held, PRIOR, seed, told, alike)

    def least(self, t_sensor_object: Array, contact: SimulatedFrame, frame: Frame) -> Array:
        """Least covariance of the part's pose, in its own frame, (6, 6), from the heights of markers that touch."""
        seen = np.asarray(contact.in_contact) & (np.asarray(frame.state) == MarkerState.SEEN)
        return least_covariance(
            self.surface, t_sensor_object, contact.points_mm[seen], frame.covariance_mm2[seen], PRIOR
        )

    def told(self, hold: Hold, sigma_mm: float) -> tuple[int, Bound]:
        """How many markers touch a part that is held so, and what their heights tell, each known to `sigma_mm`."""
        t_sensor_object = self.lie(hold)
        contact = self.simulator.press(t_sensor_object)
        points_mm = contact.points_mm[contact.in_contact]
        covariance = np.tile(sigma_mm**2 * np.eye(3), (len(points_mm), 1, 1))
        least = least_covariance(self.surface, t_sensor_object, points_mm, covariance, PRIOR)
        bound = Bound.of(self.hole, self.fit.end, least, np.random.default_rng(_TAUGHT))
        return len(points_mm), bound

    def taught(self, method: Method) -> Taught:
        """Teach a method the hole: the part is held in the middle, stands ideally over it, and is found by it.

        So often as the method is taught, every time turned otherwise among the markers: an edge that lies along a row
        of them is known to a pitch only.
        """
        if method.name not in self._taught:
            errors, beliefs, least = [], [], []
            for turn_rad in method.taught_rad:
                hold = replace(self.nominal, pitch_rad=turn_rad)
                t_sensor_object = self.lie(hold)
                grasp = self.grasp(t_sensor_object, hold.press_mm, _TAUGHT)
                frame = self.senses.sense(method.preset, grasp)
                belief = self.find(method, frame, _TAUGHT)[1]
                least.append(self.least(t_sensor_object, grasp[-1], frame))
                errors.append(np.asarray(se3_log(np.linalg.inv(t_sensor_object) @ belief.t_sensor_object)))
                beliefs.append(belief)
            self._taught[method.name] = Taught(
                self.lie(self.nominal),
                tuple(beliefs),
                np.mean(errors, axis=0),
                np.sum(least, axis=0) / len(least) ** 2,
            )
        return self._taught[method.name]


#: Registration is not tried with fewer markers.
_LEAST_PATCH = 6


@lru_cache(maxsize=8)
def workplace(letter: str) -> Workplace:
    """Make a workplace once for each process."""
    return Workplace(letter)


def run(configuration: Configuration, seed: int) -> Record:
    """Grasp a part somewhere, find it by every method, and see whether it would go in.

    The record holds the grasp, the true pose, the ``bound`` of what the heights of the markers tell, and by method the
    pose that is acted on, ``room_mm`` between part and walls (below 0 it does not go in), the ``chance`` predicted from
    what is believed and of how many ``poses`` that is made (of a method that weighs poses; others predict nothing), the
    directions that the contact's faces leave ``free`` and which of them ``matters``, and the ``weakest``
    motion over the hole, all told; or ``refused``, why there is no pose.
    """
    place = workplace(configuration["part"])
    hold = Hold.drawn(place.part, RANGES, np.random.default_rng(seed))
    t_sensor_object = place.lie(hold)
    grasp = place.grasp(t_sensor_object, hold.press_mm, _FIRST + seed)
    frames = {preset: place.senses.sense(preset, grasp) for preset in {m.preset for m in METHODS}}
    ours = METHODS[-1]
    least = place.least(t_sensor_object, grasp[-1], frames[ours.preset]) + place.taught(ours).least
    random = np.random.default_rng([seed, 73])
    return {
        "hold": asdict(hold),
        "touching": int(np.count_nonzero(grasp[-1].in_contact)),
        "t_sensor_object": t_sensor_object.tolist(),
        "bound": asdict(Bound.of(place.hole, place.fit.end, least, random)),
        "methods": {
            method.name: _judged(place, method, frames[method.preset], t_sensor_object, seed)
            for method in METHODS
        },
    }


def _judged(place: Workplace, method: Method, frame: Frame, t_sensor_object: Array, seed: int) -> Record:
    """What one method finds, and what comes of it with a robot that moves exactly."""
    try:
        found, belief = place.find(method, frame, seed)
        taught = place.taught(method)
    except RegisterError as error:
        return {"refused": str(error)}
    t_hole_object = over_hole(t_sensor_object, belief.t_sensor_object, taught.pair)
    covariance = belief.covariance + sum(b.covariance for b in taught.beliefs) / len(taught.beliefs) ** 2
    predicted = {}
    if method.tries_all:
        random = np.random.default_rng([seed, 71])
        motions = belief.draw(random, SAMPLES) - drawn(taught.beliefs, random, SAMPLES)
        predicted = {"chance": chance(place.hole, place.fit.end, motions), "poses": len(belief.weights)}
    return {
        **predicted,
        "t_sensor_object": belief.t_sensor_object.tolist(),
        "taught": [pose.tolist() for pose in taught.pair],
        "error": np.asarray(se3_log(t_hole_object)).tolist(),
        "room_mm": place.fit.room_mm(t_hole_object),
        "converged": found.converged,
        "free": [str(free) for free in found.free],
        "matters": [str(free) for free in found.free if matters(place.hole, place.fit.end, free)],
        "weakest": weakest(place.hole, place.fit.end, covariance),
    }
