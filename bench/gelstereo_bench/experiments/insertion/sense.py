"""Sensing and registration of a grasp: a pipeline preset and a registration rung."""

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

__all__ = ["METHODS", "Found", "Method", "Registering", "Senses"]

Array = npt.NDArray[np.float64]


#: Pitch of the taught grasp: a small angle, because rows of markers parallel to an edge locate it poorly.
NOMINAL_PITCH_RAD = 0.1


@dataclass(frozen=True)
class Method:
    """A method from images to a pose."""

    name: str
    #: Preset of the pipeline.
    preset: str
    #: Registration rung.
    register: str
    #: Whether it compares poses by likelihood, and so may start from all guesses.
    tries_all: bool = False
    #: Pitches of the taught grasps over the hole; the paper teaches one (section V-A).
    taught_rad: tuple[float, ...] = (NOMINAL_PITCH_RAD,)

    def params(self) -> Params:
        """All settings."""
        return Params.preset(self.preset).replace({"register.method": self.register})

    def near(self) -> Params:
        """Settings of a narrow search."""
        return self.params().replace({"register": {"start_sigma_mm": 0.5, "start_sigma_deg": 1.0}})

    def held(self, by_mm: float) -> Params:
        """Settings that search only near a guess, with a prior of the given width, mm."""
        near = {
            "start_sigma_mm": by_mm,
            "start_sigma_deg": 5.0 * by_mm,
            "surface_search": {"starts": 1},
            "advanced": {"max_iterations": 4},
        }
        return self.params().replace({"register": near})


#: The paper's two methods, with the paper's sensing, and ours.
METHODS = (
    Method("FilterReg, point to point", "paper", "filterreg_point"),
    Method("RANSAC + ICP", "paper", "ransac_icp"),
    Method("surface search", "balanced", "surface_search", tries_all=True, taught_rad=(-0.4, -0.2, 0.2, 0.4)),
)


@dataclass(frozen=True)
class Found:
    """A pose with its evidence; sensor frame, mm."""

    t_sensor_object: Array
    #: (6, 6) information of a left perturbation (ω, v) of the pose; singular along free directions.
    information: Array
    converged: bool
    free: tuple[FreeDirection, ...]
    #: Centroid of the patch.
    centre_mm: Array
    #: For methods that try all guesses.
    log_likelihood: float

    @classmethod
    def of(cls, found: Localization, patch_mm: Array) -> Found:
        """Extract the data for an insertion."""
        return cls(
            np.array(found.t_sensor_object),
            np.array(found.information),
            found.converged,
            tuple(found.free),
            patch_mm.mean(axis=0),
            -np.inf if found.log_likelihood is None else found.log_likelihood,
        )

    def moved(self, turn_rad: float, along_mm: float) -> Array:
        """Pose (4, 4) of the part rotated about the sensor's normal through the patch and shifted along its
        axis.
        """
        turn = np.array(se3_exp([0.0, 0.0, turn_rad, 0.0, 0.0, 0.0]), np.float64)
        turn[:3, 3] = self.centre_mm - turn[:3, :3] @ self.centre_mm
        slid = np.array(self.t_sensor_object)
        slid[:3, 3] += along_mm * slid[:3, 2]
        return np.asarray(turn @ slid)


class Senses:
    """Pipelines initialised with the sensor at rest, one for each preset."""

    def __init__(self, simulator: Simulator, presets: Iterable[str]) -> None:
        """`simulator` is the sensor; nothing touches it in its first frame."""
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
        """The last frame of a grasp after the rest frame, as sensed by a preset."""
        pipeline, record = self._pipelines[preset]
        pipeline.resume(record)
        for pair in (self._rest, *grasp[:-1]):
            pipeline.process(pair.left, pair.right)
        return pipeline.process(grasp[-1].left, grasp[-1].right)


#: Alternative poses to try for a wide and for a narrow search: rotations about the sensor's normal, rad, and
#: shifts along the part's axis, mm, within the range of possible holds.
_WIDE = ((0.0, 0.0), (0.0, -3.0), (0.0, 3.0))
_NEAR = ((-0.012, 0.0), (0.012, 0.0), (0.0, -2.0), (0.0, -1.0), (0.0, 1.0), (0.0, 2.0))
#: Minimum gain of log likelihood for an alternative pose.
_MIN_LOG_GAIN = 1.0


@dataclass(frozen=True)
class Registering:
    """A method applied to a frame's contact patch."""

    method: Method
    frame: Frame
    template: Template

    def found(self, guesses: Sequence[Array]) -> list[Found]:
        """Register from the first guess, or from all of them; returns poses in order of likelihood.

        Raises
        ------
        RegisterError
            If the patch has too few points.
        """
        params = self.method.params()
        tried = [self._from(guess, params) for guess in guesses[: None if self.method.tries_all else 1]]
        return sorted(tried, key=lambda found: -found.log_likelihood)

    def again(self, tried: Sequence[Found]) -> list[Found]:
        """Register again from poses around the best one; the likeliest pose comes first, the others follow.

        A part's end at the border of the gel determines its position along the axis, and edges determine its
        rotation, but both only from a close start. Where neither is visible the part keeps its pose:
        alternatives that are only slightly likelier are dropped.
        """
        found = list(tried)
        best, whole, near = tried[0], self.method.params(), self.method.near()
        for params, moves in ((whole, _WIDE), (near, _NEAR)):
            for turn_rad, along_mm in moves:
                other = self._tried(best.moved(turn_rad, along_mm), params)
                if other is not None and other.log_likelihood > found[0].log_likelihood + _MIN_LOG_GAIN:
                    found.insert(0, other)
        return found

    def near(self, guess: Array) -> Found:
        """Register from a guess by earlier looks.

        Raises
        ------
        RegisterError
            If the patch has too few points.
        """
        return self._from(guess, self.method.near())

    def held(self, guess: Array, by_mm: float) -> Found | None:
        """Register close to a guess with `Method.held`; None if nothing remains to be registered."""
        return self._tried(guess, self.method.held(by_mm))

    def _tried(self, guess: Array, params: Params) -> Found | None:
        try:
            return self._from(guess, params)
        except RegisterError:
            return None

    def _from(self, guess: Array, params: Params) -> Found:
        found = localize(self.frame, self.template, guess=guess, params=params)
        return Found.of(found, self.frame.patch_points_mm)
