"""Recordings of `gelstereo-host` and `gelstereo live` as tables: columns that polars and pandas take as they
are.

Reading needs the extra ``recording``: ``pip install gelstereo[recording]``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo.geometry import se3_log
from gelstereo.states import MarkerState
from gelstereo.view.mcap_file import Recorded, end_at_damage, read_messages
from gelstereo.view.messages import (
    Cloud,
    RecordingError,
    cloud_of,
    opening_of,
    pose_of,
    pose_sigma_of,
    text_of,
    wrench_of,
)

__all__ = ["Recording", "load_recording"]

#: Columns of equal length by name.
Table = dict[str, npt.NDArray[Any]]

_NS_PER_S = 1e9


@dataclass
class _Sensed:
    """A frame and the later messages about it."""

    time_ns: int
    stage: str
    note: dict[str, Any]
    width_mm: float
    cloud: Cloud | None = None
    pose: npt.NDArray[np.float64] = field(default_factory=lambda: np.full((4, 4), np.nan))
    sigma: npt.NDArray[np.float64] = field(default_factory=lambda: np.full(6, np.nan))
    wrench: npt.NDArray[np.float64] = field(default_factory=lambda: np.full(6, np.nan))
    slip: dict[str, Any] = field(default_factory=dict)

    def count(self, state: MarkerState) -> int:
        return 0 if self.cloud is None else int(np.count_nonzero(self.cloud.state == state))


class Recording:
    """Frames, poses and markers of a recording; `load_recording` makes it.

    Each table is a dictionary of columns of equal length. ``polars.DataFrame(table)`` and
    ``pandas.DataFrame(table)`` take it as it is. Missing numbers are NaN.

    Attributes
    ----------
    path : Path
    t_sensor_object : (F, 4, 4) float64
        Pose of the part in each frame, millimetres; NaN where the part was not localized.
    """

    def __init__(self, path: Path, sensed: list[_Sensed]) -> None:
        self.path = path
        self._sensed = sensed
        self.t_sensor_object = np.array([frame.pose for frame in sensed])
        self.t_sensor_object.setflags(write=False)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._sensed)

    def __repr__(self) -> str:
        poses = int(np.count_nonzero(~np.isnan(self.t_sensor_object[:, 0, 0])))
        seconds = (self._sensed[-1].time_ns - self._sensed[0].time_ns) / _NS_PER_S
        return f"<Recording {self.path.name}: {len(self)} frames in {seconds:.1f} s, {poses} with a pose>"

    def frame_table(self) -> Table:
        """One row per frame, in the order of the recording.

        Returns
        -------
        dict of ndarray
            - ``time_ns`` (of the frame source's clock), ``time_s`` (since the first frame)
            - ``stage`` of the run, and ``error`` of a frame that could not be sensed; empty if there is none
            - ``index`` since the rest frame, -1 with an error
            - ``motion_px``: mean motion of the markers in the left image since the reference
            - ``seen``, ``held``, ``lost``, ``salient``: numbers of markers
            - ``max_indentation_mm``
            - ``x_mm``, ``y_mm``, ``z_mm``: the part's origin in the sensor frame
            - ``rx_rad``, ``ry_rad``, ``rz_rad``: rotation vector of the part in the sensor frame
            - ``sigma_`` and the name of these six: standard deviations, rotations about the sensor's axes
            - ``fx_n``, ``fy_n``, ``fz_n``, ``tx_nmm``, ``ty_nmm``, ``tz_nmm``: force and torque of the part
              on the gel, about the origin of the sensor frame; NaN without contact or ``force.method``
            - ``slip``: ``unknown``, ``stuck``, ``incipient`` or ``gross``; empty without contact or without
              ``slip.method``
            - ``stick_ratio``: markers that stick over those known to stick or slip
            - ``slip_margin``: share of the friction limit that is not used; NaN where it is not known
            - ``gripper_width_mm``: the latest opening width
        """
        frames = self._sensed
        time_ns = np.array([frame.time_ns for frame in frames], dtype=np.int64)
        table: Table = {
            "time_ns": time_ns,
            "time_s": (time_ns - time_ns[0]) / _NS_PER_S,
            "stage": np.array([frame.stage for frame in frames]),
            "error": np.array([str(frame.note.get("error", "")) for frame in frames]),
            "index": np.array([frame.note.get("index", -1) for frame in frames], dtype=np.int64),
            "motion_px": np.array(
                [frame.note.get("motion_px", np.nan) for frame in frames], dtype=np.float64
            ),
        }
        for state in MarkerState:
            table[state.name.lower()] = np.array([frame.count(state) for frame in frames])
        clouds = [frame.cloud for frame in frames]
        table["salient"] = np.array([0 if c is None else int(np.count_nonzero(c.salient)) for c in clouds])
        table["max_indentation_mm"] = np.array(
            [np.nan if c is None else float(np.max(c.indentation_mm, initial=0.0)) for c in clouds]
        )
        table |= self._pose_columns() | self._force_columns()
        return table | {"gripper_width_mm": np.array([f.width_mm for f in frames])}

    def _pose_columns(self) -> Table:
        known = ~np.isnan(self.t_sensor_object[:, 0, 0])
        turns = np.full((len(self), 3), np.nan)
        for row in np.flatnonzero(known):
            turns[row] = se3_log(self.t_sensor_object[row])[:3]
        values = np.hstack([self.t_sensor_object[:, :3, 3], turns])
        sigma = np.array([frame.sigma for frame in self._sensed])
        names = ["x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"]
        return dict(zip(names, values.T, strict=True)) | {
            f"sigma_{name}": column for name, column in zip(names, sigma.T, strict=True)
        }

    def _force_columns(self) -> Table:
        wrench = np.array([frame.wrench for frame in self._sensed])
        names = ["fx_n", "fy_n", "fz_n", "tx_nmm", "ty_nmm", "tz_nmm"]
        ratios = [frame.slip.get("stick_ratio") for frame in self._sensed]
        margins = [(frame.slip.get("margin") or {}).get("share", np.nan) for frame in self._sensed]
        return dict(zip(names, wrench.T, strict=True)) | {
            "slip": np.array([frame.slip.get("status", "") for frame in self._sensed]),
            "stick_ratio": np.array(
                [np.nan if ratio is None else ratio for ratio in ratios], dtype=np.float64
            ),
            "slip_margin": np.array(margins, dtype=np.float64),
        }

    def marker_table(self) -> Table:
        """One row per marker and frame; frames that could not be sensed have none.

        Returns
        -------
        dict of ndarray
            - ``frame``: row of the frame in `frame_table`
            - ``marker``, and its ``row`` and ``col`` in the lattice
            - ``x_mm``, ``y_mm``, ``z_mm``: the sensor frame
            - ``indentation_mm``: positive towards the cameras
            - ``state``: `gelstereo.MarkerState` as a number
            - ``salient``
        """
        clouds = [(at, frame.cloud) for at, frame in enumerate(self._sensed) if frame.cloud is not None]
        sizes = [len(cloud.points_mm) for _, cloud in clouds]
        marker = np.concatenate([np.arange(size) for size in sizes])
        cols = np.repeat([cloud.cols for _, cloud in clouds], sizes)
        points_mm = np.concatenate([cloud.points_mm for _, cloud in clouds])
        return {
            "frame": np.repeat([at for at, _ in clouds], sizes),
            "marker": marker,
            "row": marker // cols,
            "col": marker % cols,
            "x_mm": points_mm[:, 0],
            "y_mm": points_mm[:, 1],
            "z_mm": points_mm[:, 2],
            "indentation_mm": np.concatenate([cloud.indentation_mm for _, cloud in clouds]),
            "state": np.concatenate([cloud.state for _, cloud in clouds]),
            "salient": np.concatenate([cloud.salient for _, cloud in clouds]),
        }


def load_recording(path: str | Path) -> Recording:
    """Read the results of a recording; its images are passed over.

    Parameters
    ----------
    path
        An MCAP file of ``gelstereo-host`` or ``gelstereo live``; a truncated one is read up to its end.

    Raises
    ------
    RecordingError
        If the file is not a recording of a sensor, or has no frame with markers.
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    With polars: ``polars.DataFrame(load_recording("run.mcap").frame_table())``.
    """
    path = Path(path)
    walk = _Walk()
    try:
        for message in read_messages(path):
            walk.take(message)
    except Exception as error:
        end_at_damage(path, error, walk.has_markers)
    if not walk.has_markers:
        raise RecordingError(f"{path} has no frame with markers; valid is a recording by gelstereo-host")
    return Recording(path, walk.sensed)


class _Walk:
    """State while reading the messages in their order."""

    def __init__(self) -> None:
        self.sensed: list[_Sensed] = []
        self.has_markers = False
        self._stage = ""
        self._width_mm = np.nan

    def take(self, message: Recorded) -> None:
        topic, data = message.topic, message.data
        if topic == "/gripper/state":
            self._width_mm = opening_of(data)
        elif topic == "/gelstereo/stage":
            self._stage = json.loads(text_of(data)).get("stage", self._stage)
        elif topic == "/gelstereo/frame":
            note = json.loads(text_of(data))
            self.sensed.append(_Sensed(message.source_ns, self._stage, note, self._width_mm))
        elif topic == "/gelstereo/points" and self.sensed:
            self.sensed[-1].cloud, self.has_markers = cloud_of(data), True
        elif topic == "/gelstereo/pose" and self.sensed:
            # A pose follows its frame, as in the viewer.
            self.sensed[-1].pose, self.sensed[-1].sigma = pose_of(data), pose_sigma_of(data)
        elif topic == "/gelstereo/wrench" and self.sensed:
            self.sensed[-1].wrench = wrench_of(data)
        elif topic == "/gelstereo/slip" and self.sensed:
            self.sensed[-1].slip = json.loads(text_of(data))
