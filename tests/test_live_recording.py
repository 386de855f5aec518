"""A live recording is one of the host's: readers that nobody here wrote open it, and the host computes it
again.
"""

from __future__ import annotations

import dataclasses
import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from test_compliance import of_layer
from test_live import PATIENCE_S, SCENE, Played
from test_recording_readers import check_frame, host_binary

import gelstereo as gs
from gelstereo._native import parse_toml
from gelstereo.cli import main
from gelstereo.export.forces import frames_with_forces
from gelstereo.export.images import decoded
from gelstereo.export.recording import recorded_frames
from gelstereo.geometry import se3_exp, se3_log
from gelstereo.live import LiveFrame, LiveResult, LiveSensor
from gelstereo.live.notes import config_toml, ros_covariance
from gelstereo.live.record import LiveRecorder
from gelstereo.live.run import LiveRun
from gelstereo.view.recording import moment_of_recording
from gelstereo.view.steps import Steps

pytest.importorskip("rosbags", reason="PyPI's rosbags is not installed")

TYPES = {
    "/gelstereo/left/image": "sensor_msgs/msg/Image",
    "/gelstereo/right/image": "sensor_msgs/msg/Image",
    "/gelstereo/left/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/gelstereo/right/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/gelstereo/stereo/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/gelstereo/points": "sensor_msgs/msg/PointCloud2",
    "/gelstereo/frame": "std_msgs/msg/String",
    "/gelstereo/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/gelstereo/stage": "std_msgs/msg/String",
    "/gelstereo/capture": "std_msgs/msg/String",
}


@pytest.fixture(scope="module", params=["png", "raw"])
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fifty frames of the simulated grasp, by the command."""
    path = tmp_path_factory.mktemp("live") / "out" / f"{request.param}.mcap"
    words = ["live", "--scene", str(SCENE), "--frames", "50", "--show", "none", "--record", str(path)]
    assert main([*words, "--images", request.param]) == 0
    return path


def test_rosbags_decodes_every_message(recorded: Path) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    scene = gs.simulate(SCENE)
    counts = dict.fromkeys(TYPES, 0)
    with AnyReader([recorded], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        found = {c.topic: c.msgtype for c in reader.connections}
        assert found == {topic: TYPES[topic] for topic in found} and len(found) == 7
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            header = getattr(message, "header", None)
            if header is not None:
                assert header.stamp.sec * 10**9 + header.stamp.nanosec == time_ns
            if connection.topic == "/gelstereo/points":
                check_frame(message, {f.name: (f.offset, f.datatype) for f in message.fields})
            if connection.topic.startswith("/gelstereo/right") and counts[connection.topic] < 3:
                png = recorded.stem == "png"
                assert connection.topic.endswith("compressed") == png
                image = decoded(message.data) if png else message.data.reshape(message.height, message.step)
                assert np.array_equal(image, scene[counts[connection.topic]].right)
            if connection.topic == "/gelstereo/pose":
                sigma = np.sqrt(np.diag(message.pose.covariance.reshape(6, 6)))
                assert (sigma[:3] < 0.6e-3 * 1.001).all() and (sigma[3:] < 0.03 * 1.001).all()
                assert message.pose.pose.position.z == pytest.approx(0.031, abs=0.002)
            counts[connection.topic] += 1
    assert counts["/gelstereo/left/image"] + counts["/gelstereo/left/image/compressed"] == 50
    assert counts["/gelstereo/capture"] == counts["/gelstereo/points"] == counts["/gelstereo/frame"] == 50
    assert counts["/gelstereo/pose"] == counts["/gelstereo/stage"] > 10


def test_mcap_ros2_decodes_every_message(recorded: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader", reason="PyPI's mcap-ros2-support is not installed")
    notes = [m.ros_msg.data for m in reader.read_ros2_messages(str(recorded), topics=["/gelstereo/capture"])]
    assert [json.loads(note)["sequence"] for note in notes] == list(range(50))


def test_the_host_computes_the_same_bits_again(recorded: Path) -> None:
    replayed_by_the_host(recorded, frames=50, raw=recorded.stem == "raw")


def test_the_gels_matrix_is_recorded_and_replayed(tmp_path: Path) -> None:
    """Its wrenches come from the attachment: the file is gone."""
    matrix, params, path = tmp_path / "narrow", tmp_path / "params.toml", tmp_path / "run.mcap"
    gel = gs.Scene.load(SCENE).to_dict()["gel"]
    of_layer(gel["rows"], gel["cols"], gel["pitch_mm"], 5.0, 0.48).save(matrix)
    force = {"method": "ridge", "young_kpa": 100.0, "poisson_ratio": 0.48, "thickness_mm": 5.0}
    params.write_text(gs.Params().replace(force=force).to_toml())
    words = ["live", "--scene", SCENE, "--frames", "30", "--show", "none", "--record", path]
    assert main([str(word) for word in [*words, "--params", params, "--compliance", matrix]]) == 0
    matrix.unlink()
    replayed_by_the_host(path, frames=30)
    forces_n = [np.linalg.norm(frame.tactile["wrench"][:3]) for frame in frames_with_forces(path)]
    assert max(forces_n) > 0.1


def replayed_by_the_host(path: Path, frames: int, raw: bool = False) -> None:
    host = host_binary()
    default = subprocess.run([host, "check", "--print-default"], capture_output=True, text=True, check=True)
    if not raw and 'images = "png"' not in default.stdout:
        pytest.skip("this gelstereo-host reads plain images alone")
    command = [host, "replay", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10 * PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{frames} frames" in done.stdout and "same bits" in done.stdout


def test_view_draws_the_located_part(recorded: Path) -> None:
    moment = moment_of_recording(recorded)
    assert moment.part is not None and moment.left.shape == (480, 640)
    # The spin about the peg's own axis is free.
    assert any("spin" in note for note in moment.notes)


def test_steps_of_a_live_recording_are_one_with_its_free_directions(recorded: Path) -> None:
    steps = list(Steps(recorded))
    assert len(steps) == 1
    assert any("spin" in direction for direction in Steps(recorded).located().free)


def test_a_run_gives_the_same_file_whenever_it_is_made(recorded: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    words = ["live", "--scene", str(SCENE), "--frames", "50", "--show", "none", "--record", str(again)]
    assert main([*words, "--images", recorded.stem]) == 0
    assert again.read_bytes() == recorded.read_bytes()


def encoded_frames(separate: bool) -> list[LiveFrame]:
    """What a camera with Motion JPEG gives, decoded as `gelstereo.cameras` decodes it."""
    scene, layout = gs.simulate(SCENE), "side_by_side_swapped"
    out = []
    for index in range(0, 30, 6):
        joint = np.hstack([scene[index].right, scene[index].left])
        files = [bytes(cv2.imencode(".jpg", joint)[1])]
        left, right = gs.cameras.decode(files[0], format="mjpg", size_px=(1280, 480), layout=layout)
        if separate:
            files = [bytes(cv2.imencode(".jpg", view)[1]) for view in (scene[index].left, scene[index].right)]
            left, right = (decoded(file) for file in files)
        where = None if separate else layout
        out.append(LiveFrame(left, right, index, index * 10**8, 1, 2, encoded=tuple(files), layout=where))
    return out


@pytest.mark.parametrize("separate", [False, True])
def test_motion_jpeg_is_kept_as_the_camera_sent_it(separate: bool, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    frames = encoded_frames(separate)
    sensor = LiveSensor(gs.simulate(SCENE).scene.rig, gs.Params.preset("balanced"))
    path = tmp_path / "run.mcap"
    with LiveRecorder(path, sensor.rig, sensor.params, wall_clock=True) as recorder:
        for frame in frames:
            recorder.write(sensor.process(frame))
    with path.open("rb") as stream:
        messages = [(c.topic, m) for _, c, m in make_reader(stream).iter_messages()]
    kept = [m.data for topic, m in messages if topic.endswith("/compressed")]
    sent = [file for frame in frames for file in frame.encoded]
    assert len(kept) == len(sent) and all(file in data for file, data in zip(sent, kept, strict=True))
    assert all(m.log_time > 10**18 and m.publish_time < 10**10 for _, m in messages)
    # Both readers of this package find the views; their JPEG decoder is a level off here and there.
    exported = list(recorded_frames(path))
    for frame, found in zip(frames, exported, strict=True):
        for view in ("left", "right"):
            assert np.abs(getattr(frame, view).astype(int) - found.images[view]).max() <= 2
    assert np.array_equal(moment_of_recording(path).left, exported[-1].images["left"])
    if not separate:
        replayed_by_the_host(path, frames=len(frames))


@pytest.mark.parametrize("named", [False, True])
def test_a_part_of_a_mesh_stands_in_the_recording(
    named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plug, path = SCENE.parent / "usb_plug.toml", tmp_path / "run.mcap"
    start = gs.simulate(plug)[0].t_sensor_object
    assert start is not None
    turn_deg = np.degrees(se3_log(start)[:3])
    part = ["--template", SCENE.parent / "parts" / "usb_plug.stl", "--units", "mm"]
    guess = ["--guess-mm", *start[:3, 3], "--guess-deg", *turn_deg]
    words = ["live", "--scene", plug, "--frames", 40, "--show", "none", "--record", path, "--images", "raw"]
    assert main([str(word) for word in [*words, *([*part, *guess] if named else [])]]) == 0
    assert moment_of_recording(path).part is not None
    replayed_by_the_host(path, frames=40, raw=True)


@pytest.fixture(scope="module")
def results() -> list[LiveResult]:
    scene = gs.simulate(SCENE)
    sensor = LiveSensor(scene.scene.rig, gs.Params.preset("balanced"))
    frames = [LiveFrame(scene[k].left, scene[k].right, n, n * 10**9) for n, k in enumerate([0, 10, 20])]
    return [sensor.process(frame) for frame in frames]


def test_a_killed_recording_is_read_up_to_its_last_frame(results: list[LiveResult], tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    recorder = LiveRecorder(path, gs.simulate(SCENE).scene.rig, gs.Params.preset("balanced"))
    for result in results:
        recorder.write(result)
    # What the system has at this moment is what a kill leaves.
    (tmp_path / "left.mcap").write_bytes(path.read_bytes())
    recorder.close()
    moment = moment_of_recording(tmp_path / "left.mcap")
    assert "frame 2" in moment.title


def test_an_event_is_kept_and_no_image_twice(results: list[LiveResult], tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = tmp_path / "run.mcap"
    fields = {"event": "disconnected", "retry_in_ms": 500}
    gone = dataclasses.replace(
        results[0].frame, stale=True, event="camera X is gone", event_fields=fields, time_ns=1
    )
    with LiveRecorder(path, gs.simulate(SCENE).scene.rig, gs.Params()) as recorder:
        recorder.write(results[0])
        recorder.write(LiveResult(gone, problem="camera X is gone"))
    with path.open("rb") as stream:
        found = [(c.topic, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert [topic for topic, _ in found].count("/gelstereo/left/image/compressed") == 1
    assert [topic for topic, _ in found].count("/gelstereo/capture") == 2
    assert json.loads(found[-1][1][8:].rstrip(b"\0")) == {"event": "disconnected", "retry_in_ms": 500}


def test_a_full_disk_ends_the_recording_and_not_the_sensing(
    results: list[LiveResult], tmp_path: Path
) -> None:
    resource = pytest.importorskip("resource", reason="this system has no limits of file sizes")
    scene = gs.simulate(SCENE)
    live = LiveRun(Played([r.frame for r in results]), LiveSensor(scene.scene.rig, gs.Params()))
    live.recorder = LiveRecorder(tmp_path / "run.mcap", scene.scene.rig, gs.Params())
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The system refuses what would make the file longer than one frame and a half.
    resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, before[1]))
    try:
        with live:
            assert live.wait(PATIENCE_S)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert live.reading.frames == 3
    assert live.recording_error is not None and "too large" in live.recording_error
    # What was written before can be read.
    assert "frame 0" in moment_of_recording(tmp_path / "run.mcap").title


def test_a_configuration_holds_rig_settings_and_part() -> None:
    rig, params = gs.simulate(SCENE).scene.rig, gs.Params.preset("paper")
    shape = {"kind": "box", "size_mm": [8.0, 6.0, 20.0]}
    config = parse_toml(config_toml(rig, params, shape))
    assert config["params"] == params.to_dict()
    assert gs.Scene().replace(rig=config["rig"]).rig == rig
    assert config["part"]["shape"] == shape


@given(
    arrays(np.float64, (6, 6), elements=st.floats(-30.0, 30.0)),
    arrays(np.float64, 6, elements=st.floats(-0.5, 0.5)),
    arrays(np.float64, 3, elements=st.floats(-30.0, 30.0)),
)
def test_the_covariance_is_that_of_the_parts_origin(
    root: np.ndarray, twist: np.ndarray, position: np.ndarray
) -> None:
    """Against moments of perturbed poses, to first order."""
    information = root @ root.T
    pose = np.array(se3_exp([*twist[:3], 0.0, 0.0, 0.0]))
    pose[:3, 3] = position
    covariance = ros_covariance(information, pose)
    # Each column of the Jacobian by a difference: where the origin goes and how it turns.
    step = 1e-6
    moves = []
    for axis in np.eye(6):
        moved = se3_exp(axis * step) @ pose
        turn = se3_log(moved @ np.linalg.inv(pose))[:3]
        moves.append(np.concatenate([(moved[:3, 3] - pose[:3, 3]) / 1000.0, turn]) / step)
    jacobian = np.array(moves).T
    prior = np.diag(1.0 / np.array([0.6e-3] * 3 + [0.03] * 3) ** 2)
    inverse = np.linalg.inv(jacobian)
    expected = np.linalg.inv(inverse.T @ information @ inverse + prior)
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-4
    )


def test_rerun_gets_images_clouds_and_the_part(tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun", reason="PyPI's rerun-sdk is not installed")
    assert rerun.__version__
    path = tmp_path / "live.rrd"
    words = ["live", "--scene", str(SCENE), "--frames", "46", "--show", "rerun", "--rrd", str(path)]
    assert main(words) == 0
    import sys

    def rrd(*words: str) -> str:
        command = [sys.executable, "-m", "rerun", "rrd", *words, str(path)]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S).stdout

    rrd("verify")
    printed = rrd("print")
    for entity in (
        "/image/left/markers",
        "/image/left/motion",
        "/sensor/gel",
        "/sensor/part",
        "/source/rate_hz",
    ):
        assert entity in printed, entity
