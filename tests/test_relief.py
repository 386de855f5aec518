"""Curved gels: simulated, rendered, and sensed against their curved rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gelstereo as gs
from gelstereo.geometry import se3_exp

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


@pytest.mark.parametrize("relief", [None, *RELIEFS[:3]], ids=["plane", "dome", "hollow", "cylinder"])
def test_the_patch_alone_locates_a_part_on_a_curved_gel(relief: dict[str, Any] | None) -> None:
    """The gel's model is that of a plane: without it, poses are as right as on a plane. With it, the verdict
    may be other than that they fit, and says so.
    """
    params = gs.Params.preset("exact")
    parts: list[tuple[dict[str, Any], float]] = [
        ({"kind": "sphere", "radius_mm": BALL_MM}, 0.0),
        ({"kind": "cylinder", "radius_mm": BALL_MM, "length_mm": 20.0}, np.pi / 2),
    ]
    for part, lies in parts:
        scene = gs.Scene().replace(
            indenter=part, effects={"elastic_layer": {}, "defocus": {}, "sensor_noise": {"sigma_levels": 1.0}}
        )
        simulator = gs.Simulator(scene if relief is None else scene.replace({"gel.relief": relief}))
        pose = np.array(se3_exp([lies, 0.0, 0.0, 0.0, 0.0, 0.0]))
        pose[:3, 3] = 5.0, 1.0, 40.0
        pose = np.asarray(simulator.pressed(pose, 0.9))
        pipeline = gs.Pipeline(simulator.scene.rig, params)
        for image in (simulator.press(frame=0), simulator.press(pose, frame=1)):
            frame = pipeline.process(image.left, image.right)
        template = gs.Template.from_triangles(*gs.geometry.shape_mesh(part))
        guess = pose @ se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])
        found = gs.localize(
            frame.patch_points_mm,
            template,
            guess=guess,
            params=params,
            covariance_mm2=frame.covariance_mm2[frame.patch],
        )
        off = np.linalg.inv(pose) @ found.t_sensor_object
        # A ball does not show its rotation, nor a cylinder its shift along its axis, z.
        seen = off[:3, 3] if lies == 0.0 else off[:2, 3]
        assert found.model == "surface" and found.verdict == "fits"
        assert np.linalg.norm(seen) < 0.03, seen
        with_gel = gs.localize(frame, template, guess=guess, params=params)
        assert relief is not None or with_gel.verdict == "fits"


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
