"""Recording a live run as MCAP with ROS 2 messages: the topics, names and units of `gelstereo-host run`.

It is written from Python, with `mcap` and the message definitions of `rosbags`. The Rust recorder is part of
the host process, and sending it every image through a pipe would cost more than writing the images here. The
recording includes images, settings, rig and digests, so ``gelstereo-host replay`` can recompute every frame
and compare.
"""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Frame, Localization, Params, Rig, Wrench, __version__
from gelstereo.extras import needs
from gelstereo.geometry import so3_from_matrix
from gelstereo.live.notes import (
    COMPLIANCE,
    capture_note,
    config_toml,
    frame_note,
    pose_note,
    ros_covariance,
    slip_note,
)
from gelstereo.live.sensing import LiveResult
from gelstereo.live.source import LiveFrame

with needs(__name__):
    import lz4  # noqa: F401 (mcap imports it with the first chunk)
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

Floats = npt.NDArray[np.float64]

SENSOR_FRAME = "gelstereo_left_optical_frame"
RIGHT_FRAME = "gelstereo_right_optical_frame"

_STRING = "std_msgs/msg/String"
_IMAGE = "sensor_msgs/msg/Image"
_CLOUD = "sensor_msgs/msg/PointCloud2"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_WRENCH = "geometry_msgs/msg/WrenchStamped"
_TOPICS = {
    "/gelstereo/left/image": _IMAGE,
    "/gelstereo/right/image": _IMAGE,
    "/gelstereo/left/image/compressed": _COMPRESSED,
    "/gelstereo/right/image/compressed": _COMPRESSED,
    "/gelstereo/stereo/image/compressed": _COMPRESSED,
    "/gelstereo/points": _CLOUD,
    "/gelstereo/frame": _STRING,
    "/gelstereo/pose": _POSE,
    "/gelstereo/wrench": _WRENCH,
    "/gelstereo/slip": _STRING,
    "/gelstereo/stage": _STRING,
    "/gelstereo/capture": _STRING,
}
_MM_PER_M = 1000.0
_NS_PER_S = 1_000_000_000
_MAX_CHUNK = 1 << 30  # bytes
_FLOAT32, _UINT8 = 7, 2  # sensor_msgs/PointField

_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "indentation_mm", "state", "salient"],
        "formats": ["<f4"] * 4 + ["u1"] * 2,
        "offsets": [0, 4, 8, 12, 16, 17],
        "itemsize": 20,
    }
)


class LiveRecorder:
    """Writes results to one file; a context manager. Every frame is flushed to the system before the next
    one.

    Parameters
    ----------
    path
        The file; its folder is created.
    rig, params
        Rig and settings of the pipeline.
    shape : dict, optional
        The part's shape in the format of a scene's ``indenter``, so that `gelstereo view` can draw it. A mesh
        is attached.
    compliance
        File of the gel's compliance matrix, if the pipeline has one; it is attached.
    png
        Whether plain images are compressed without loss. Motion JPEG of a camera is stored unchanged.
    wall_clock
        Whether messages are also stamped with the wall-clock time, as for a camera. Otherwise repeated runs
        produce identical files.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        params: Params,
        shape: dict[str, Any] | None = None,
        *,
        compliance: Path | None = None,
        png: bool = True,
        wall_clock: bool = False,
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._png = png
        self._wall_clock = wall_clock
        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self._file = path.open("wb")
        # Chunks end only at `flush`, after each frame.
        self._writer: Any = Writer(self._file, chunk_size=_MAX_CHUNK, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library=f"gelstereo {__version__}")
        clock = "wall" if wall_clock else "source"
        config = config_toml(rig, params, shape, has_compliance=compliance is not None)
        self._writer.add_metadata(
            "gelstereo", {"config_toml": config, "version": __version__, "log_clock": clock}
        )
        if shape is not None and shape["kind"] == "mesh":
            mesh = Path(shape["path"])
            self._attach(mesh.name, mesh)
        if compliance is not None:
            self._attach(COMPLIANCE, compliance)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences = dict.fromkeys(_TOPICS, 0)
        self._writer.flush()

    def _attach(self, name: str, path: Path) -> None:
        kind = "application/octet-stream"
        self._writer.add_attachment(0, 0, name=name, media_type=kind, data=path.read_bytes())

    def _channel(self, topic: str, name: str) -> int:
        """The topic's channel, created with its first message."""
        if topic in self._channels:
            return self._channels[topic]
        if name not in self._schemas:
            text, _ = self._store.generate_msgdef(name, ros_version=2)
            schema = self._writer.register_schema(name=name, encoding="ros2msg", data=text.encode())
            self._schemas[name] = int(schema)
        schema = self._schemas[name]
        channel = int(self._writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema))
        self._channels[topic] = channel
        return channel

    @property
    def size_bytes(self) -> int:
        """Bytes written so far."""
        return self._file.tell()

    def write(self, result: LiveResult) -> None:
        """Write a result. For a stale frame only the event is written, because its images are in the file
        already.

        Raises
        ------
        OSError
            If the disk is full or removed; earlier data stays readable.
        """
        frame, time_ns = result.frame, result.frame.time_ns
        if frame.event is not None:
            self._text("/gelstereo/capture", time_ns, frame.event_fields or {"event": frame.event})
        if not frame.stale:
            self._text("/gelstereo/capture", time_ns, capture_note(frame))
            self._pair(frame)
            self._text("/gelstereo/frame", time_ns, frame_note(result))
        if result.sensed is not None:
            self._cloud(time_ns, result.sensed)
            if result.sensed.wrench is not None:
                self._wrench(time_ns, result.sensed.wrench)
            if result.sensed.slip is not None:
                self._text("/gelstereo/slip", time_ns, slip_note(result.sensed.slip))
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
        """Close the file without an index, after a disk error."""
        with contextlib.suppress(OSError):  # writing the rest of the buffer fails too
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
            channel_id=self._channel(topic, name),
            log_time=time.time_ns() if self._wall_clock else time_ns,
            publish_time=time_ns,
            sequence=self._sequences[topic],
            data=bytes(self._store.serialize_cdr(message, name, little_endian=True)),
        )
        self._sequences[topic] += 1

    def _text(self, topic: str, time_ns: int, note: dict[str, Any]) -> None:
        # Sorted keys and no spaces, as the host writes them: a replay compares byte by byte.
        self._add(topic, time_ns, data=json.dumps(note, sort_keys=True, separators=(",", ":")))

    def _header(self, time_ns: int, frame_id: str) -> Any:
        types = self._store.types
        seconds, nanoseconds = divmod(time_ns, _NS_PER_S)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def _pair(self, frame: LiveFrame) -> None:
        """Both images: as sent by the camera, or losslessly encoded."""
        time_ns, sides = (
            frame.time_ns,
            (("left", SENSOR_FRAME, frame.left), ("right", RIGHT_FRAME, frame.right)),
        )
        if len(frame.encoded) == 1:
            self._compressed(
                "/gelstereo/stereo/image/compressed", time_ns, SENSOR_FRAME, "jpeg", frame.encoded[0]
            )
        elif len(frame.encoded) == 2:
            for (side, frame_id, _), file in zip(sides, frame.encoded, strict=True):
                self._compressed(f"/gelstereo/{side}/image/compressed", time_ns, frame_id, "jpeg", file)
        elif self._png:
            for side, frame_id, image in sides:
                self._compressed(f"/gelstereo/{side}/image/compressed", time_ns, frame_id, "png", _png(image))
        else:
            for side, frame_id, image in sides:
                self._image(f"/gelstereo/{side}/image", time_ns, frame_id, image)

    def _compressed(self, topic: str, time_ns: int, frame_id: str, kind: str, file: bytes) -> None:
        data = np.frombuffer(file, dtype=np.uint8)
        self._add(topic, time_ns, header=self._header(time_ns, frame_id), format=kind, data=data)

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

    def _wrench(self, time_ns: int, wrench: Wrench) -> None:
        types = self._store.types
        about_origin = wrench.about([0.0, 0.0, 0.0])
        vectors = (about_origin.force_n, about_origin.torque_nmm / _MM_PER_M)
        force, torque = (types["geometry_msgs/msg/Vector3"](*vector) for vector in vectors)
        inner = types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
        self._add("/gelstereo/wrench", time_ns, header=self._header(time_ns, SENSOR_FRAME), wrench=inner)

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


def _png(image: npt.NDArray[np.uint8]) -> bytes:
    with needs(__name__):
        import cv2

    done, data = cv2.imencode(".png", image)
    if not done:
        raise Error("an image cannot be encoded as PNG")
    return bytes(data)
