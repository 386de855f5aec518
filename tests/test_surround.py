"""Sequences of drawn frames, with a tray in view and without: parts that arrive within one frame."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import PITCH_MM, SIDE, SURFACE_MM, Press, Sensor

import gelstereo
from gelstereo.states import MarkerState

#: At once 1.4 mm deep, or more, a part bends the gel by more than half a pitch between two frames.
PRESSES = (
    Press("board", 1.4, (0.4, -0.3), 0.1),
    Press("board", 1.8, (1.0, -1.0), 0.4),
    Press("cylinder", 1.5, (-1.5, 1.0), 0.9),
    Press("ball", 1.6, (2.0, 2.0)),
    Press("cylinder", 1.7, (-0.8, 3.5), 0.35, half_mm=(2.7, 6.0), radius_mm=4.7),
)
#: Frames within which a part must be seen.
SOON = 3


def params(preset: str) -> gelstereo.Params:
    lattice = {"lattice.rows": SIDE, "lattice.cols": SIDE, "lattice.pitch_mm": PITCH_MM}
    return gelstereo.Params.preset(preset).replace(lattice)


@pytest.mark.parametrize("tray", [False, True], ids=["gel", "tray"])
@pytest.mark.parametrize("preset", ["fast", "balanced", "exact"])
def test_row_37_a_part_that_arrives_within_one_frame_is_labelled_afresh(preset: str, tray: bool) -> None:
    sensor = Sensor(tray=tray)
    pitch_px = float(sensor.rig.left_matrix[0, 0]) * PITCH_MM / SURFACE_MM
    pipeline = gelstereo.Pipeline(sensor.rig, params(preset))
    pipeline.process(*sensor.pair(sensor.rest_mm, 1))
    for number, press in enumerate(PRESSES):
        points_mm = sensor.markers_mm(press)
        left_px, _ = sensor.rig.project(points_mm)
        for again in range(SOON):
            frame = pipeline.process(*sensor.pair(points_mm, 100 * number + again))
            seen = frame.state == MarkerState.SEEN
            off_px = np.linalg.norm(frame.left_px - left_px, axis=1)
            assert not (seen & (off_px > 0.5 * pitch_px)).any(), f"wrong names under {press}"
        # Markers merge where the gel is steepest.
        assert seen.mean() > 0.9, f"{seen.mean():.0%} of the markers are seen under {press}"
