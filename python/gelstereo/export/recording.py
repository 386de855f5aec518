"""Iterates over the frames of a recording: markers and images."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo.export.errors import ExportError
from gelstereo.export.images import decoded, views_of
from gelstereo.extras import needs

with needs(__name__):
    import lz4  # noqa: F401 (mcap imports it when it meets the first chunk)
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Image = npt.NDArray[np.uint8]

_MAGIC = b"\x89MCAP0\r\n"
_NS_PER_S = 1_000_000_000
_MM_PER_M = 1000.0
_POINTS = "/gelstereo/points"
_WRENCH = "/gelstereo/wrench"
_CAPTURE = "/gelstereo/capture"
_STEREO = "/gelstereo/stereo/image/compressed"
_IMAGES = {
    "/gelstereo/left/image": "left",
    "/gelstereo/right/image": "right",
    "/gelstereo/left/image/compressed": "left",
    "/gelstereo/right/image/compressed": "right",
}
_TOPICS = {_POINTS, _WRENCH, _CAPTURE, _STEREO, *_IMAGES}


@dataclass(frozen=True)
class RecordedFrame:
    """One sensed frame.

    Attributes
    ----------
    time_ns : int
        Time on the frame source's clock.
    rows, cols : int
        Size of the lattice; marker ``row * cols + col`` has that index.
    points_mm : (N, 3) float64
        Sensor frame.
    state : (N,) uint8
        `gelstereo.MarkerState`.
    images : dict
        ``left`` and ``right``, (H, W) uint8, if recorded.
    tactile : dict
        Other values of the contact by the name of their feature, see `gelstereo.export.features.TACTILE`.
    """

    time_ns: int
    rows: int
    cols: int
    points_mm: npt.NDArray[np.float64]
    state: npt.NDArray[np.uint8]
    images: dict[str, Image]
    tactile: dict[str, npt.NDArray[np.float64]] = field(default_factory=dict)


def frame_times_ns(path: Path) -> list[int]:
    """Times of all frames with markers, in the order of the file."""
    return [_stamp_ns(message) for topic, message in _messages(path, {_POINTS}) if topic == _POINTS]


def has_wrenches(path: Path) -> bool:
    """Whether forces were measured."""
    return any(topic == _WRENCH for topic, _ in _messages(path, {_POINTS, _WRENCH}))


def recorded_frames(path: Path) -> Iterator[RecordedFrame]:
    """All frames with markers, in the order of the file. Frames that could not be sensed are left out.

    Raises
    ------
    ExportError
        If it is no recording of a sensor.
    """
    images: dict[str, tuple[int, Image]] = {}
    layout = "side_by_side"
    # Without contact there is no message.
    tactile = {"wrench": np.zeros(6)} if has_wrenches(path) else {}
    held: RecordedFrame | None = None
    for topic, message in _messages(path, _TOPICS):
        if topic == _CAPTURE:
            layout = json.loads(message.data).get("layout", layout)
        elif topic == _STEREO:
            views = views_of(decoded(message.data), layout)
            images.update(
                {
                    view: (_stamp_ns(message), image)
                    for view, image in zip(("left", "right"), views, strict=True)
                }
            )
        elif topic == _WRENCH:
            if held is not None and held.time_ns == _stamp_ns(message):
                held.tactile["wrench"] = _wrench(message.wrench)
        elif topic in _IMAGES:
            images[_IMAGES[topic]] = (_stamp_ns(message), _image(path, message))
        else:
            time_ns = _stamp_ns(message)
            of_now = {view: image for view, (image_ns, image) in images.items() if image_ns == time_ns}
            if held is not None:
                yield held
            held = _frame(path, time_ns, message, of_now, dict(tactile))
    if held is not None:
        yield held


def _messages(path: Path, topics: set[str]) -> Iterator[tuple[str, Any]]:
    """Messages, decoded by the definitions in the file. For a truncated file, the messages before the end."""
    store: Any = get_typestore(Stores.EMPTY)
    known: set[str] = set()
    count = 0
    with path.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ExportError(f"{path} is not an MCAP file; valid is a recording of a sensor")
        stream.seek(0)
        try:
            for schema, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
                if channel.topic not in topics or schema is None:
                    continue
                if schema.name not in known:
                    types = get_types_from_msg(schema.data.decode(), schema.name)
                    store.register(
                        {name: text for name, text in types.items() if name not in store.fielddefs}
                    )
                    known.add(schema.name)
                count += 1
                yield channel.topic, store.deserialize_cdr(message.data, schema.name)
        except (McapError, EOFError, RuntimeError) as error:
            if count == 0:
                raise ExportError(f"{path} cannot be read as MCAP: {error or 'it ends too early'}") from error


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * _NS_PER_S + int(message.header.stamp.nanosec)


def _wrench(wrench: Any) -> npt.NDArray[np.float64]:
    """(6,) force and torque, N and N mm."""
    force, torque = wrench.force, wrench.torque
    torque_nmm = np.array([torque.x, torque.y, torque.z]) * _MM_PER_M
    return np.array([force.x, force.y, force.z, *torque_nmm])


def _image(path: Path, message: Any) -> Image:
    if hasattr(message, "format"):
        return decoded(message.data)
    if message.encoding != "mono8":
        raise ExportError(f"{path} has an image as {message.encoding!r}; valid is 'mono8'")
    pixels: Image = message.data.reshape(message.height, message.step)[:, : message.width]
    return pixels


def _frame(
    path: Path,
    time_ns: int,
    cloud: Any,
    images: dict[str, Image],
    tactile: dict[str, npt.NDArray[np.float64]],
) -> RecordedFrame:
    offsets = {field.name: field.offset for field in cloud.fields}
    missing = {"x", "y", "z", "state"} - set(offsets)
    if missing:
        raise ExportError(f"{path} has clouds with the fields {sorted(offsets)}; they lack {sorted(missing)}")
    layout = np.dtype(
        {
            "names": ["x", "y", "z", "state"],
            "formats": ["<f4"] * 3 + ["u1"],
            "offsets": [offsets[name] for name in ("x", "y", "z", "state")],
            "itemsize": cloud.point_step,
        }
    )
    values = np.frombuffer(bytes(cloud.data), dtype=layout)
    points_m = np.stack([values["x"], values["y"], values["z"]], axis=1).astype(np.float64)
    return RecordedFrame(
        time_ns, cloud.height, cloud.width, points_m * _MM_PER_M, values["state"].copy(), images, tactile
    )
