"""The last located moment of a recording that ``gelstereo-host`` wrote (MCAP with ROS 2 messages).

Reading needs the extra ``recording``: ``pip install gelstereo[recording]``.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error, Rig, Scene, parse_toml, se3_exp, shape_mesh, so3_log
from gelstereo.view.moment import Moment, Part, pose_in_words

Floats = npt.NDArray[np.float64]

_MAGIC = b"\x89MCAP0\r\n"

#: Deviation of a flattened shape from the true one, in the picture only.
_SHAPE_TOLERANCE_MM = 0.02
_MM_PER_METRE = 1000.0


class RecordingError(Error):
    """A file is no recording of a sensor, or lacks what a picture needs."""


@dataclass
class _Cloud:
    rows: int
    cols: int
    points_mm: Floats
    indentation_mm: Floats
    state: npt.NDArray[np.uint8]
    salient: npt.NDArray[np.bool_]


@dataclass
class _Recorded:
    """The first cloud, and the last of everything up to the last pose (or to the end without one)."""

    config: dict[str, Any] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    rest: _Cloud | None = None
    cloud: _Cloud | None = None
    left: npt.NDArray[np.uint8] | None = None
    layout: str = "side_by_side"
    frame: dict[str, Any] = field(default_factory=dict)
    pose: Floats | None = None
    at_pose: tuple[_Cloud, npt.NDArray[np.uint8], dict[str, Any]] | None = None
    notes: dict[str, Any] = field(default_factory=dict)


def moment_of_recording(path: str | Path) -> Moment:
    """The moment of the last pose in a recording, or its last frame if the part was never located.

    Parameters
    ----------
    path
        An MCAP file; one that was cut off is read up to the cut.

    Raises
    ------
    RecordingError
        If it is no recording of a sensor.
    FileNotFoundError
        If there is no such file.
    """
    recorded = _read(Path(path))
    if recorded.rest is None or recorded.cloud is None or recorded.left is None:
        raise RecordingError(
            f"{path} has no stereo frame with markers; valid is a recording by gelstereo-host"
        )
    cloud, left, frame = recorded.at_pose or (recorded.cloud, recorded.left, recorded.frame)
    rig = _rig(recorded.config)
    part = None if recorded.pose is None else _part(recorded, recorded.pose)
    notes = [] if recorded.pose is None else [pose_in_words(recorded.pose)]
    free = recorded.notes.get("free")
    if recorded.pose is not None:
        notes.append("free: " + "; ".join(free) if free else "all six directions determined")
    place = f"frame {frame['index']}" if "index" in frame else "last frame"
    return Moment(
        left=left,
        rows=cloud.rows,
        cols=cloud.cols,
        left_px=rig.project(cloud.points_mm)[0],
        reference_px=rig.project(recorded.rest.points_mm)[0],
        points_mm=cloud.points_mm,
        indentation_mm=cloud.indentation_mm,
        state=cloud.state,
        salient=cloud.salient,
        part=part,
        title=f"{Path(path).name}: {'part located' if part else 'no part located'}, {place}",
        notes=notes,
    )


def _read(path: Path) -> _Recorded:
    try:
        import lz4  # noqa: F401 (mcap imports it when it meets the first chunk)
        from mcap.reader import NonSeekingReader
    except ImportError as error:
        missing = (error.name or "mcap").partition(".")[0]
        raise RecordingError(
            f"reading recordings needs {missing}, which is not installed: pip install 'gelstereo[recording]'"
        ) from error
    recorded = _Recorded()
    with path.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise RecordingError(
                f"{path} is no MCAP file; valid is a recording by gelstereo-host, or a folder"
            )
        stream.seek(0)
        try:
            for _, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
                _take(recorded, channel.topic, message.data)
        except Error:
            raise
        except Exception as error:  # the errors of the reader and of what unpacks its chunks share no base
            # Of a file that was cut off or damaged, what came before is good.
            if recorded.cloud is None:
                reason = str(error) or "it ends before the first frame"
                raise RecordingError(f"{path} cannot be read as MCAP: {reason}") from error
    with path.open("rb") as stream:
        _read_header(stream, recorded)
    return recorded


def _read_header(stream: Any, recorded: _Recorded) -> None:
    from mcap.records import Attachment, Metadata
    from mcap.stream_reader import StreamReader

    try:
        for record in StreamReader(stream).records:
            if isinstance(record, Metadata) and "config_toml" in record.metadata:
                recorded.config = parse_toml(record.metadata["config_toml"])
            elif isinstance(record, Attachment):
                recorded.attachments[record.name] = record.data
    except Exception:  # as above
        return  # cut off or damaged; the header comes first


def _take(recorded: _Recorded, topic: str, data: bytes) -> None:
    if topic == "/gelstereo/left/image":
        recorded.left = _image(data)
    elif topic == "/gelstereo/left/image/compressed":
        recorded.left = _compressed_image(data)
    elif topic == "/gelstereo/capture":
        recorded.layout = json.loads(_Cdr(data).string()).get("layout", recorded.layout)
    elif topic == "/gelstereo/stereo/image/compressed":
        recorded.left = _left_half(_compressed_image(data), recorded.layout)
    elif topic == "/gelstereo/points":
        recorded.cloud = _cloud(data)
        recorded.rest = recorded.rest or recorded.cloud
    elif topic == "/gelstereo/frame":
        recorded.frame = json.loads(_Cdr(data).string())
    elif topic == "/gelstereo/stage":
        note = json.loads(_Cdr(data).string())
        if "free" in note:
            recorded.notes = note
    elif topic == "/gelstereo/pose" and recorded.cloud is not None and recorded.left is not None:
        recorded.pose = _pose(data)
        recorded.at_pose = (recorded.cloud, recorded.left, recorded.frame)


def _rig(config: dict[str, Any]) -> Rig:
    """The configuration's rig, or the simulated sensor's, which is the default."""
    return Scene().replace(rig=config["rig"]).rig if "rig" in config else Scene().rig


def _part(recorded: _Recorded, pose: Floats) -> Part | None:
    shape = recorded.config.get("part", {}).get("shape")
    if shape is None:
        return None
    if shape["kind"] != "mesh":
        return Part.located(*shape_mesh(shape, _SHAPE_TOLERANCE_MM), pose)
    name = Path(shape["path"]).name
    for attached, data in recorded.attachments.items():
        if Path(attached).name == name:
            return Part.located(*_attached_mesh(data, name, shape["units"]), pose)
    return None


def _attached_mesh(data: bytes, name: str, units: Any) -> tuple[Floats, npt.NDArray[np.int64]]:
    from io import BytesIO

    import trimesh

    from gelstereo.templates import load_mesh

    kind = Path(name).suffix.lstrip(".")
    return load_mesh(trimesh.load(BytesIO(data), file_type=kind, force="mesh"), units)


class _Cdr:
    """Reads the few ROS 2 messages of a recording: little-endian CDR, aligned to each value's size."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[1] != 1:
            raise RecordingError("a message is not little-endian CDR; valid is what gelstereo-host writes")
        self._data, self._at = memoryview(data)[4:], 0

    def numbers(self, kind: str, count: int = 1) -> tuple[Any, ...]:
        size = struct.calcsize(kind)
        self._at += -self._at % size
        values = struct.unpack_from(f"<{count}{kind}", self._data, self._at)
        self._at += size * count
        return values

    def u32(self) -> int:
        return int(self.numbers("I")[0])

    def bytes(self) -> memoryview:
        length = self.u32()
        out = self._data[self._at : self._at + length]
        self._at += length
        return out

    def string(self) -> str:
        return bytes(self.bytes()).rstrip(b"\0").decode()

    def header(self) -> None:
        self.numbers("I", 2)
        self.string()


def _image(data: bytes) -> npt.NDArray[np.uint8]:
    cdr = _Cdr(data)
    cdr.header()
    height, width, encoding = cdr.u32(), cdr.u32(), cdr.string()
    if encoding != "mono8":
        raise RecordingError(f"an image is encoded as {encoding!r}; valid is 'mono8'")
    cdr.numbers("B")
    step = cdr.u32()
    pixels = np.frombuffer(cdr.bytes(), dtype=np.uint8)
    return pixels.reshape(height, step)[:, :width]


def _compressed_image(data: bytes) -> npt.NDArray[np.uint8]:
    """(height, width) grey levels of a PNG or JPEG file in a message."""
    import cv2

    cdr = _Cdr(data)
    cdr.header()
    encoding, file = cdr.string(), np.frombuffer(cdr.bytes(), dtype=np.uint8)
    image = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE) if file.size else None
    if image is None:
        raise RecordingError(
            f"an image of the format {encoding!r} cannot be decoded; valid is 'png' or 'jpeg'"
        )
    return np.asarray(image, dtype=np.uint8)


def _left_half(joint: npt.NDArray[np.uint8], layout: str) -> npt.NDArray[np.uint8]:
    """The left view of an image of both; ``layout`` is the camera's."""
    width = joint.shape[1] // 2
    views = {
        "side_by_side": joint[:, :width],
        "side_by_side_swapped": joint[:, width:],
        "interleaved": joint[:, 0::2],
        "interleaved_swapped": joint[:, 1::2],
    }
    if layout not in views:
        raise RecordingError(f"a stereo image has the layout {layout!r}; valid is one of {sorted(views)}")
    return views[layout]


def _cloud(data: bytes) -> _Cloud:
    cdr = _Cdr(data)
    cdr.header()
    rows, cols, count = cdr.u32(), cdr.u32(), cdr.u32()
    offsets = {}
    for _ in range(count):
        name, offset = cdr.string(), cdr.u32()
        cdr.numbers("B")
        cdr.u32()
        offsets[name] = offset
    cdr.numbers("B")
    step = cdr.u32()
    cdr.u32()
    names = ["x", "y", "z", "indentation_mm", "state", "salient"]
    if any(name not in offsets for name in names):
        raise RecordingError(f"a cloud has the fields {sorted(offsets)}; valid is {names}")
    layout = np.dtype(
        {
            "names": names,
            "formats": ["<f4"] * 4 + ["u1"] * 2,
            "offsets": [offsets[name] for name in names],
            "itemsize": step,
        }
    )
    values = np.frombuffer(cdr.bytes(), dtype=layout)
    points_m = np.stack([values["x"], values["y"], values["z"]], axis=1).astype(np.float64)
    return _Cloud(
        rows=rows,
        cols=cols,
        points_mm=points_m * _MM_PER_METRE,
        indentation_mm=values["indentation_mm"].astype(np.float64),
        state=values["state"].copy(),
        salient=values["salient"] != 0,
    )


def _pose(data: bytes) -> Floats:
    cdr = _Cdr(data)
    cdr.header()
    position, quaternion = cdr.numbers("d", 3), cdr.numbers("d", 4)
    pose = np.array(se3_exp([*so3_log(quaternion), 0.0, 0.0, 0.0]))
    pose[:3, 3] = np.array(position) * _MM_PER_METRE
    return pose
