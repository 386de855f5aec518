"""A recording of the host must open in readers that nobody here wrote: PyPI's mcap, mcap-ros2-support and
rosbags.

The recording is made by `gelstereo-host run`, found through $GELSTEREO_HOST or built once by cargo.
"""

import json
import os
import shutil
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TOPICS = {
    "/gelstereo/capture": "std_msgs/msg/String",
    "/gelstereo/left/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/gelstereo/right/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/gelstereo/points": "sensor_msgs/msg/PointCloud2",
    "/gelstereo/frame": "std_msgs/msg/String",
    "/gelstereo/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/gripper/state": "sensor_msgs/msg/JointState",
    "/robot/gripper_pose": "geometry_msgs/msg/PoseStamped",
    "/gelstereo/stage": "std_msgs/msg/String",
}


def host_binary() -> str:
    if given := os.environ.get("GELSTEREO_HOST"):
        return given
    if shutil.which("cargo") is None:
        pytest.skip("neither $GELSTEREO_HOST nor cargo: no gelstereo-host to record with")
    build = ["cargo", "build", "--quiet", "--package", "gelstereo-host", "--message-format=json"]
    built = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    messages = map(json.loads, built.stdout.splitlines())
    executables = [m["executable"] for m in messages if m.get("executable")]
    assert len(executables) == 1, executables
    return executables[0]


def check_image(file: bytes, crc32: str) -> None:
    """A grey PNG whose pixels have the check sum that was recorded with them."""
    import cv2
    import numpy as np

    image = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.shape == (480, 640) and image.dtype == np.uint8
    assert f"{zlib.crc32(image.tobytes()):08x}" == crc32


def rerun_columns(path: Path, folder: Path) -> str:
    """What Rerun's own converter makes of a recording: a table of its entities and components."""
    pytest.importorskip("rerun_cli", reason="PyPI's rerun-sdk is not installed")
    rerun, converted = [sys.executable, "-m", "rerun_cli"], folder / "converted.rrd"
    subprocess.run([*rerun, "mcap", "convert", str(path), "-o", str(converted)], check=True)
    stats = subprocess.run(
        [*rerun, "rrd", "stats", str(converted)], capture_output=True, text=True, check=True
    )
    return stats.stdout + stats.stderr


def check_frame(points, fields: dict[str, tuple[int, int]]) -> None:
    """A cloud of 25 x 25 markers in metres, the gel's surface 28.7 mm from the camera."""
    import numpy as np

    assert (points.height, points.width, points.point_step) == (25, 25, 20)
    assert fields == {
        "x": (0, 7),
        "y": (4, 7),
        "z": (8, 7),
        "indentation_mm": (12, 7),
        "state": (16, 2),
        "salient": (17, 2),
    }
    names = ["x", "y", "z", "indentation_mm", "state", "salient"]
    formats = ["<f4"] * 4 + ["u1"] * 2
    offsets = [fields[name][0] for name in names]
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 20})
    cloud = np.frombuffer(bytes(points.data), layout)
    assert cloud.shape == (625,)
    assert set(cloud["state"]) <= {0, 1, 2} and set(cloud["salient"]) <= {0, 1}
    # Nowhere farther than the gel's surface and noise, nowhere nearer than the gel is thick. Held ones are
    # predicted.
    seen_z = cloud["z"][cloud["state"] == 0]
    assert seen_z.min() > 0.0237 and seen_z.max() < 0.0290
    # To the rest plane's tilt: it is estimated, and the indentation is along its normal.
    height_mm = 28.7 - 1000 * cloud["z"]
    assert np.abs(height_mm - cloud["indentation_mm"]).max() < 0.2


def test_mcap_reads_indices_metadata_and_every_message(host_run):
    reader_module = pytest.importorskip("mcap.reader", reason="PyPI's mcap is not installed")
    path, summary = host_run
    with path.open("rb") as stream:
        reader = reader_module.make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        index = reader.get_summary()
        types = {c.topic: index.schemas[c.schema_id].name for c in index.channels.values()}
        assert types == TOPICS
        assert {s.encoding for s in index.schemas.values()} == {"ros2msg"}
        assert {c.message_encoding for c in index.channels.values()} == {"cdr"}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert "[params.detect]" in metadata["gelstereo"]["config_toml"]
        counts = dict.fromkeys(TOPICS, 0)
        for _, channel, message in reader.iter_messages():
            assert message.data[:4] == b"\x00\x01\x00\x00"
            counts[channel.topic] += 1
    frames = sum(stage["frames"] for stage in summary["stages"])
    single = ("/gelstereo/pose", "/gelstereo/stage", "/gelstereo/capture")
    assert {counts[topic] for topic in TOPICS if topic not in single} == {frames}
    assert counts["/gelstereo/pose"] == 1
    # One for each pair, and one for each trigger: grasp, insertion, end.
    assert counts["/gelstereo/capture"] == frames + 3


def test_rosbags_decodes_every_message_by_the_recorded_definitions(host_run):
    highlevel = pytest.importorskip("rosbags.highlevel", reason="PyPI's rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    path, summary = host_run
    decoded = dict.fromkeys(TOPICS, 0)
    last = {}
    with highlevel.AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == TOPICS
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            decoded[connection.topic] += 1
            last[connection.topic] = message
            header = getattr(message, "header", None)
            if header is not None:
                assert header.stamp.sec * 10**9 + header.stamp.nanosec == time_ns
            if connection.topic == "/gelstereo/points":
                check_frame(message, {f.name: (f.offset, f.datatype) for f in message.fields})
            if connection.topic == "/gelstereo/capture":
                captured = json.loads(message.data)
                if "left_crc32" in captured:
                    pixels = {"left": captured["left_crc32"], "right": captured["right_crc32"]}
            if connection.topic.endswith("compressed"):
                view = connection.topic.split("/")[2]
                assert message.format == "png"
                check_image(bytes(message.data), pixels[view])
    assert all(count > 0 for count in decoded.values())
    check_pose(last["/gelstereo/pose"], summary["localized"])
    assert json.loads(last["/gelstereo/stage"].data)["outcome"] == summary["outcome"]
    # The retreat has opened the fingers again.
    assert last["/gripper/state"].position[0] == pytest.approx(0.014)


def test_mcap_ros2_decodes_every_message_by_the_recorded_definitions(host_run):
    ros2 = pytest.importorskip("mcap_ros2.reader", reason="PyPI's mcap-ros2-support is not installed")
    path, summary = host_run
    decoded = dict.fromkeys(TOPICS, 0)
    for message in ros2.read_ros2_messages(str(path)):
        decoded[message.channel.topic] += 1
        if message.channel.topic == "/gelstereo/points":
            fields = {f.name: (f.offset, f.datatype) for f in message.ros_msg.fields}
            check_frame(message.ros_msg, fields)
        if message.channel.topic == "/gelstereo/pose":
            check_pose(message.ros_msg, summary["localized"])
    assert all(count > 0 for count in decoded.values())


def test_rerun_finds_images_and_clouds(host_run, tmp_path):
    columns = rerun_columns(host_run[0], tmp_path)
    assert "/gelstereo/left/image/compressed: " in columns and "/gelstereo/points: " in columns
    assert "EncodedImage:blob: " in columns and "Points3D:positions: " in columns


def check_pose(message, localized: dict) -> None:
    """Metres, a unit quaternion, and a covariance that is the summary's on its diagonal and positive
    definite.
    """
    import numpy as np

    rows = np.array(localized["t_sensor_object"])
    position, q = message.pose.pose.position, message.pose.pose.orientation
    np.testing.assert_allclose([position.x, position.y, position.z], rows[:3, 3] / 1000, rtol=1e-12)
    x, y, z, w = q.x, q.y, q.z, q.w
    # Third column of the rotation matrix, from the quaternion's definition.
    axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(axis, rows[:3, 2], atol=1e-12)
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    sigma = np.array(localized["sigma"]) * ([1e-3] * 3 + [1] * 3)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=1e-12)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-18)
    assert np.linalg.eigvalsh(covariance / np.outer(sigma, sigma)).min() > 0


def test_a_cut_recording_is_read_up_to_the_cut_by_mcap(host_run, tmp_path):
    stream_module = pytest.importorskip("mcap.stream_reader", reason="PyPI's mcap is not installed")
    from mcap.exceptions import EndOfFile, InvalidMagic
    from mcap.records import Message

    path, summary = host_run
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    messages = 0
    with cut.open("rb") as stream:
        try:
            for record in stream_module.StreamReader(stream).records:
                messages += isinstance(record, Message)
        except (EndOfFile, InvalidMagic):
            pass
    # Six topics per frame, frames of nearly equal size.
    frames = sum(stage["frames"] for stage in summary["stages"])
    assert messages >= 6 * frames * 11 // 20
