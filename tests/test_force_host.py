"""The host's wrench: in its lines, in its recordings as ROS reads them, and again in a replay."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from test_compliance import of_layer
from test_recording_readers import host_binary

import gelstereo as gs
from gelstereo.export.forces import frames_with_forces

YOUNG_KPA = 120.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict], gs.SimulatedFrame]:
    """A recording of a ball pressed in four frames, the lines of it, and the last frame with its truth."""
    import cv2

    folder = tmp_path_factory.mktemp("force")
    scene = gs.Scene().replace(
        indenter={"kind": "sphere", "radius_mm": 4.0},
        effects={"elastic_layer": {"young_kpa": YOUNG_KPA}, "sensor_noise": {}},
    )
    sensor, pose = gs.Simulator(scene), np.eye(4)
    pose[:3, 3] = 5.0, 1.0, 40.0
    depths = [None] * 12 + [0.3, 0.5, 0.7, 0.8]
    (folder / "pairs").mkdir()
    for index, depth_mm in enumerate(depths):
        held = None if depth_mm is None else sensor.pressed(pose, depth_mm)
        frame = sensor.press(held, shear_mm=(0.1, -0.05), frame=index) if held is not None else sensor[0]
        cv2.imwrite(str(folder / "pairs" / f"left_{index:05d}.png"), frame.left)
        cv2.imwrite(str(folder / "pairs" / f"right_{index:05d}.png"), frame.right)
    (folder / "rig.toml").write_text(scene.rig.to_toml())
    (folder / "cell.toml").write_text(
        'rig_file = "rig.toml"\nsense.localize = "never"\n'
        'source = { kind = "folder", path = "pairs", frame_rate_hz = 30.0 }\n'
        f'[params.force]\nmethod = "ridge"\nthickness_mm = 5.0\nyoung_kpa = {YOUNG_KPA}\n'
    )
    done = host("sense", "--config", folder / "cell.toml", "--jsonl", "--record", folder / "run.mcap")
    assert done.returncode == 0, done.stderr
    return folder / "run.mcap", [json.loads(line) for line in done.stdout.splitlines()], frame


def host(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [host_binary(), *map(str, words)], capture_output=True, text=True, check=False, timeout=120
    )


def test_a_line_has_the_force_of_the_part(recorded: tuple[Path, list[dict], gs.SimulatedFrame]) -> None:
    _, lines, frame = recorded
    assert all("wrench" not in line for line in lines[:12]), "nothing touches the gel"
    wrench, loads = lines[-1]["wrench"], frame.loads
    assert loads is not None
    off = np.array(wrench["force_n"]) - loads.force_n
    assert np.all(np.abs(off) < 4 * np.array(wrench["sigma"][:3]))
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(loads.force_n)
    assert wrench["misfit"] >= 1.0 and not wrench["is_cut"]


def test_ros_reads_the_wrench_about_the_cameras_origin(
    recorded: tuple[Path, list[dict], gs.SimulatedFrame],
) -> None:
    """A ROS wrench has its torque about the origin of its frame, in newton metres."""
    highlevel = pytest.importorskip("rosbags.highlevel", reason="PyPI's rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    path, lines, _ = recorded
    found = []
    with highlevel.AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic == "/gelstereo/wrench":
                assert connection.msgtype == "geometry_msgs/msg/WrenchStamped"
                found.append(reader.deserialize(raw, connection.msgtype))
    said = [line["wrench"] for line in lines if "wrench" in line]
    assert len(found) == len(said) >= 3
    for message, line in zip(found, said, strict=True):
        assert message.header.frame_id == "gelstereo_left_optical_frame"
        force = np.array([getattr(message.wrench.force, axis) for axis in "xyz"])
        torque_nm = np.array([getattr(message.wrench.torque, axis) for axis in "xyz"])
        np.testing.assert_allclose(force, line["force_n"])
        expected = np.array(line["torque_nmm"]) + np.cross(line["about_mm"], line["force_n"])
        np.testing.assert_allclose(1e3 * torque_nm, expected, atol=1e-9)


def test_a_replay_finds_the_same_wrenches(recorded: tuple[Path, list[dict], gs.SimulatedFrame]) -> None:
    """The digest of a frame includes its wrench, and the replay compares digests."""
    path, lines, _ = recorded
    done = host("replay", path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(lines) == 16


def test_the_host_takes_the_gels_matrix_and_records_it(
    recorded: tuple[Path, list[dict], gs.SimulatedFrame],
) -> None:
    """With the layer's own matrix, forces are those of the layer, in other bits. A replay and an export take
    it from the recording.
    """
    folder, matrix = recorded[0].parent, recorded[0].parent / "gel.compliance"
    of_layer(25, 25, 0.9, 5.0, 0.48).save(matrix)
    config = folder / "matrix.toml"
    config.write_text('compliance_file = "gel.compliance"\n' + (folder / "cell.toml").read_text())
    done = host("sense", "--config", config, "--jsonl", "--record", folder / "matrix.mcap")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    found, expected = (np.array(each[-1]["wrench"]["force_n"]) for each in (lines, recorded[1]))
    assert 0.0 < np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected)
    matrix.unlink()
    replayed = host("replay", folder / "matrix.mcap")
    assert replayed.returncode == 0 and "same bits" in replayed.stdout, replayed.stdout + replayed.stderr
    exported = list(frames_with_forces(folder / "matrix.mcap"))
    np.testing.assert_array_equal(exported[-1].tactile["wrench"][:3], found)


@pytest.mark.parametrize(
    ("gel", "text"),
    [
        (None, "cannot read"),
        ((0.9, 4.0, 0.48), "force.thickness_mm is 5, but the compliance matrix is of a gel where"),
        (b"gelcompl", "the compliance matrix is damaged or cut off"),
        (b"solid", "these are not the bytes of a compliance matrix"),
    ],
)
def test_a_matrix_that_does_not_fit_is_named(
    recorded: tuple[Path, list[dict], gs.SimulatedFrame],
    gel: tuple[float, float, float] | bytes | None,
    text: str,
) -> None:
    folder, matrix = recorded[0].parent, recorded[0].parent / "other.compliance"
    matrix.unlink(missing_ok=True)
    if isinstance(gel, tuple):
        of_layer(2, 2, *gel).save(matrix)
    elif gel is not None:
        matrix.write_bytes(gel)
    config = folder / "other.toml"
    config.write_text('compliance_file = "other.compliance"\n' + (folder / "cell.toml").read_text())
    sensed, checked = host("sense", "--config", config), host("check", "--config", config)
    assert sensed.returncode == 2 and text in sensed.stderr, sensed.stderr
    assert checked.returncode == 1 and "WRONG  compliance" in checked.stdout
    assert text in checked.stdout


def test_a_matrix_that_nothing_uses_is_refused(recorded: tuple[Path, list[dict], gs.SimulatedFrame]) -> None:
    config = recorded[0].parent / "unused.toml"
    config.write_text('compliance_file = "gel.compliance"\n')
    done = host("check", "--config", config)
    assert done.returncode == 2 and 'params.force.method is "none"' in done.stderr, done.stdout + done.stderr
