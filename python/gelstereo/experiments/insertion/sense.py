"""What a sensor and a method make of a grasp: sensed by a pipeline, registered by a rung."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Error,
    Frame,
    Localization,
    Params,
    Pipeline,
    RestRecord,
    SimulatedFrame,
    Simulator,
    Template,
    localize,
)
from gelstereo.states import MarkerState

__all__ = ["METHODS", "Found", "Method", "Senses", "find"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """How images become a pose."""

    name: str
    #: Preset that senses.
    preset: str
    #: Rung that registers.
    register: str
    #: Whether it tells which of several poses is the likeliest, and so may start from all guesses.
    tries_all: bool = False

    def params(self) -> Params:
        """All settings."""
        return Params.preset(self.preset).replace({"register.method": self.register})


#: The paper's two, on the paper's sensing, and ours.
METHODS = (
    Method("FilterReg, point to point", "paper", "filterreg_point"),
    Method("FilterReg, point to plane", "paper", "filterreg_plane"),
    Method("RANSAC + ICP", "paper", "ransac_icp"),
    Method("surface search", "balanced", "surface_search", tries_all=True),
)


@dataclass(frozen=True)
class Found:
    """A pose with its evidence; sensor frame, mm."""

    t_sensor_object: Array
    #: (6, 6) of a left perturbation (ω, v) of the pose; singular along what is free.
    information: Array
    converged: bool
    free: tuple[str, ...]
    #: Centroid of the patch.
    centre_mm: Array

    @classmethod
    def of(cls, found: Localization, patch_mm: Array) -> Found:
        """Keep what an insertion needs."""
        return cls(
            np.array(found.t_sensor_object),
            np.array(found.information),
            found.converged,
            tuple(map(str, found.free)),
            patch_mm.mean(axis=0),
        )


class Senses:
    """Pipelines that know the sensor at rest, one for each preset."""

    def __init__(self, simulator: Simulator, presets: Iterable[str]) -> None:
        """`simulator` shows the sensor; in its first frame nothing touches."""
        still = simulator.scene.replace({"indenter": None, "trajectory": []})
        self._rest = rest = Simulator(still)[0]
        self._pipelines: dict[str, tuple[Pipeline, RestRecord]] = {}
        for preset in presets:
            pipeline = Pipeline(simulator.scene.rig, Params.preset(preset))
            pipeline.process(rest.left, rest.right)
            record = pipeline.rest_record()
            if record is None:
                raise Error(f"preset {preset} does not find the sensor's lattice in the rest frame")
            self._pipelines[preset] = (pipeline, record)

    def sense(self, preset: str, grasp: Sequence[SimulatedFrame]) -> Frame:
        """What a preset sees in the last frame of a grasp that follows the rest frame."""
        pipeline, record = self._pipelines[preset]
        pipeline.resume(record)
        for pair in (self._rest, *grasp[:-1]):
            pipeline.process(pair.left, pair.right)
        return pipeline.process(grasp[-1].left, grasp[-1].right)


def find(method: Method, frame: Frame, template: Template, guesses: Sequence[Array]) -> Found:
    """Register a frame's contact patch, from the first guess or from all of them; the likeliest pose counts.

    Raises
    ------
    RegisterError
        If there is too little of it.
    """
    seen = np.asarray(frame.state) == MarkerState.SEEN
    patch_mm = frame.patch_points_mm

    def register(guess: Array) -> Localization:
        return localize(
            patch_mm,
            template,
            t_sensor_object=guess,
            all_points_mm=frame.points_mm[seen],
            covariance_mm2=frame.covariance_mm2[frame.patch],
            params=method.params(),
        )

    tried = [register(guess) for guess in guesses[: len(guesses) if method.tries_all else 1]]
    best = max(tried, key=lambda found: -np.inf if found.log_likelihood is None else found.log_likelihood)
    return Found.of(best, patch_mm)
