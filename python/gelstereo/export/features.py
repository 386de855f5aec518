"""The features of an exported dataset: names, shapes and units, their columns, and a frame's values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo.export.errors import ExportError
from gelstereo.export.recording import RecordedFrame
from gelstereo.extras import needs

with needs(__name__):
    import pyarrow as pa

DISPLACEMENT = "observation.tactile.displacement"
MARKER_STATE = "observation.tactile.marker_state"
IMAGES = "observation.images."
_PREFIX = "observation.tactile."
_AXES = {"axes": ["x", "y", "z"], "frame": "left camera"}

#: Features beside displacement and state, by the last part of their name: names of the axes, and notes. The
#: data types `force`, `full` and `wrench` are those of the tactile module proposed to LeRobot.
TACTILE: dict[str, tuple[list[str], dict[str, Any]]] = {
    "force": (["marker", "axis"], {"unit": "N", **_AXES}),
    "full": (
        ["marker", "channel"],
        {"unit": ["mm"] * 3 + ["N"] * 3, "channels": ["dx", "dy", "dz", "Fx", "Fy", "Fz"], **_AXES},
    ),
    "wrench": (
        ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"],
        {"unit": ["N"] * 3 + ["N mm"] * 3, "about": "origin of the left camera's frame", **_AXES},
    ),
    "stick": (["marker"], {"values": {"free": 0, "stuck": 1, "slips": 2, "unknown": 3}}),
    "part_pose": (
        ["x", "y", "z", "rx", "ry", "rz"],
        {"unit": ["mm"] * 3 + ["rad"] * 3, "rotation": "rotation vector", "frame": "left camera"},
    ),
}

#: PNG compression, 1 to 9. A simulated 640 x 480 image as three equal colours takes 259 kB. Level 1 takes 301
#: kB in two thirds of the time; level 9 takes 237 kB in ten times the time.
_PNG_LEVEL = 3

Features = dict[str, dict[str, Any]]
Values = dict[str, npt.NDArray[Any]]

#: Features that LeRobot adds to every dataset.
COUNTED: Features = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}


def features_of(path: Path | str, frame: RecordedFrame, views: tuple[str, ...]) -> Features:
    """The features of a dataset with frames of this format."""
    lattice = {"rows": frame.rows, "cols": frame.cols, "order": "row * cols + col"}
    out: Features = {
        DISPLACEMENT: {
            "dtype": "float32",
            "shape": [len(frame.points_mm), 3],
            "names": ["marker", "axis"],
            "info": {"unit": "mm", "axes": ["x", "y", "z"], "frame": "left camera", **lattice},
        },
        MARKER_STATE: {
            "dtype": "uint8",
            "shape": [len(frame.state)],
            "names": None,
            "info": {"values": {"seen": 0, "held": 1, "lost": 2}, **lattice},
        },
    }
    for name, values in frame.tactile.items():
        names, info = TACTILE[name]
        dtype = "uint8" if name == "stick" else "float32"
        extra = lattice if names[0] == "marker" else {}
        feature = {"dtype": dtype, "shape": list(values.shape), "names": names, "info": {**info, **extra}}
        out[_PREFIX + name] = feature
    for view in views:
        height, width = _image(path, frame, view).shape
        shape = {"shape": [height, width, 3], "names": ["height", "width", "channels"]}
        out[IMAGES + view] = {"dtype": "image", **shape}
    return out | COUNTED


def schema_of(features: Features) -> pa.Schema:
    """Columns of a data file, in the layout of the `datasets` library."""
    return pa.schema([(name, _column(feature)) for name, feature in features.items()])


def _column(feature: dict[str, Any]) -> pa.DataType:
    if feature["dtype"] == "image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    value = pa.type_for_alias(feature["dtype"])
    if feature["shape"] == [1]:
        return value
    column = pa.list_(value, feature["shape"][0])
    return column if len(feature["shape"]) == 1 else pa.list_(pa.list_(value))


def values_of(
    path: Path | str, frame: RecordedFrame, rest_mm: npt.NDArray[np.float64], features: Features
) -> Values:
    """A frame's values of the features; images are (H, W) uint8."""
    if len(frame.points_mm) != features[DISPLACEMENT]["shape"][0]:
        markers = features[DISPLACEMENT]["shape"][0]
        raise ExportError(f"{path} has {len(frame.points_mm)} markers; the dataset's frames have {markers}")
    values: Values = {
        DISPLACEMENT: (frame.points_mm - rest_mm).astype(np.float32),
        MARKER_STATE: frame.state,
    }
    for name, found in frame.tactile.items():
        feature = features.get(_PREFIX + name)
        if feature is not None:
            values[_PREFIX + name] = np.asarray(found).astype(feature["dtype"])
    missing = [name for name in features if name.startswith(_PREFIX) and name not in values]
    if missing:
        raise ExportError(f"{path} has a frame without {missing[0]}; the frames before have it")
    for name in features:
        if name.startswith(IMAGES):
            image = _image(path, frame, name.removeprefix(IMAGES))
            if [*image.shape, 3] != features[name]["shape"]:
                raise ExportError(
                    f"{path} has images of {image.shape}; the dataset's are {features[name]['shape']}"
                )
            values[name] = image
    return values


def row_of(values: Values) -> dict[str, Any]:
    """Values as a row of a data file. Images become PNG files of three equal colours, the input format of
    policies.
    """
    with needs(__name__):
        import cv2

    row: dict[str, Any] = {}
    for name, value in values.items():
        if name.startswith(IMAGES):
            colours = np.repeat(value[:, :, None], 3, axis=2)
            done, data = cv2.imencode(".png", colours, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])
            if not done:
                raise ExportError("an image cannot be encoded as PNG")
            row[name] = {"bytes": bytes(data), "path": None}
        else:
            row[name] = value.tolist()
    return row


def _image(path: Path | str, frame: RecordedFrame, view: str) -> npt.NDArray[np.uint8]:
    if view not in frame.images:
        raise ExportError(
            f"{path} has no {view} image of the frame at {frame.time_ns} ns; export it with --images none"
        )
    return frame.images[view]
