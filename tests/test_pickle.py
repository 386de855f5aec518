"""Values that worker processes exchange come back from a pickle with the same bits."""

from __future__ import annotations

import multiprocessing
import pickle
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import trimesh

import gelstereo as gs
from gelstereo.geometry import se3_exp

T = TypeVar("T")
BALL = {"indenter": {"kind": "sphere", "radius_mm": 4.0}}


def again(value: T) -> T:
    return pickle.loads(pickle.dumps(value))


@pytest.fixture(scope="module")
def frame(noisy_press: list[gs.SimulatedFrame]) -> gs.Frame:
    pipeline = gs.Pipeline(gs.Scene.from_toml("").rig)
    for shown in noisy_press:
        frame = pipeline.process(shown.left, shown.right)
    assert len(frame.patch_points_mm) > 20
    return frame


def test_a_frame(frame: gs.Frame) -> None:
    copied = again(frame)
    assert copied.digest == frame.digest and repr(copied) == repr(frame)
    assert copied.left.detected == frame.left.detected
    assert np.array_equal(copied.covariance_mm2, frame.covariance_mm2)


@pytest.mark.parametrize("method", ["filterreg_point", "surface_search"])
def test_a_localization(frame: gs.Frame, method: str) -> None:
    template = gs.Template.from_mesh(trimesh.creation.icosphere(4, 4.0), units="mm")
    guess = np.asarray(se3_exp([0.0, 0.0, 0.0, 4.0, 0.2, 31.5]))
    params = gs.Params().replace({"register.method": method})
    found = gs.localize(frame.patch_points_mm, template, guess=guess, params=params)
    copied = again(found)
    assert copied.digest == found.digest and repr(copied) == repr(found)
    assert [str(free) for free in copied.free] == [str(free) for free in found.free]

    localizer = gs.Localizer(template, guess=guess)
    found = localizer.process(frame.patch_points_mm)
    assert again(found).tracking == found.tracking


def test_a_template_with_all_that_was_added_to_it() -> None:
    template = gs.Template.from_mesh(trimesh.creation.box((8.0, 6.0, 30.0)), units="mm").with_symmetries()
    copied = again(template)
    assert copied.digest == template.digest and len(copied.symmetries) == len(template.symmetries) > 0


def test_a_mount() -> None:
    mount = gs.SensorMount.facing(gs.FingerKinematics.robotiq_2f85(), gel_centre_mm=[4.0, 0.0, 28.7])
    assert again(mount) == mount and eval(repr(mount), {"SensorMount": gs.SensorMount}) == mount


def test_a_scene_and_its_simulator() -> None:
    scene = gs.Scene().replace({**BALL, "effects": {"sensor_noise": {}}})
    assert again(scene).to_dict() == scene.to_dict()
    assert eval(repr(scene), {"Scene": gs.Scene}).to_dict() == scene.to_dict()
    simulator = gs.Simulator(scene)
    pose = simulator.pressed(np.eye(4), 1.0)
    assert np.array_equal(again(simulator).press(pose).left, simulator.press(pose).left)


def test_a_scene_finds_its_mesh_beside_its_file(tmp_path: Path) -> None:
    trimesh.creation.box((6.0, 6.0, 6.0)).export(tmp_path / "part.stl")
    scene = gs.Scene().replace(indenter={"kind": "mesh", "path": "part.stl", "units": "mm"})
    scene.save(tmp_path / "scene.toml")
    assert len(again(gs.Simulator(gs.Scene.load(tmp_path / "scene.toml")))) == 1


def located(job: tuple[gs.Frame, gs.Template]) -> gs.Localization:
    frame, template = job
    guess = np.asarray(se3_exp([0.0, 0.0, 0.0, 4.0, 0.2, 31.5]))
    return gs.localize(frame.patch_points_mm, template, guess=guess)


def test_another_process_gives_the_same_bits(frame: gs.Frame) -> None:
    job = (frame, gs.Template.from_mesh(trimesh.creation.icosphere(3, 4.0), units="mm"))
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (there,) = pool.map(located, [job])
    assert there.digest == located(job).digest


def test_what_is_no_pickle_of_this_version_is_refused(frame: gs.Frame) -> None:
    with pytest.raises(ValueError, match=r"no pickled Frame of gelstereo .*same version"):
        gs.Frame._from_bytes(b"\x80")
    restore, (data,) = frame.__reduce__()
    with pytest.raises(ValueError, match="no pickled Frame"):
        restore(data[: len(data) // 2])
