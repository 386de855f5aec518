"""Ways from a stereo frame to points and contact: all combinations of rungs, the paper's, and OpenCV's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from gelstereo import Frame, MarkerState, Params, Pipeline
from gelstereo.tune.rungs import Rung, combinations, params_of
from gelstereo_bench.frontier.baseline import Baseline, BaselineFrame
from gelstereo_bench.frontier.baseline_fast import FastBaseline
from gelstereo_bench.frontier.pipeline.cases import Shot, Take
from gelstereo_bench.frontier.runners import geometry_of

__all__ = [
    "OPENCV",
    "PAPER",
    "Family",
    "Found",
    "Sensing",
    "Sensor",
    "rungs_text",
    "seen_of",
    "sensing_methods",
    "sensing_preset",
]

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

#: One style in the figure.
Family = Literal["soft threshold", "fit", "fine fit", "paper", "peer"]

PAPER = "paper"
#: The OpenCV pipeline written for speed, behind which other libraries register.
OPENCV = "OpenCV"
_OPENCV_PLAIN = "OpenCV, the paper's steps"
_PRESETS = ("fast", "balanced", "exact")
#: Tables of the settings on which sensing depends.
_STAGES = ("detect", "label", "track", "triangulate", "contact")


#: What pipelines return.
Found: TypeAlias = Frame | BaselineFrame


class Sensor(Protocol):
    """One pipeline in use."""

    def start(self, shot: Shot) -> Found:
        """Process the untouched first frame."""

    def process(self, shot: Shot) -> Found:
        """Process the next frame; this is what is timed."""


def seen_of(found: Found) -> Flags:
    """(N,) markers that were found in this frame."""
    if isinstance(found, BaselineFrame):
        return np.asarray(found.seen, bool)
    return np.asarray(found.state == MarkerState.SEEN)


@dataclass(frozen=True)
class Sensing:
    """One way to sense."""

    name: str
    family: Family
    open: Callable[[Take], Sensor]
    #: One of detect, points and contact; none for the paper's and OpenCV's.
    rungs: tuple[Rung, ...] = ()
    params: Params | None = None

    def correction_mm(self, take: Take, at_rest: Found) -> Array:
        """(N, 3) what is added to this method's points.

        Methods that assume straight light receive the true positions of all markers at rest if there is
        refraction; otherwise they would only show that they are off by millimetres. For the others it is 0.
        """
        first = take.shots[0].points_mm
        if self.rungs or not take.is_layered:
            return np.zeros_like(first)
        return np.asarray(first - at_rest.points_mm)


class _Native:
    def __init__(self, take: Take, params: Params) -> None:
        self._pipeline = Pipeline(take.rig, params.replace({"lattice.pitch_mm": take.pitch_mm}))

    def start(self, shot: Shot) -> Found:
        return self.process(shot)

    def process(self, shot: Shot) -> Found:
        return self._pipeline.process(shot.left, shot.right)


class _OpenCV:
    """Receives the true marker positions of the first frame."""

    def __init__(self, take: Take) -> None:
        params = Params.preset("balanced").to_dict()
        for stage, settings in take.by_hand.items():
            params[stage] = params[stage] | dict(settings)
        self._pipeline = FastBaseline(geometry_of(take.rig), params)

    def start(self, shot: Shot) -> Found:
        return self._pipeline.process(shot.left, shot.right, (shot.left_px, shot.right_px))

    def process(self, shot: Shot) -> Found:
        return self._pipeline.process(shot.left, shot.right)


class _Plain:
    def __init__(self, take: Take) -> None:
        side = math.isqrt(len(take.shots[0].points_mm))
        params = Params.preset("paper").to_dict()
        self._pipeline = Baseline(geometry_of(take.rig), params, lattice=(side, side))

    def start(self, shot: Shot) -> Found:
        return self.process(shot)

    def process(self, shot: Shot) -> Found:
        return self._pipeline.process(shot.left, shot.right)


def rungs_text(rungs: tuple[Rung, ...]) -> str:
    """Names of rungs in the order of the pipeline."""
    return " / ".join(rung.name for rung in rungs)


def _native(params: Params) -> Callable[[Take], Sensor]:
    return lambda take: _Native(take, params)


def sensing_methods() -> list[Sensing]:
    """All combinations of detection, points and contact; then the paper's and OpenCV's."""
    found = []
    for rungs in combinations(("detect", "points", "contact")):
        family: Family = "soft threshold"
        if rungs[0].name.startswith("fine fit"):
            family = "fine fit"
        elif rungs[0].name.startswith("fit"):
            family = "fit"
        params = params_of(rungs)
        found.append(Sensing(rungs_text(rungs), family, _native(params), rungs, params))
    paper = Params.preset("paper")
    return [
        *found,
        Sensing(PAPER, "paper", _native(paper), params=paper),
        Sensing(OPENCV, "peer", _OpenCV),
        Sensing(_OPENCV_PLAIN, "peer", _Plain),
    ]


def sensing_preset(method: Sensing) -> tuple[str, ...]:
    """Presets that sense like this."""
    if method.params is None or method.name == PAPER:
        return ()
    own = method.params.to_dict()
    presets = {name: Params.preset(name).to_dict() for name in _PRESETS}
    return tuple(name for name, other in presets.items() if all(own[s] == other[s] for s in _STAGES))
