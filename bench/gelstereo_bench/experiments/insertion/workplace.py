"""A part, its hole and the sensor: grasping the part, and localizing it."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, RegisterError, Scene, SimulatedFrame, Simulator, Template
from gelstereo.states import MarkerState
from gelstereo_bench.experiments.insertion.belief import Belief
from gelstereo_bench.experiments.insertion.bound import Bound, SmoothSurface, covariance_bound
from gelstereo_bench.experiments.insertion.chance import Prior
from gelstereo_bench.experiments.insertion.face import Faces, is_ridged
from gelstereo_bench.experiments.insertion.grasp import GraspRanges, Hold, fit_of, guesses, lie, reaching
from gelstereo_bench.experiments.insertion.rows import markers_alike
from gelstereo_bench.experiments.insertion.sampling import believed
from gelstereo_bench.experiments.insertion.sense import METHODS, Found, Method, Registering, Senses
from gelstereo_bench.frontier.scenes import VGA

__all__ = ["PRIOR", "RANGES", "Workplace", "sensor_scene", "workplace"]

Array = npt.NDArray[np.float64]

#: Number of frames while the fingers close: at 30 Hz, an indentation of 1 mm at 7 mm/s.
_CLOSING = 4


#: Ranges of parts' poses, and their prior.
RANGES, PRIOR = GraspRanges(), Prior()


def sensor_scene() -> Scene:
    """Scene of the sensor that all parts are pressed on."""
    return VGA.scene()


class Workplace:
    """A part, its hole and the sensor; identical for the same part."""

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

    def lie(self, hold: Hold) -> Array:
        """Pose of the part in this hold, (4, 4) t_sensor_object."""
        return lie(hold, np.asarray(self.template.points_mm), self.middle_mm, self.hole.tip_mm)

    def grasp(self, t_sensor_object: Array, press_mm: float, seed: int) -> list[SimulatedFrame]:
        """Frames while the fingers close on a part up to a pose and an indentation depth, so that markers can
        be tracked.

        Frame numbers depend on the seed, and the noise on the frame number.
        """
        frames = []
        for step in range(1, _CLOSING + 1):
            pose = np.array(t_sensor_object)
            pose[2, 3] += press_mm * (1.0 - step / _CLOSING)
            frames.append(self.simulator.press(pose, frame=_CLOSING * seed + step))
        return frames

    def reached(self, t_sensor_object: Array, press_mm: float) -> Array:
        """Pose of the part, (4, 4), after fingers that close along the gel's normal have pressed it in to a
        depth.
        """
        points = np.asarray(self.template.points_mm)
        return reaching(t_sensor_object, points, self.middle_mm, self.middle_mm[2] - press_mm)

    def find(
        self, method: Method, frame: Frame, seed: int, before: Belief | None = None
    ) -> tuple[Found, Belief]:
        """Localize the part from a frame of its contact; returns the registration and the belief.

        `before` is the belief after earlier looks, in this frame; registration starts from it.
        """
        surface_mm, patch_mm = np.asarray(self.template.points_mm), np.asarray(frame.patch_points_mm)
        if len(patch_mm) < _MIN_PATCH:
            raise RegisterError(
                f"only {len(patch_mm)} markers are in contact; valid is {_MIN_PATCH} or more: press deeper"
            )
        registering = Registering(method, frame, self.template)
        if before is None:
            tried = registering.found(guesses(self.nominal, surface_mm, patch_mm, self.hole.tip_mm))
        else:
            tried = [registering.near(before.t_sensor_object)]
        if not method.tries_all:
            return tried[0], Belief.normal(tried[0], PRIOR)
        if not self.is_ridged:
            return tried[0], believed(tried, registering.held, PRIOR, seed, before=before)
        tried = registering.again(tried)
        pose = tried[0].t_sensor_object
        from_heights = self.faces.information(
            pose, patch_mm, np.asarray(frame.covariance_mm2)[np.asarray(frame.patch)]
        )
        alike = markers_alike(pose[:3, 2], patch_mm, self.pitch_mm)
        return tried[0], believed(tried, registering.held, PRIOR, seed, from_heights, alike, before)

    def covariance_bound(self, t_sensor_object: Array, contact: SimulatedFrame, frame: Frame) -> Array:
        """Cramér-Rao bound of the part's pose, in its own frame, (6, 6), from the heights of markers in
        contact.
        """
        seen = np.asarray(contact.in_contact) & (np.asarray(frame.state) == MarkerState.SEEN)
        return covariance_bound(
            self.surface, t_sensor_object, contact.points_mm[seen], frame.covariance_mm2[seen], PRIOR
        )

    def bound_of(self, hold: Hold, sigma_mm: float) -> tuple[int, Bound]:
        """Number of markers in contact in this hold, and the bound from their heights with standard deviation
        `sigma_mm`.
        """
        t_sensor_object = self.lie(hold)
        contact = self.simulator.press(t_sensor_object)
        points_mm = contact.points_mm[contact.in_contact]
        covariance = np.tile(sigma_mm**2 * np.eye(3), (len(points_mm), 1, 1))
        of_part = covariance_bound(self.surface, t_sensor_object, points_mm, covariance, PRIOR)
        bound = Bound.of(self.hole, self.fit.end, of_part, np.random.default_rng(1))
        return len(points_mm), bound


#: Minimum number of markers for registration.
_MIN_PATCH = 6


@lru_cache(maxsize=8)
def workplace(letter: str) -> Workplace:
    """Create a workplace, once per process."""
    return Workplace(letter)
