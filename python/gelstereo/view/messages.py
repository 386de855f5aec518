"""The ROS 2 messages of a recording, decoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error, se3_exp, so3_log
from gelstereo.extras import needs

Floats = npt.NDArray[np.float64]

_MM_PER_METRE = 1000.0


class RecordingError(Error):
    """Files are not a recording of a sensor, are inconsistent, or lack data for a picture."""


@dataclass(frozen=True)
class Cloud:
    """Markers of one frame in the sensor frame."""

    rows: int
    cols: int
    points_mm: Floats
    indentation_mm: Floats
    state: npt.NDArray[np.uint8]
    salient: npt.NDArray[np.bool_]


class Cdr:
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


def text_of(data: bytes) -> str:
    """The text of a ``std_msgs/msg/String``."""
    return Cdr(data).string()


def image_of(data: bytes) -> npt.NDArray[np.uint8]:
    """(height, width) grey levels of an image without compression."""
    cdr = Cdr(data)
    cdr.header()
    height, width, encoding = cdr.u32(), cdr.u32(), cdr.string()
    if encoding != "mono8":
        raise RecordingError(f"an image is encoded as {encoding!r}; valid is 'mono8'")
    cdr.numbers("B")
    step = cdr.u32()
    pixels = np.frombuffer(cdr.bytes(), dtype=np.uint8)
    return pixels.reshape(height, step)[:, :width]


def compressed_image_of(data: bytes) -> npt.NDArray[np.uint8]:
    """(height, width) grey levels of a PNG or JPEG file in a message."""
    with needs(__name__):
        import cv2

    cdr = Cdr(data)
    cdr.header()
    encoding, file = cdr.string(), np.frombuffer(cdr.bytes(), dtype=np.uint8)
    image = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE) if file.size else None
    if image is None:
        raise RecordingError(
            f"an image of the format {encoding!r} cannot be decoded; valid is 'png' or 'jpeg'"
        )
    return np.asarray(image, dtype=np.uint8)


def left_half(joint: npt.NDArray[np.uint8], layout: str) -> npt.NDArray[np.uint8]:
    """The left view of an image of both views; ``layout`` is the camera's."""
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


_LEFT, _STEREO = "/gelstereo/left/image", "/gelstereo/stereo/image/compressed"
#: Topics whose messages hold a left image.
IMAGE_TOPICS = (_LEFT, f"{_LEFT}/compressed", _STEREO)


@dataclass(frozen=True)
class LeftImage:
    """A message with a left image, decoded on demand because an encoded image takes less memory.

    Attributes
    ----------
    topic
        One of `IMAGE_TOPICS`.
    data
        The message.
    layout
        Arrangement of the views in an image of both.
    """

    topic: str
    data: bytes
    layout: str

    def pixels(self) -> npt.NDArray[np.uint8]:
        """(height, width) grey levels."""
        if self.topic == _LEFT:
            return image_of(self.data)
        image = compressed_image_of(self.data)
        return left_half(image, self.layout) if self.topic == _STEREO else image


def cloud_of(data: bytes) -> Cloud:
    """The markers of a ``sensor_msgs/msg/PointCloud2``."""
    cdr = Cdr(data)
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
    return Cloud(
        rows=rows,
        cols=cols,
        points_mm=points_m * _MM_PER_METRE,
        indentation_mm=values["indentation_mm"].astype(np.float64),
        state=values["state"].copy(),
        salient=values["salient"] != 0,
    )


def pose_of(data: bytes) -> Floats:
    """4x4 matrix of a pose with covariance, millimetres."""
    cdr = Cdr(data)
    cdr.header()
    position, quaternion = cdr.numbers("d", 3), cdr.numbers("d", 4)
    pose = np.array(se3_exp([*so3_log(quaternion), 0.0, 0.0, 0.0]))
    pose[:3, 3] = np.array(position) * _MM_PER_METRE
    return pose


def pose_sigma_of(data: bytes) -> Floats:
    """(6,) standard deviations of a pose: x y z of the part's origin (mm), turns about them (rad); sensor
    frame.
    """
    cdr = Cdr(data)
    cdr.header()
    cdr.numbers("d", 7)
    variances = np.reshape(cdr.numbers("d", 36), (6, 6)).diagonal()
    return np.sqrt(variances) * ([_MM_PER_METRE] * 3 + [1.0] * 3)


def wrench_of(data: bytes) -> Floats:
    """(6,) force (N) and torque about the origin of the sensor frame (N mm) of a
    ``geometry_msgs/msg/WrenchStamped``.
    """
    cdr = Cdr(data)
    cdr.header()
    return np.array(cdr.numbers("d", 6)) * ([1.0] * 3 + [_MM_PER_METRE] * 3)


def opening_of(data: bytes) -> float:
    """Opening width of the gripper in a ``sensor_msgs/msg/JointState``, millimetres."""
    cdr = Cdr(data)
    cdr.header()
    for _ in range(cdr.u32()):
        cdr.string()
    return float(cdr.numbers("d", cdr.u32())[0]) * _MM_PER_METRE
