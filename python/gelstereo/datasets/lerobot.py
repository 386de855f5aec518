"""Simulated data sets as a LeRobotDataset: each sample is an episode.

Writing needs the extra ``lerobot``: ``pip install gelstereo[lerobot]``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gelstereo._native import se3_log
from gelstereo.datasets.sample import Array, Sample
from gelstereo.export.episode import Episode, Source
from gelstereo.export.lerobot import write_lerobot
from gelstereo.export.recording import RecordedFrame
from gelstereo.export.tactile import force_features
from gelstereo.export.timeline import Timeline
from gelstereo.states import MarkerState

__all__ = ["write_lerobot_samples"]

_NS_PER_S = 1e9


def write_lerobot_samples(
    samples: Iterable[Sample],
    folder: str | Path,
    *,
    task: str = "touch",
    views: Sequence[str] = ("left",),
) -> list[Episode]:
    """Write samples as the episodes of a LeRobotDataset.

    Beside the features of `gelstereo.export.lerobot.export_lerobot` it has ``observation.tactile.part_pose``,
    and with an elastic layer ``force``, ``full``, ``wrench`` and ``stick``: all of them true values.

    Parameters
    ----------
    samples
        With images of the views.
    folder
        Folder of the data set; it must not exist.
    task
        Description of the task in words.
    views
        Views whose images are written: any of ``left`` and ``right``.

    Raises
    ------
    ExportError
        If the folder exists, or samples differ in their features.
    """
    return write_lerobot(_sources(samples), Path(folder), task=task, views=views)


def _sources(samples: Iterable[Sample]) -> Iterator[tuple[Source, Timeline]]:
    for sample in samples:
        times_ns = _times_ns(sample)
        timeline = Timeline.of(times_ns, max(1, round(sample.frame_rate_hz)))
        source = Source(f"sample {sample.index}", partial(_frames, sample), sample.rest["points_mm"])
        yield source, timeline


def _times_ns(sample: Sample) -> list[int]:
    return [round(time_s * _NS_PER_S) for time_s in sample.frames["time_s"]]


def _frames(sample: Sample) -> Iterator[RecordedFrame]:
    state = np.full(sample.rows * sample.cols, MarkerState.SEEN, dtype=np.uint8)
    for at, time_ns in enumerate(_times_ns(sample)):
        values = {name: array[at] for name, array in sample.frames.items()}
        images: dict[str, Array] = {view: values[view] for view in ("left", "right") if view in values}
        tactile = _tactile(values, sample.pitch_mm)
        yield RecordedFrame(time_ns, sample.rows, sample.cols, values["points_mm"], state, images, tactile)


def _tactile(values: dict[str, Array], pitch_mm: float | list[float]) -> dict[str, Array]:
    out: dict[str, Array] = {}
    if "traction_kpa" in values:
        moved_mm, wrench = values["displacement_mm"], (values["force_n"], values["torque_nmm"])
        out |= force_features(moved_mm, values["traction_kpa"], pitch_mm, *wrench)
        out["stick"] = values["stick"]
    if "t_sensor_object" in values:
        turn = se3_log(values["t_sensor_object"])[:3]
        out["part_pose"] = np.concatenate([values["t_sensor_object"][:3, 3], turn])
    return out
