"""Recording a live run as MCAP with ROS 2 messages: the topics, names and units of `gelstereo-host run`.

It is written from Python, by `mcap` and the message definitions of `rosbags`: the Rust recorder belongs to a host with
threads and files of its own, and sending it every image through a pipe would cost more than writing them here. Images,
settings, rig and digests are kept, so that ``gelstereo-host replay`` computes every frame again and compares.
"""

from __future__ import annotations

import contextlib
import json
import re
import zlib
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Frame, Localization, MarkerState, Params, Rig, __version__
from gelstereo.geometry import so3_from_matrix
from gelstereo.live.sensing import LiveResult
from gelstereo.live.source import LiveFrame

Floats = npt.NDArray[np.float64]

SENSOR_FRAME = "gelstereo_left_optical_frame"
RIGHT_FRAME = "gelstereo_right_optical_frame"

_STRING = "std_msgs/msg/String"
_IMAGE = "sensor_msgs/msg/Image"
_CLOUD = "sensor_msgs/msg/PointCloud2"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_TOPICS = {
    "/gelstereo/left/image": _IMAGE,
    "/gelstereo/right/image": _IMAGE,
    "/gelstereo/points": _CLOUD,
    "/gelstereo/frame": _STRING,
    "/gelstereo/pose": _POSE,
    "/gelstereo/stage": _STRING,
    "/gelstereo/capture": _STRING,
}
_MM_PER_M = 1000.0
_NS_PER_S = 1_000_000_000
_MAX_CHUNK = 1 << 30  # bytes
_FLOAT32, _UINT8 = 7, 2  # sensor_msgs/PointField

#: What is expected of a held part where its contact says nothing: the defaults of the host's ``task.part_sigma_mm``
#: and ``task.part_sigma_rad``.
_PART_SIGMA_MM, _PART_SIGMA_RAD = 0.6, 0.03

_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "indentation_mm", "state", "salient"],
        "formats": ["<f4"] * 4 + ["u1"] * 2,
        "offsets": [0, 4, 8, 12, 16, 17],
        "itemsize": 20,
    }
)


class LiveRecorder:
    """Writes results to one file; a context manager. Every frame is handed to the system before the next one.

    Parameters
    ----------
    path
        The file; its folder is made.
    rig, params
        Those of the pipeline.
    shape : dict, optional
        The part's shape, as a scene's ``indenter`` has it, so that `gelstereo view` can draw it.
    """

    def __init__(self, path: Path, rig: Rig, params: Params, shape: dict[str, Any] | None = None) -> None:
        import lz4  # noqa: F401 (mcap imports it with the first chunk)
        from mcap.writer import CompressionType, Writer
        from rosbags.typesys import Stores, get_typestore

        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self._file = path.open("wb")
        # Only `flush` ends a chunk, after each frame.
        self._writer: Any = Writer(self._file, chunk_size=_MAX_CHUNK, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library=f"gelstereo {__version__}")
        config = {"config_toml": config_toml(rig, params, shape), "version": __version__}
        self._writer.add_metadata("gelstereo", config)
        self._channels = {topic: self._channel(topic, name) for topic, name in _TOPICS.items()}
        self._sequences = dict.fromkeys(_TOPICS, 0)
        self._writer.flush()

    def _channel(self, topic: str, name: str) -> int:
        text, _ = self._store.generate_msgdef(name, ros_version=2)
        schema = self._writer.register_schema(name=name, encoding="ros2msg", data=text.encode())
        return int(self._writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema))

    @property
    def size_bytes(self) -> int:
        """Bytes written so far."""
        return self._file.tell()

    def write(self, result: LiveResult) -> None:
        """Write a result. Of a stale frame only the event is kept: its images are in the file already.

        Raises
        ------
        OSError
            If the disk is full or away; what was written before can be read.
        """
        frame, time_ns = result.frame, result.frame.time_ns
        if frame.event is not None:
            self._text("/gelstereo/capture", time_ns, frame.event_fields or {"event": frame.event})
        if not frame.stale:
            self._image("/gelstereo/left/image", time_ns, SENSOR_FRAME, frame.left)
            self._image("/gelstereo/right/image", time_ns, RIGHT_FRAME, frame.right)
            self._text("/gelstereo/capture", time_ns, capture_note(frame))
            self._text("/gelstereo/frame", time_ns, frame_note(result))
        if result.sensed is not None:
            self._cloud(time_ns, result.sensed)
        if result.located is not None:
            self._pose(time_ns, result.located)
            self._text("/gelstereo/stage", time_ns, pose_note(result.located))
        self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._file.closed:
            self._writer.finish()
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, after an error of the disk."""
        with contextlib.suppress(OSError):  # the rest of the buffer has no room, either
            self._file.close()

    def __enter__(self) -> LiveRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add(self, topic: str, time_ns: int, **fields: Any) -> None:
        name = _TOPICS[topic]
        message = self._store.types[name](**fields)
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=time_ns,
            publish_time=time_ns,
            sequence=self._sequences[topic],
            data=bytes(self._store.serialize_cdr(message, name)),
        )
        self._sequences[topic] += 1

    def _text(self, topic: str, time_ns: int, note: dict[str, Any]) -> None:
        # Keys in order and no spaces, as the host writes them: a replay compares letter by letter.
        self._add(topic, time_ns, data=json.dumps(note, sort_keys=True, separators=(",", ":")))

    def _header(self, time_ns: int, frame_id: str) -> Any:
        types = self._store.types
        seconds, nanoseconds = divmod(time_ns, _NS_PER_S)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def _image(self, topic: str, time_ns: int, frame_id: str, image: npt.NDArray[np.uint8]) -> None:
        height, width = image.shape
        self._add(
            topic,
            time_ns,
            header=self._header(time_ns, frame_id),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(image).reshape(-1),
        )

    def _cloud(self, time_ns: int, sensed: Frame) -> None:
        field = self._store.types["sensor_msgs/msg/PointField"]
        kinds = {"<f4": _FLOAT32, "|u1": _UINT8}
        fields = [
            field(name=name, offset=offset, datatype=kinds[kind.str], count=1)
            for name, (kind, offset, *_) in (_POINT.fields or {}).items()
        ]
        points = np.zeros(len(sensed.points_mm), dtype=_POINT)
        for name, values in zip("xyz", sensed.points_mm.T / _MM_PER_M, strict=True):
            points[name] = values
        points["indentation_mm"] = sensed.indentation_mm
        points["state"], points["salient"] = sensed.state, sensed.salient
        self._add(
            "/gelstereo/points",
            time_ns,
            header=self._header(time_ns, SENSOR_FRAME),
            height=sensed.rows,
            width=sensed.cols,
            fields=fields,
            is_bigendian=False,
            point_step=_POINT.itemsize,
            row_step=_POINT.itemsize * sensed.cols,
            data=points.view(np.uint8),
            is_dense=True,
        )

    def _pose(self, time_ns: int, located: Localization) -> None:
        types = self._store.types
        pose = located.t_sensor_object
        position = types["geometry_msgs/msg/Point"](*(pose[:3, 3] / _MM_PER_M))
        turn = types["geometry_msgs/msg/Quaternion"](*so3_from_matrix(pose[:3, :3]))
        inner = types["geometry_msgs/msg/PoseWithCovariance"](
            pose=types["geometry_msgs/msg/Pose"](position=position, orientation=turn),
            covariance=ros_covariance(located.information, pose).reshape(-1),
        )
        self._add("/gelstereo/pose", time_ns, header=self._header(time_ns, SENSOR_FRAME), pose=inner)


def ros_covariance(information: Floats, t_sensor_object: Floats) -> Floats:
    """Covariance of the part's origin and of its turn about the sensor's axes, as ROS has it.

    Parameters
    ----------
    information : (6, 6)
        Of a left perturbation (ω, v) in the sensor frame, as in `Localization.information`.
    t_sensor_object : (4, 4)

    Returns
    -------
    (6, 6) float64
        x y z, then rotations about them; metres and radians. What the contact leaves free has the variance that is
        expected of a held part: large but finite, as filters want it.
    """
    x, y, z = t_sensor_object[:3, 3]
    # The perturbation moves the origin p by v + ω x p; so v = δp + p x ω.
    jacobian = np.zeros((6, 6))
    jacobian[:3, 3:] = np.eye(3)
    jacobian[3:, :3] = np.eye(3)
    jacobian[3:, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    sigma = np.array([_PART_SIGMA_MM] * 3 + [_PART_SIGMA_RAD] * 3)
    scaled = jacobian * sigma
    covariance = np.linalg.inv(scaled.T @ information @ scaled + np.eye(6)) * np.outer(sigma, sigma)
    units = np.array([1.0 / _MM_PER_M] * 3 + [1.0] * 3)
    out: Floats = covariance * np.outer(units, units)
    return out


def frame_note(result: LiveResult) -> dict[str, Any]:
    """What the host says of a frame on ``/gelstereo/frame``: counts and the digest of all results, or the error."""
    sensed = result.sensed
    if sensed is None:
        return {"error": result.problem}
    return {
        "index": sensed.index,
        "motion_px": sensed.motion_px,
        "seen": int(np.count_nonzero(sensed.state == MarkerState.SEEN)),
        "salient": int(np.count_nonzero(sensed.salient)),
        "detected": [sensed.left.detected, sensed.right.detected],
        "mismatched": sensed.mismatched,
        "digest": f"{sensed.digest:016x}",
    }


def pose_note(located: Localization) -> dict[str, Any]:
    """What is known of a pose, for ``/gelstereo/stage``: how it was come by, what is free, and the digest."""
    return {
        "stage": "live",
        "standing": located.standing,
        "converged": located.converged,
        "free": [str(direction) for direction in located.free],
        "digest": f"{located.digest:016x}",
    }


def capture_note(frame: LiveFrame) -> dict[str, Any]:
    """How a frame was captured, for ``/gelstereo/capture``; clocks are the system's monotonic one.

    The CRC-32 of the pixels is what a replay compares its decoded images with.
    """
    return {
        "sequence": frame.sequence,
        "driver_ns": frame.driver_ns,
        "received_ns": frame.received_ns,
        "dropped": frame.dropped,
        "skew_ns": frame.skew_ns,
        "stale": frame.stale,
        "left_crc32": _pixel_crc(frame.left),
        "right_crc32": _pixel_crc(frame.right),
    }


def _pixel_crc(image: npt.NDArray[np.uint8]) -> str:
    return f"{zlib.crc32(image.tobytes()):08x}"


def config_toml(rig: Rig, params: Params, shape: dict[str, Any] | None = None) -> str:
    """A configuration of the host with this rig, these settings and this part."""
    parts = [_under("params", params.to_toml()), _under("rig", rig.to_toml())]
    if shape is not None:
        parts.append(f"[part]\nshape = {_inline(shape)}\n")
    return "\n".join(parts)


def _under(table: str, text: str) -> str:
    """A TOML text as a table of a larger one."""
    return f"[{table}]\n" + re.sub(r"^(\[+)(?=[a-zA-Z_])", rf"\1{table}.", text, flags=re.MULTILINE)


def _inline(value: Any) -> str:
    """A value in one line of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_inline(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, str | bool | int | float | list):
        return json.dumps(value)
    raise Error(f"a {type(value).__name__} has no place in a configuration")
