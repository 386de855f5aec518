"""One grasp, by every method: where the part lies, what is found, and whether it goes into the hole."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, RegisterError, Scene, SimulatedFrame, Simulator, Template
from gelstereo.experiments.batch import Configuration
from gelstereo.experiments.insertion.chance import Prior, chance, object_covariance, weakest
from gelstereo.experiments.insertion.grasp import GraspRanges, Hold, fit_of, guesses, lie
from gelstereo.experiments.insertion.robot import over_hole
from gelstereo.experiments.insertion.sense import METHODS, Found, Method, Senses, find
from gelstereo.experiments.store import Record
from gelstereo.frontier.scenes import VGA
from gelstereo.geometry import se3_log

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
    """The grasp over the hole from which a method learned where the part must go: truth, and what it found."""

    t_sensor_object: Array
    found: Found

    @property
    def pair(self) -> tuple[Array, Array]:
        """True and found pose, as `over_hole` wants them."""
        return self.t_sensor_object, self.found.t_sensor_object


class Workplace:
    """A part, its hole, the sensor, and the grasps that were taught; the same for the same part."""

    def __init__(self, letter: str) -> None:
        self.fit = fit_of(letter)
        self.part, self.hole = self.fit.part, self.fit.hole
        self.template = Template.from_mesh(self.fit.mesh, units="mm", spacing_mm=0.3).with_grid()
        scene = sensor_scene()
        gel = scene.to_dict()["gel"]
        self.middle_mm = np.array([*gel["centre_mm"], gel["surface_mm"]])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "part.stl"
            self.fit.mesh.export(path)
            indenter = {"kind": "mesh", "path": str(path), "units": "mm"}
            self.simulator = Simulator(scene.replace({"indenter": indenter}))
        self.senses = Senses(self.simulator, {method.preset for method in METHODS})
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

    def find(self, method: Method, frame: Frame) -> Found:
        """Find the part from a frame of its contact."""
        surface_mm, patch_mm = np.asarray(self.template.points_mm), np.asarray(frame.patch_points_mm)
        if len(patch_mm) < _LEAST_PATCH:
            raise RegisterError(
                f"only {len(patch_mm)} markers are in contact; valid is {_LEAST_PATCH} or more: press deeper"
            )
        starts = guesses(self.nominal, surface_mm, patch_mm, self.hole.tip_mm)
        return find(method, frame, self.template, starts)

    def taught(self, method: Method) -> Taught:
        """Teach a method the hole: the part is held in the middle, stands ideally over it, and is found by it."""
        if method.name not in self._taught:
            t_sensor_object = self.lie(self.nominal)
            grasp = self.grasp(t_sensor_object, self.nominal.press_mm, _TAUGHT)
            found = self.find(method, self.senses.sense(method.preset, grasp))
            self._taught[method.name] = Taught(t_sensor_object, found)
        return self._taught[method.name]


#: Registration is not tried with fewer markers.
_LEAST_PATCH = 6


@lru_cache(maxsize=8)
def workplace(letter: str) -> Workplace:
    """Make a workplace once for each process."""
    return Workplace(letter)


def run(configuration: Configuration, seed: int) -> Record:
    """Grasp a part somewhere, find it by every method, and see whether it would go in.

    The record holds the grasp, the true pose, and by method the pose found, ``room_mm`` between part and walls (below
    0 it does not go in), the ``chance`` predicted from the covariance, the free directions, and the ``weakest`` of the
    others; or ``refused``, why there is no pose.
    """
    place = workplace(configuration["part"])
    hold = Hold.drawn(place.part, RANGES, np.random.default_rng(seed))
    t_sensor_object = place.lie(hold)
    grasp = place.grasp(t_sensor_object, hold.press_mm, _FIRST + seed)
    frames = {preset: place.senses.sense(preset, grasp) for preset in {m.preset for m in METHODS}}
    return {
        "hold": asdict(hold),
        "touching": int(np.count_nonzero(grasp[-1].in_contact)),
        "t_sensor_object": t_sensor_object.tolist(),
        "methods": {
            method.name: _judged(place, method, frames[method.preset], t_sensor_object, seed)
            for method in METHODS
        },
    }


def _judged(place: Workplace, method: Method, frame: Frame, t_sensor_object: Array, seed: int) -> Record:
    """What one method finds, and what comes of it with a robot that moves exactly."""
    try:
        found = place.find(method, frame)
        taught = place.taught(method)
    except RegisterError as error:
        return {"refused": str(error)}
    t_hole_object = over_hole(t_sensor_object, found.t_sensor_object, taught.pair)
    covariance = object_covariance(found, PRIOR) + object_covariance(taught.found, PRIOR)
    return {
        "t_sensor_object": found.t_sensor_object.tolist(),
        "taught": [pose.tolist() for pose in taught.pair],
        "error": np.asarray(se3_log(t_hole_object)).tolist(),
        "room_mm": place.fit.room_mm(t_hole_object),
        "chance": chance(place.hole, place.fit.end, covariance, seed),
        "converged": found.converged,
        "free": list(found.free),
        "weakest": weakest(place.hole, covariance),
    }
