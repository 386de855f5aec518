"""Curved gels: simulated, rendered, and sensed against their curved rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gelstereo as gs

BALL_MM = 4.0
RELIEFS: list[dict[str, Any]] = [
    {"kind": "dome", "radius_mm": 60.0},
    {"kind": "dome", "radius_mm": -80.0},
    {"kind": "cylinder", "radius_mm": 70.0, "axis_rad": 0.3},
    {
        "kind": "heights",
        "size_mm": [24.0, 24.0],
        "heights_mm": [[0.0, 0.6, 0.0], [0.6, 0.9, 0.6], [0.0, 0.6, 0.0]],
    },
]


def sensor(relief: dict[str, Any]) -> gs.Simulator:
    effects = {"elastic_layer": {}, "defocus": {}, "sensor_noise": {"sigma_levels": 1.0}}
    scene = gs.Scene().replace(indenter={"kind": "sphere", "radius_mm": BALL_MM}, effects=effects)
    return gs.Simulator(scene.replace({"gel.relief": relief}))


@pytest.mark.parametrize("relief", RELIEFS, ids=["dome", "hollow", "cylinder", "heights"])
def test_a_press_on_a_curved_gel_is_sensed_against_its_rest(relief: dict[str, Any]) -> None:
    simulator = sensor(relief)
    rest, pose = simulator.press(), np.eye(4)
    pose[:2, 3] = 7.0, 2.0
    pressed = simulator.press(simulator.pressed(pose, 1.0))
    assert np.ptp(rest.points_mm[:, 2]) > 0.5 and (rest.indentation_mm == 0.0).all()
    force = {"method": "ridge", "young_kpa": 100.0, "thickness_mm": 5.0}
    pipeline = gs.Pipeline(simulator.scene.rig, gs.Params.preset("exact").replace(force=force))
    still = pipeline.process(rest.left, rest.right)
    np.testing.assert_allclose(still.points_mm, rest.points_mm, atol=0.02)
    frame = pipeline.process(pressed.left, pressed.right)
    np.testing.assert_allclose(frame.indentation_mm, pressed.indentation_mm, atol=0.01)
    assert frame.salient[pressed.in_contact].mean() > 0.7
    assert not frame.salient[~pressed.in_contact].any()
    assert pressed.loads is not None and frame.wrench is not None
    np.testing.assert_allclose(frame.wrench.force_n, pressed.loads.force_n, atol=0.01)


def test_scenes_state_their_relief() -> None:
    scene = sensor(RELIEFS[0]).scene
    assert scene.to_dict()["gel"]["relief"] == RELIEFS[0]
    assert gs.Scene.from_toml(scene.to_toml()).to_dict() == scene.to_dict()
    with pytest.raises(gs.SceneError, match=r"steepest slope of gel.relief is .*; valid is 0 to 0.4"):
        scene.replace({"gel.relief": {"kind": "dome", "radius_mm": 25.0}})
    with pytest.raises(gs.SceneError, match="that of the first"):
        scene.replace(
            {"gel.relief": {"kind": "heights", "size_mm": [9, 9], "heights_mm": [[0.0, 0.0], [0.0]]}}
        )
    with pytest.raises(gs.SceneError, match="kind"):
        scene.replace({"gel.relief": {"kind": "saddle", "radius_mm": 25.0}})
