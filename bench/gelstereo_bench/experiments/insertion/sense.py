"""What a sensor and a method make of a grasp: sensed by a pipeline, registered by a rung."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Error,
    Frame,
    FreeDirection,
    Localization,
    Params,
    Pipeline,
    RegisterError,
    RestRecord,
    SimulatedFrame,
    Simulator,
    Template,
    localize,
)
from gelstereo.geometry import se3_exp
from gelstereo.states import MarkerState

__all__ = ["METHODS", "Found", "Method", "Registering", "Senses"]

Array = npt.NDArray[np.float64]


#: Of the grasp that is taught: a little, since rows of markers along an edge see it badly.
NOMINAL_PITCH_RAD = 0.1


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
    #: Pitches of the grasps over the hole that it is taught by; the paper teaches one (section V-A).
    taught_rad: tuple[float, ...] = (NOMINAL_PITCH_RAD,)

    def params(self) -> Params:
        """All settings."""
        return Params.preset(self.preset).replace({"register.method": self.register})

    def near(self) -> Params:
        """Settings of a search that is not wide."""
        return self.params().replace({"register": {"start_sigma_mm": 0.5, "start_sigma_deg": 1.0}})

    def held(self, by_mm: float) -> Params:
        """Settings that look near a guess only, which holds the pose by a prior of so many mm."""
        near = {
            "start_sigma_mm": by_mm,
            "start_sigma_deg": 5.0 * by_mm,
            "surface_search": {"starts": 1},
            "advanced": {"max_iterations": 4},
        }
        return self.params().replace({"register": near})


#: The paper's two, on the paper's sensing, and ours.
METHODS = (
    Method("FilterReg, point to point", "paper", "filterreg_point"),
    Method("RANSAC + ICP", "paper", "ransac_icp"),
    Method("surface search", "balanced", "surface_search", tries_all=True, taught_rad=(-0.4, -0.2, 0.2, 0.4)),
)


@dataclass(frozen=True)
class Found:
    """A pose with its evidence; sensor frame, mm."""

    t_sensor_object: Array
    #: (6, 6) of a left perturbation (ω, v) of the pose; singular along what is free.
    information: Array
    converged: bool
    free: tuple[FreeDirection, ...]
    #: Centroid of the patch.
    centre_mm: Array
    #: Of methods that try all.
    log_likelihood: float

    @classmethod
    def of(cls, found: Localization, patch_mm: Array) -> Found:
        """Keep what an insertion needs."""
        return cls(
            np.array(found.t_sensor_object),
            np.array(found.information),
            found.converged,
            tuple(found.free),
            patch_mm.mean(axis=0),
            -np.inf if found.log_likelihood is None else found.log_likelihood,
        )

    def moved(self, turn_rad: float, along_mm: float) -> Array:
        """Pose of the part turned about the sensor's normal through the patch, and slid along its own axis, (4, 4)."""
        turn = np.array(se3_exp([0.0, 0.0, turn_rad, 0.0, 0.0, 0.0]), np.float64)
        turn[:3, 3] = self.centre_mm - turn[:3, :3] @ self.centre_mm
        slid = np.array(self.t_sensor_object)
        slid[:3, 3] += along_mm * slid[:3, 2]
        return np.asarray(turn @ slid)


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


#: Where a part may be instead of where it was found, by a search of the whole and by one of what is near: turns about
#: the sensor's normal, rad, and slides along the part's axis, mm, as far as a hand may hold it from the guess.
_WIDE = ((0.0, 0.0), (0.0, -3.0), (0.0, 3.0))
_NEAR = ((-0.012, 0.0), (0.012, 0.0), (0.0, -2.0), (0.0, -1.0), (0.0, 1.0), (0.0, 2.0))
#: By how much it has to be likelier there, in logarithms.
_SURELY = 1.0


@dataclass(frozen=True)
class Registering:
    """A method at work on a frame's contact patch."""

    method: Method
    frame: Frame
    template: Template

    def found(self, guesses: Sequence[Array]) -> list[Found]:
        """Register from the first guess, or from all of them; the likeliest pose comes first.

        Raises
        ------
        RegisterError
            If there is too little of it.
        """
        params = self.method.params()
        tried = [self._from(guess, params) for guess in guesses[: None if self.method.tries_all else 1]]
        return sorted(tried, key=lambda found: -found.log_likelihood)

    def again(self, tried: Sequence[Found]) -> list[Found]:
        """Register from about the best pose once more; the likeliest pose comes first, the others follow.

        An end of the part that the gel just reaches tells where along its axis it lies, and edges how it is turned,
        both from close by only. Where nothing tells, the part stays where it was found: what is hardly likelier is
        left out.
        """
        found = list(tried)
        best, whole, near = tried[0], self.method.params(), self.method.near()
        for params, moves in ((whole, _WIDE), (near, _NEAR)):
            for turn_rad, along_mm in moves:
                other = self._tried(best.moved(turn_rad, along_mm), params)
                if other is not None and other.log_likelihood > found[0].log_likelihood + _SURELY:
                    found.insert(0, other)
        return found

    def near(self, guess: Array) -> Found:
        """Register from a guess that earlier looks make.

        Raises
        ------
        RegisterError
            If there is too little of it.
        """
        return self._from(guess, self.method.near())

    def held(self, guess: Array, by_mm: float) -> Found | None:
        """Register close to a guess, `Method.held`; None if that leaves nothing to register."""
        return self._tried(guess, self.method.held(by_mm))

    def _tried(self, guess: Array, params: Params) -> Found | None:
        try:
            return self._from(guess, params)
        except RegisterError:
            return None

    def _from(self, guess: Array, params: Params) -> Found:
        patch_mm, seen = self.frame.patch_points_mm, np.asarray(self.frame.state) == MarkerState.SEEN
        found = localize(
            patch_mm,
            self.template,
            t_sensor_object=guess,
            all_points_mm=self.frame.points_mm[seen],
            covariance_mm2=self.frame.covariance_mm2[self.frame.patch],
            params=params,
        )
        return Found.of(found, patch_mm)
