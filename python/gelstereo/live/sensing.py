"""Processing of live frames: markers, contact and, for a known part, the pose."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Compliance,
    Error,
    Frame,
    Localization,
    Localizer,
    MarkerState,
    Params,
    Pipeline,
    RegisterError,
    Rig,
    Template,
)
from gelstereo.live.source import LiveFrame

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ExpectedPart:
    """The part that will be held, and its expected pose in the sensor frame, (4, 4)."""

    template: Template
    t_sensor_object: Floats

    def thinned_mm(self, max_points: int) -> Floats:
        """A subset of the template's points for drawing, (N, 3), object frame."""
        points_mm: Floats = self.template.points_mm
        return points_mm[:: max(1, -(-len(points_mm) // max_points))]


@dataclass(frozen=True)
class LiveResult:
    """A live frame and its results.

    Attributes
    ----------
    frame : LiveFrame
    sensed : Frame or None
        Markers and contact; None if the frame is stale or sensing failed.
    located : Localization or None
        The part's pose; None without a part, without contact, or if it was not found.
    reference_px : (N, 2) float64 or None
        Marker positions in the left image of the rest frame.
    problem : str or None
        Human-readable reason why there is no result.
    latency_ms : float or None
        Time from the driver's timestamp, or else from the frame's arrival, to this result. None if stale.
    """

    frame: LiveFrame
    sensed: Frame | None = None
    located: Localization | None = None
    reference_px: Floats | None = None
    problem: str | None = None
    latency_ms: float | None = None


class LiveSensor:
    """Runs the pipeline on live frames. The first good frame is the rest frame, in which nothing may touch
    the gel.
    """

    def __init__(
        self,
        rig: Rig,
        params: Params,
        part: ExpectedPart | None = None,
        compliance: Compliance | None = None,
    ) -> None:
        self.rig = rig
        self.params = params
        self.part = part
        self._pipeline = Pipeline(rig, params, compliance=compliance)
        self._localizer: Localizer | None = None
        if part is not None:
            self._localizer = Localizer(part.template, guess=part.t_sensor_object, params=params)
        self._reference_px: Floats | None = None
        self._touched = False

    def process(self, frame: LiveFrame) -> LiveResult:
        """Sense a frame. Frames without markers or of another size give a result with a `problem`, not an
        error.
        """
        if frame.stale:
            return LiveResult(frame, reference_px=self._reference_px, problem=frame.event or "no new frame")
        arrived_ns = time.monotonic_ns() if frame.driver_ns is None else frame.driver_ns
        sensed, located, problem = None, None, None
        try:
            sensed = self._pipeline.process(frame.left, frame.right)
        except Error as error:
            problem = str(error)
        if sensed is not None:
            if self._reference_px is None:
                self._reference_px = sensed.left_px
            located, problem = self._locate(sensed)
        latency_ms = (time.monotonic_ns() - arrived_ns) * 1e-6
        return LiveResult(frame, sensed, located, self._reference_px, problem, latency_ms)

    def _locate(self, sensed: Frame) -> tuple[Localization | None, str | None]:
        if self._localizer is None or self.part is None:
            return None, None
        if not sensed.patch.any():
            # A released part may return anywhere, so the initial guess is used again.
            if self._touched:
                self._localizer.expect(self.part.t_sensor_object)
            self._touched = False
            return None, None
        self._touched = True
        try:
            found = self._localizer.process(sensed)
        except RegisterError as error:
            return None, f"no pose: {error}"
        return found, None


def contact_of(sensed: Frame) -> dict[str, Any]:
    """Contact figures of a frame: salient markers, deepest indentation and mean motion.

    Returns
    -------
    dict
        ``salient`` and ``patch`` (markers), ``max_indentation_mm``, ``motion_px``.
    """
    return {
        "salient": int(np.count_nonzero(sensed.salient)),
        "patch": int(np.count_nonzero(sensed.patch)),
        "max_indentation_mm": float(np.max(sensed.indentation_mm, initial=0.0)),
        "motion_px": float(sensed.motion_px),
    }


def markers_of(sensed: Frame) -> dict[str, int]:
    """Numbers of markers seen, held and lost."""
    return {state.name.lower(): int(np.count_nonzero(sensed.state == state)) for state in MarkerState}
