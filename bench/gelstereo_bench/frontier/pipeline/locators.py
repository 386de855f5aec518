"""Ways from sensed points to a pose: the rungs of registration, the paper's method, and other libraries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, Params, localize
from gelstereo.tune.rungs import Rung, params_of, rungs_of
from gelstereo_bench.frontier.grasps import Grasp
from gelstereo_bench.frontier.pipeline.cases import Body
from gelstereo_bench.frontier.pipeline.sensors import OPENCV, PAPER, Found, Sensing
from gelstereo_bench.frontier.rivals import Method, rivals

__all__ = ["Combination", "Sensed", "combined"]

Array = npt.NDArray[np.float64]

#: A pose of another library may scale lengths by this share: 1 um at 10 mm, below every error in question.
_RIGID = 1e-4


@dataclass(frozen=True)
class Sensed:
    """A frame's result, and its points (N, 3) as registration receives them, mm."""

    found: Found
    points_mm: Array

    @property
    def patch_mm(self) -> Array:
        """(M, 3) points in contact."""
        return np.asarray(self.points_mm[self.found.salient])


#: Function from a sensed frame, the part and a guess to (4, 4) t_sensor_object.
Locate = Callable[[Sensed, Body, Array], Array]


@dataclass(frozen=True)
class Combination:
    """A way to sense, and a registration method behind it."""

    sensing: Sensing
    locator: str
    locate: Locate
    #: The rung of registration; None for the paper's method and other libraries.
    rung: Rung | None = None
    params: Params | None = None

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.sensing.name} / {self.locator}"


def combined(sensing: list[Sensing]) -> tuple[list[Combination], dict[str, str]]:
    """All registration methods behind the given ways to sense.

    Returns
    -------
    combinations : list of Combination
        Every rung behind every combination of sensing rungs, the paper's method behind the paper's sensing,
        and the other libraries behind OpenCV.
    missing : dict of str to str
        Libraries that cannot be loaded, with the reason.
    """
    others, missing = rivals()
    found = []
    for method in sensing:
        if method.rungs:
            for rung in rungs_of("register"):
                params = params_of((*method.rungs, rung))
                found.append(Combination(method, rung.name, _native(params), rung, params))
        elif method.name == PAPER:
            params = Params.preset("paper")
            name = str(params.to_dict()["register"]["method"])
            found.append(Combination(method, name, _paper(params), params=params))
        elif method.name == OPENCV:
            found += [Combination(method, name, _rival(other)) for name, other in others.items()]
    return found, missing


def _native(params: Params) -> Locate:
    """Registration with all that a frame says."""

    def locate(sensed: Sensed, body: Body, guess: Array) -> Array:
        assert isinstance(sensed.found, Frame)
        return np.asarray(localize(sensed.found, body.template, guess=guess, params=params).t_sensor_object)

    return locate


def _paper(params: Params) -> Locate:
    """Registration of the points in contact alone."""

    def locate(sensed: Sensed, body: Body, guess: Array) -> Array:
        return np.asarray(
            localize(sensed.patch_mm, body.template, guess=guess, params=params).t_sensor_object
        )

    return locate


def _rival(method: Method) -> Locate:
    """Another library, which receives the points in contact; it does not use the rest of a `Grasp`."""
    none = np.empty((0, 3))

    def locate(sensed: Sensed, body: Body, guess: Array) -> Array:
        cloud = (sensed.patch_mm, np.empty((0, 3, 3)), none, none)
        return _rigid(method(Grasp(body.name, body.mesh, body.template, *cloud, guess), guess))

    return locate


def _rigid(pose: Array) -> Array:
    """The nearest rigid motion, because some libraries calculate in single precision.

    Raises
    ------
    ValueError
        The pose is far from rigid or not finite.
    """
    pose = np.array(pose, np.float64)
    if not np.all(np.isfinite(pose)):
        raise ValueError("the pose is not finite")
    u, scales, v = np.linalg.svd(pose[:3, :3])
    if np.abs(scales - 1.0).max() > _RIGID or np.linalg.det(u @ v) < 0.0:
        raise ValueError(f"the pose scales lengths by {scales} or reflects")
    pose[:3, :3] = u @ v
    return pose
