"""Several parts in one simulated gel, from Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import trimesh

import gelstereo as gs
from gelstereo.cli.main import main

BALL = {"kind": "sphere", "radius_mm": 2.5}
BLOCK = {"kind": "box", "size_mm": [3.0, 2.0, 4.0]}
LAYER = {"elastic_layer": {"friction": 0.4}}


def scene(**changes: object) -> gs.Scene:
    return gs.Scene().replace(
        {"indenter": BALL, "effects": LAYER, "others": [{"indenter": BLOCK}], **changes}
    )


def over(x_mm: float, y_mm: float = 0.0) -> npt.NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, 3] = 4.0 + x_mm, y_mm, 40.0
    return pose


def test_both_parts_are_in_the_truth() -> None:
    sensor = gs.Simulator(scene())
    poses = [sensor.pressed(over(-5.0), 0.8), sensor.pressed(over(5.0), 0.6, part=1)]
    frame = sensor.press(poses[0], others=[poses[1]])
    for found, expected in zip(frame.t_sensor_objects, poses, strict=True):
        assert found is not None
        np.testing.assert_array_equal(found, expected)
    assert (frame.in_contact == (frame.touched_by >= 0)).all()
    rest = sensor.press(others=[None])
    assert rest.t_sensor_objects == [None, None] and not rest.in_contact.any()
    for part, centre_mm in enumerate([-1.0, 9.0]):
        mine = rest.points_mm[frame.touched_by == part]
        assert len(mine) > 4 and np.abs(mine[:, :2] - [centre_mm, 0.0]).max() < 2.5
        alone = sensor.press(*(poses[:1] if part == 0 else []), others=[poses[1] if part == 1 else None])
        assert frame.loads is not None and alone.loads is not None
        # Each weakens the other a little, 10 mm away on 5 mm of gel.
        force_n = alone.loads.force_n[2]
        assert frame.loads.part_force_n[part, 2] == pytest.approx(force_n, rel=0.02)
    np.testing.assert_allclose(frame.loads.part_torque_nmm.sum(axis=0), frame.loads.torque_nmm, atol=1e-9)


def test_others_follow_their_trajectories_unless_told_otherwise() -> None:
    keys = [
        {"time_s": time_s, "position_mm": [9.0, 0.0, z_mm]} for time_s, z_mm in ((0.0, 31.0), (0.5, 30.0))
    ]
    moving = scene(others=[{"indenter": BLOCK, "trajectory": keys}])
    sensor = gs.Simulator(moving)
    assert len(sensor) == 16
    first, last = sensor[0], sensor[15]
    assert not first.in_contact.any() and set(last.touched_by.tolist()) == {-1, 1}
    assert last.t_sensor_object is None
    np.testing.assert_array_equal(sensor.press(frame=15).points_mm, last.points_mm)
    assert not sensor.press(others=[None], frame=15).in_contact.any()
    assert sensor.advance(frame=15).touched_by.max() == 1
    again = gs.Scene.from_toml(moving.to_toml())
    assert again.to_dict() == moving.to_dict()
    replaced = sensor.replace({"effects.elastic_layer.young_kpa": 150.0})
    np.testing.assert_allclose(replaced[15].points_mm, last.points_mm, atol=1e-9)


def test_meshes_of_several_parts_are_read_once(tmp_path: Path) -> None:
    for name, radius_mm in (("a", 2.5), ("b", 1.5)):
        trimesh.creation.icosphere(4, radius_mm).export(tmp_path / f"{name}.stl")
    parts = [{"kind": "mesh", "path": f"{name}.stl", "units": "mm"} for name in "ab"]
    scene(indenter=parts[0], others=[{"indenter": parts[1]}]).save(tmp_path / "scene.toml")
    sensor = gs.simulate(tmp_path / "scene.toml")
    depth = [sensor.pressed(over(0.0), 0.5, part=part)[2, 3] - 28.7 for part in range(2)]
    np.testing.assert_allclose(depth, [2.0, 1.0], atol=0.01)
    for path in tmp_path.glob("*.stl"):
        path.unlink()
    swapped = sensor.replace(indenter=parts[1], others=[{"indenter": parts[0]}])
    assert swapped.pressed(over(0.0), 0.5)[2, 3] - 28.7 == pytest.approx(1.0, abs=0.01)


def test_the_pipeline_sees_both_contacts() -> None:
    sensor = gs.Simulator(scene().replace({"effects.defocus": {}, "effects.sensor_noise.sigma_levels": 1.0}))
    pipeline = gs.Pipeline(sensor.scene.rig, gs.Params())
    rest = sensor.press(others=[None])
    pipeline.process(rest.left, rest.right)
    drawn = sensor.press(sensor.pressed(over(-5.0), 0.8), others=[sensor.pressed(over(5.0), 0.6, part=1)])
    frame = pipeline.process(drawn.left, drawn.right)
    off_mm = np.linalg.norm(frame.points_mm - drawn.points_mm, axis=1)
    assert np.median(off_mm) < 0.02
    for part in range(2):
        assert frame.salient[drawn.touched_by == part].mean() > 0.6


def test_the_command_writes_which_part_touches(tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "scenes" / "two_fingers.toml"
    assert main(["simulate", str(path), "--output", str(tmp_path), "--frames", "20"]) == 0
    with np.load(tmp_path / "truth.npz") as truth:
        assert set(np.unique(truth["touched_by"]).tolist()) == {-1, 0, 1}


def test_a_call_that_names_no_part_says_so() -> None:
    sensor = gs.Simulator(scene())
    with pytest.raises(gs.SceneError, match="there is no part 2; the scene has 2, from 0"):
        sensor.pressed(over(0.0), 0.5, part=2)
    with pytest.raises(gs.SceneError, match="others has 2 poses, but the scene has 1 others"):
        sensor.press(over(0.0), others=[None, None])
    with pytest.raises(gs.SceneError, match="number of others without an indenter is 1"):
        gs.Scene().replace(others=[{"indenter": BALL}])
    with pytest.raises(gs.SceneError, match="indent"):
        gs.Scene().replace(indenter=BALL, others=[{"indentor": BALL}])
