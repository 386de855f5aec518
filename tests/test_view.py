"""Pictures, and recordings as their source: messages are encoded here by rosbags, not by our own code."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from gelstereo import Error, SimulatedFrame
from gelstereo.geometry import se3_exp, shape_mesh, so3_exp, so3_log
from gelstereo.view import Moment, draw
from gelstereo.view.canvas import HELD, LOST, SALIENT, SEEN, Canvas
from gelstereo.view.moment import Part, pose_in_words
from gelstereo.view.recording import RecordingError, moment_of_recording

STORE = get_typestore(Stores.ROS2_HUMBLE)
SHAPE = {"kind": "sphere", "radius_mm": 4.0}
CONFIG = '[part.shape]\nkind = "sphere"\nradius_mm = 4.0\n'
POSE = se3_exp([0.1, -0.2, 0.3, 4.0, 0.5, 31.5])


@pytest.fixture(scope="module")
def moment(noisy_press: list[SimulatedFrame]) -> Moment:
    rest, pressed = noisy_press[0], noisy_press[-1]
    state = np.zeros(625, np.uint8)
    state[[0, 24]], state[600] = 1, 2
    return Moment(
        left=pressed.left,
        rows=25,
        cols=25,
        left_px=pressed.left_px,
        reference_px=rest.left_px,
        points_mm=pressed.points_mm,
        indentation_mm=pressed.indentation_mm,
        state=state,
        salient=pressed.in_contact,
        part=Part.located(*shape_mesh(SHAPE), POSE),
        title="A test",
        notes=("one", "two"),
    )


def count(picture: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(picture.astype(int) - colour).max(axis=2) <= 12).sum())


def test_a_picture_shows_states_contact_and_part(moment: Moment) -> None:
    picture = draw(moment)
    assert picture.dtype == np.uint8
    for colour in (SEEN, HELD, LOST, SALIENT):
        assert count(picture, colour) > 20
    assert count(picture, SEEN) > 10 * count(picture, HELD) > 0
    without = draw(Moment(**{**vars(moment), "part": None, "salient": np.zeros(625, bool)}))
    # What is left of the salient colour is the legend's ring.
    assert count(without, SALIENT) < count(picture, SALIENT) / 10
    assert np.array_equal(draw(moment), picture)  # and every time the same


def test_drawing_is_placed_to_a_fraction_of_a_pixel() -> None:
    canvas = Canvas(60, 40, (0, 0, 0))
    canvas.circle((20.25, 10.5), 6.0, (255, 255, 255))
    weights = canvas.finished()[:, :, 0].astype(float)
    y, x = np.mgrid[:40, :60]
    centre = (x * weights).sum() / weights.sum(), (y * weights).sum() / weights.sum()
    assert centre == pytest.approx((20.25, 10.5), abs=0.05)
    assert weights.sum() / 255 == pytest.approx(np.pi * 36, rel=0.05)


def test_pose_in_words() -> None:
    words = pose_in_words(se3_exp([0, np.pi / 2, 0, 0, 0, 0]))
    assert words == "sensor frame: position (0.00, 0.00, 0.00) mm, rotation vector (0.0, 90.0, 0.0) deg"


def message(name: str, /, **fields: Any) -> Any:
    return STORE.types[name](**fields)


def header() -> Any:
    stamp = message("builtin_interfaces/msg/Time", sec=1, nanosec=2)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id="odd")  # an odd length makes alignment matter


def image_message(image: np.ndarray, encoding: str) -> Any:
    height, width = image.shape
    return message(
        "sensor_msgs/msg/Image",
        header=header(),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=width,
        data=np.array(image).reshape(-1),
    )


def cloud_message(frame: SimulatedFrame) -> Any:
    layout = np.dtype(
        [("xyz", "<f4", 3), ("indentation_mm", "<f4"), ("state", "u1"), ("salient", "u1"), ("_", "u1", 2)]
    )
    values = np.zeros(625, layout)
    values["xyz"], values["indentation_mm"] = frame.points_mm / 1000.0, frame.indentation_mm
    values["salient"], values["state"] = frame.in_contact, 1
    places = {
        "x": (0, 7),
        "y": (4, 7),
        "z": (8, 7),
        "indentation_mm": (12, 7),
        "state": (16, 2),
        "salient": (17, 2),
    }
    fields = [
        message("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=kind, count=1)
        for name, (offset, kind) in places.items()
    ]
    return message(
        "sensor_msgs/msg/PointCloud2",
        header=header(),
        height=25,
        width=25,
        fields=fields,
        is_bigendian=False,
        point_step=20,
        row_step=500,
        data=np.frombuffer(values.tobytes(), np.uint8),
        is_dense=True,
    )


def pose_message(pose: np.ndarray) -> Any:
    from gelstereo.geometry import so3_from_matrix

    x, y, z = pose[:3, 3] / 1000.0
    qx, qy, qz, qw = so3_from_matrix(pose[:3, :3])
    inner = message(
        "geometry_msgs/msg/Pose",
        position=message("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=message("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    covariance = message("geometry_msgs/msg/PoseWithCovariance", pose=inner, covariance=np.zeros(36))
    return message("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(), pose=covariance)


def write_recording(
    path: Path, frames: list[SimulatedFrame], pose: np.ndarray | None, encoding: str = "mono8"
) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("gelstereo", {"config_toml": CONFIG, "version": "0"})
        channels: dict[str, int] = {}

        def put(topic: str, time: int, content: Any) -> None:
            kind = content.__msgtype__
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(content, kind))
            writer.add_message(channels[topic], time, data, time)

        for time, frame in enumerate(frames):
            put("/gelstereo/left/image", time, image_message(frame.left, encoding))
            put("/gelstereo/frame", time, message("std_msgs/msg/String", data=json.dumps({"index": time})))
            put("/gelstereo/points", time, cloud_message(frame))
            if pose is not None and time == 3:
                note = {"stage": "localize", "free": ["spin about z"]}
                put("/gelstereo/stage", time, message("std_msgs/msg/String", data=json.dumps(note)))
                put("/gelstereo/pose", time, pose_message(pose))
        writer.finish()


def test_a_recording_gives_the_moment_of_its_pose(tmp_path: Path, noisy_press: list[SimulatedFrame]) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, noisy_press, np.array(POSE))
    moment, truth = moment_of_recording(path), noisy_press[3]
    assert np.array_equal(moment.left, truth.left)
    # 32-bit metres: 2^-24 of 30 mm is 2 nm, and a millimetre is 20 px.
    assert np.abs(moment.points_mm - truth.points_mm).max() < 4e-6
    assert np.abs(moment.left_px - truth.left_px).max() < 1e-4
    assert np.abs(moment.reference_px - noisy_press[0].left_px).max() < 1e-4
    assert np.array_equal(moment.salient, truth.in_contact)
    assert (moment.state == 1).all()
    assert moment.part is not None
    assert np.abs(np.linalg.norm(moment.part.vertices_mm - POSE[:3, 3], axis=1) - 4.0).max() < 0.05
    assert moment.title == "run.mcap: part located, frame 3"
    assert moment.notes == [pose_in_words(POSE), "free, object frame: spin about z"]
    assert draw(moment).shape[2] == 3


def test_a_recording_without_a_pose_shows_its_last_frame(
    tmp_path: Path, noisy_press: list[SimulatedFrame]
) -> None:
    write_recording(tmp_path / "run.mcap", noisy_press, None)
    moment = moment_of_recording(tmp_path / "run.mcap")
    assert moment.part is None
    assert np.array_equal(moment.left, noisy_press[-1].left)


def test_a_recording_that_was_cut_off_is_read_up_to_the_cut(
    tmp_path: Path, noisy_press: list[SimulatedFrame]
) -> None:
    write_recording(tmp_path / "run.mcap", noisy_press * 3, None)
    whole = (tmp_path / "run.mcap").read_bytes()
    for share in (0.0, 0.001, 0.3, 0.6, 0.9):
        (tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
        if share < 0.3:
            with pytest.raises(RecordingError):
                moment_of_recording(tmp_path / "cut.mcap")
        else:
            assert moment_of_recording(tmp_path / "cut.mcap").rows == 25


def test_a_damaged_recording_gives_a_moment_or_an_error(
    tmp_path: Path, noisy_press: list[SimulatedFrame]
) -> None:
    write_recording(tmp_path / "run.mcap", noisy_press[:2], None)
    whole, rng = (tmp_path / "run.mcap").read_bytes(), np.random.default_rng(0)
    refused = 0
    # Bytes at the front, where the lengths and names are, and anywhere.
    for at in [*range(8, 400, 9), *rng.integers(8, len(whole), 30)]:
        damaged = bytearray(whole)
        damaged[at] ^= 0xFF
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        try:
            moment_of_recording(tmp_path / "damaged.mcap")
        except Error as error:
            refused += 1
            assert not str(error).endswith((": ", ":"))
    assert refused > 5


def test_an_image_in_colour_is_refused_by_name(tmp_path: Path, noisy_press: list[SimulatedFrame]) -> None:
    write_recording(tmp_path / "run.mcap", noisy_press, None, encoding="rgb8")
    with pytest.raises(RecordingError, match="encoded as 'rgb8'; valid is 'mono8'"):
        moment_of_recording(tmp_path / "run.mcap")


@pytest.mark.parametrize("package", ["mcap.reader", "lz4"])
def test_a_missing_extra_is_named(package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(RecordingError, match=r"needs (mcap|lz4).*pip install 'gelstereo\[recording\]'"):
        moment_of_recording(tmp_path / "run.mcap")


def test_so3_log_takes_ros_quaternions() -> None:
    assert np.allclose(so3_log(-np.array(so3_exp([0.1, 0.2, 0.3]))), [0.1, 0.2, 0.3])
