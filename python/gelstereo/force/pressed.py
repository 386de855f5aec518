"""Markers under loads, from a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Error, MarkerState, Params, Pipeline, RestSurface
from gelstereo.force.loads import Load, LoadsError
from gelstereo.setup.sensor import Sensor

__all__ = ["Pressed", "RestState", "pressed_frames"]

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class RestState:
    """Markers at rest.

    Attributes
    ----------
    surface : RestSurface
    covariance_mm2 : (N, 3, 3) float64
    cols : int
    """

    surface: RestSurface
    covariance_mm2: Floats
    cols: int

    @property
    def axes(self) -> Floats:
        """(3, 3) unit vectors: towards the camera, along the rows, along the columns."""
        points = np.asarray(self.surface.points_mm).reshape(-1, self.cols, 3)
        into = np.asarray(self.surface.normal)
        right = (points[:, -1] - points[:, 0]).mean(axis=0)
        right -= into * (right @ into)
        right /= np.linalg.norm(right)
        down = (points[-1] - points[0]).mean(axis=0)
        down -= into * (down @ into) + right * (down @ right)
        return np.stack([into, right, down / np.linalg.norm(down)])


@dataclass(frozen=True)
class Pressed:
    """Markers of one frame under a load.

    Attributes
    ----------
    load : int
        Which.
    time_s : float
        Since the load began.
    points_mm : (N, 3) float64
        NaN for markers that are not seen.
    covariance_mm2 : (N, 3, 3) float64
    patch : (N,) bool
    """

    load: int
    time_s: float
    points_mm: Floats
    covariance_mm2: Floats
    patch: npt.NDArray[np.bool_]


def pressed_frames(
    pairs: Iterator[tuple[float, Image, Image]],
    sensor: Sensor,
    loads: Sequence[Load],
    report: Callable[[str], None] = lambda _: None,
) -> tuple[RestState, list[Pressed]]:
    """Sense a recording, and keep the frames with contact under a load.

    Parameters
    ----------
    pairs
        Time in seconds since the first frame, left and right image. Nothing touches the gel in the first.
    sensor
    loads
        In the order of their times.
    report
        Called with progress.

    Raises
    ------
    LoadsError
        A load has no frame with contact.
    """
    params = sensor.params.replace(force={"method": "none"})
    pipeline, rest, found = Pipeline(sensor.rig, params), None, list[Pressed]()
    for number, (time_s, left, right) in enumerate(pairs):
        if number % 100 == 0:
            report(f"{time_s:.0f} s, {len(found)} frames under loads")
        try:
            frame = pipeline.process(left, right)
        except Error:
            # A later frame that cannot be sensed is no frame under a load.
            if rest is None:
                raise
            continue
        surface = pipeline.rest
        if rest is None and surface is not None:
            rest = RestState(surface, np.array(frame.covariance_mm2), frame.cols)
        which = next((k for k, load in enumerate(loads) if load.start_s <= time_s <= load.end_s), None)
        if which is None or not frame.patch.any():
            continue
        points_mm = np.where((frame.state == MarkerState.SEEN)[:, None], frame.points_mm, np.nan)
        since_s = time_s - loads[which].start_s
        covariance_mm2, patch = np.array(frame.covariance_mm2), np.array(frame.patch)
        found.append(Pressed(which, since_s, points_mm, covariance_mm2, patch))
    if rest is None:
        raise LoadsError("there are no frames; give a recording that begins with the gel at rest")
    for k, load in enumerate(loads):
        if not any(frame.load == k for frame in found):
            raise LoadsError(
                f"no frame from {load.start_s:g} to {load.end_s:g} s shows a contact; check the times, which "
                "count from the first frame"
            )
    return rest, found


def recorded_pairs(path: Path) -> Iterator[tuple[float, Image, Image]]:
    """Times and images of an MCAP recording."""
    from gelstereo.export.recording import recorded_frames

    first_ns = None
    for frame in recorded_frames(path):
        if len(frame.images) < 2:
            continue
        first_ns = frame.time_ns if first_ns is None else first_ns
        yield (frame.time_ns - first_ns) * 1e-9, frame.images["left"], frame.images["right"]


def force_params(sensor: Sensor, thickness_mm: float, poisson_ratio: float) -> Params:
    """Settings of the estimator with a modulus of 1 kPa."""
    return sensor.params.replace(
        force={
            "method": "ridge",
            "thickness_mm": thickness_mm,
            "young_kpa": 1.0,
            "young_sigma_kpa": 0.0,
            "poisson_ratio": poisson_ratio,
        }
    )
