"""The free sides of `gelstereo_bench.reports.free_sides` are the simulator's."""

from __future__ import annotations

import numpy as np
import pytest

import gelstereo as gs
from gelstereo.recordings import CloudRecording
from gelstereo_bench.reports.free_sides import lifted, of_sides
from gelstereo_bench.reports.physics import Gel, Press, of_layer

SIDE, PITCH_MM, RIM_MM, THICKNESS_MM = 15, 0.9, 1.8, 5.0


def simulated() -> Press:
    """A ball beside a corner that drags the gel, with a cell at each marker."""
    scene = gs.Scene().replace(
        {
            "gel": {"rows": SIDE, "cols": SIDE, "pitch_mm": PITCH_MM, "thickness_mm": THICKNESS_MM},
            "indenter": {"kind": "sphere", "radius_mm": 5.0},
            "effects": {
                "elastic_layer": {
                    "poisson_ratio": 0.5,
                    "friction": 1e3,
                    "rim_mm": RIM_MM,
                    "cells_per_pitch": 1,
                    "border_pitches": 0,
                }
            },
        }
    )
    simulator = gs.Simulator(scene)
    rest = np.asarray(simulator[0].points_mm)
    pose = np.eye(4)
    pose[:3, 3] = rest.mean(axis=0) + [2.0, 1.5, 20.0]
    frame = simulator.press(simulator.pressed(pose, 0.8), shear_mm=(0.3, -0.1))
    motion = ((frame.points_mm - rest) * [1.0, 1.0, -1.0]).reshape(SIDE, SIDE, 3)
    touches = np.asarray(frame.in_contact).reshape(SIDE, SIDE)
    return Press(motion, touches, ~touches)


def test_sides_are_those_of_the_simulator() -> None:
    press, gel = simulated(), Gel(THICKNESS_MM, 0.5)
    found = of_sides(press, gel, PITCH_MM, RIM_MM)
    off_mm, moved_mm = (np.abs(found - press.motion_mm)[press.free].max(), np.abs(press.motion_mm).max())
    assert off_mm < 0.01 * moved_mm
    endless = np.abs(of_layer(press, gel, PITCH_MM) - press.motion_mm)[press.free].max()
    assert endless > 5.0 * off_mm


def test_a_skin_over_markers_at_rest_is_level() -> None:
    """A gel that is stretched evenly by a tenth has its skin a tenth of its depth nearer to the markers."""
    row, col = np.mgrid[:SIDE, :SIDE].reshape(2, -1).astype(float)
    rest = np.stack([PITCH_MM * col, PITCH_MM * row, np.full(col.size, 30.0)], axis=1)
    stretched = rest * [1.1, 1.0, 1.0]
    recording = CloudRecording("made", SIDE, SIDE, np.array([rest, stretched]), rest, np.array([0.0, 0.1]))
    skin = lifted(recording, 0.5)
    np.testing.assert_allclose(skin.points_mm[0], rest + [0.0, 0.0, 0.5], atol=1e-9)
    assert skin.points_mm[1][:, 2] - 30.0 == pytest.approx(0.5 / 1.1)
    assert lifted(recording, 0.0) is recording
