"""A common interface to the native pipeline and the plain OpenCV ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import MarkerState, Params, Pipeline, Rig, SimulatedFrame
from gelstereo_bench.frontier.baseline import Baseline, StereoGeometry

__all__ = ["Runner", "geometry_of", "repeat_last", "write_input"]

Array = npt.NDArray[np.float64]


def geometry_of(rig: Rig) -> StereoGeometry:
    """A rig in OpenCV's terms."""
    return StereoGeometry(
        rig.left_matrix,
        rig.left_distortion,
        rig.right_matrix,
        rig.right_distortion,
        rig.t_right_left[:3, :3],
        rig.t_right_left[:3, 3],
        rig.size_px,
    )


class Runner:
    """The native pipeline or the paper's in OpenCV."""

    def __init__(self, rig: Rig, params: Params, native: bool) -> None:
        self._pipeline = Pipeline(rig, params) if native else None
        self._baseline = None if native else Baseline(geometry_of(rig), params.to_dict())
        self._sorts = params.to_dict()["label"]["method"] == "foresight"
        #: Number of frames labelled from tracks because the sort failed.
        self.refusals = 0
        #: Markers of the last frame that the native pipeline classifies as in contact.
        self.salient: npt.NDArray[np.bool_] | None = None

    def process(self, frame: SimulatedFrame) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        """Left pixels, points and a mask of the markers seen."""
        if self._pipeline is not None:
            result = self._pipeline.process(frame.left, frame.right)
            self.refusals += self._sorts and "tracks" in (result.left.labels, result.right.labels)
            self.salient = result.salient
            return result.left_px, result.points_mm, result.state == MarkerState.SEEN
        assert self._baseline is not None
        found = self._baseline.process(frame.left, frame.right)
        return found.left_px, found.points_mm, found.seen


def repeat_last(runner: Runner, press: Sequence[SimulatedFrame]) -> Callable[[int], object]:
    """Function that processes a press, then alternates between its last two frames with every call."""
    for frame in press:
        runner.process(frame)
    return lambda turn: runner.process(press[-1 - turn % 2])


def write_input(
    folder: Path, params: Params, frames: Sequence[SimulatedFrame], rig: Rig | None = None
) -> list[Path]:
    """Write settings, the rig, and images of both views for the core's programs; without a rig, of the left
    view.
    """
    params.save(folder / "params.toml")
    files = [folder / "params.toml"]
    if rig is not None:
        rig.save(folder / "rig.toml")
        files.append(folder / "rig.toml")
    for frame in frames:
        for view in ("left",) if rig is None else ("left", "right"):
            files.append(folder / f"{view}{frame.index}.pgm")
            cv2.imwrite(str(files[-1]), getattr(frame, view))
    return files
