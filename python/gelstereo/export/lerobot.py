"""Recordings as a LeRobotDataset, format v3.0, which LeRobot 0.4 and later open from a folder.

Each recording is an episode. The format is written with pyarrow alone, so that neither LeRobot nor torch is
needed; LeRobot's own loader opens the result in the tests.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gelstereo._native import Params
from gelstereo.export.episode import Episode, EpisodeWriter, Source
from gelstereo.export.errors import ExportError
from gelstereo.export.folder import new_folder
from gelstereo.export.forces import frames_with_forces
from gelstereo.export.recording import frame_times_ns, recorded_frames
from gelstereo.export.statistics import pooled
from gelstereo.export.timeline import Timeline
from gelstereo.extras import needs

with needs(__name__):
    import pyarrow as pa
    import pyarrow.parquet as pq

FORMAT = "v3.0"
_FILES_A_CHUNK = 1000
_DATA_FILE_MB, _VIDEO_FILE_MB = 100, 200
_PATH = "{folder}/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


def export_lerobot(
    recordings: Sequence[Path],
    folder: Path,
    *,
    task: str,
    fps: int | None = None,
    views: Sequence[str] = ("left",),
    forces: bool = False,
    force_settings: Params | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Episode]:
    """Write recordings as a dataset.

    Parameters
    ----------
    recordings
        MCAP files of `gelstereo-host` or `gelstereo live`; one episode each.
    folder
        Folder of the dataset; it must not exist.
    task
        Description of the task in words.
    fps
        Frames per second. Default: the rate of the first recording. Steps without a frame repeat the nearest
        one.
    views
        Views whose images are exported: any of ``left`` and ``right``.
    forces
        Whether the images are sensed again for the features ``force``, ``full`` and ``wrench``. A ``wrench``
        that was recorded is exported anyway.
    force_settings
        Their table ``force`` replaces that of the recording.
    progress
        Called with the steps done and the total.

    Returns
    -------
    list of Episode

    Raises
    ------
    ExportError
        If a recording cannot be used, or the folder exists.
    """
    timelines = _timelines(recordings, fps)
    total = sum(len(timeline.taken) for timeline in timelines)
    sources = [
        Source(
            path,
            partial(frames_with_forces, path, force_settings) if forces else partial(recorded_frames, path),
        )
        for path in recordings
    ]

    def steps(done: int) -> None:
        progress(done, total)

    return write_lerobot(zip(sources, timelines, strict=True), folder, task=task, views=views, progress=steps)


def write_lerobot(
    sources: Iterable[tuple[Source, Timeline]],
    folder: Path,
    *,
    task: str,
    views: Sequence[str] = ("left",),
    progress: Callable[[int], None] = lambda done: None,
) -> list[Episode]:
    """Write episodes from any source of frames as a dataset; the sources may be made on the way.

    Parameters
    ----------
    sources
        Frames and steps of each episode.
    folder, task, views
        As in `export_lerobot`.
    progress
        Called with the steps done.

    Raises
    ------
    ExportError
        If a source cannot be used, there is none, or the folder exists.
    """
    episodes: list[Episode] = []
    start = 0
    with new_folder(folder) as unfinished:
        for number, (source, timeline) in enumerate(sources):
            features = episodes[0].features if episodes else None
            writer = EpisodeWriter(source, timeline, number, start, features, tuple(views))
            path = unfinished / _path("data", number)
            episodes.append(writer.write(path, lambda done, before=start: progress(before + done)))  # type: ignore[misc]
            start += episodes[-1].length
        if not episodes:
            raise ExportError("there is no episode to write; valid is one or more")
        _write_meta(unfinished, episodes, task)
    return episodes


def _timelines(recordings: Sequence[Path], fps: int | None) -> list[Timeline]:
    out: list[Timeline] = []
    for recording in recordings:
        times_ns = frame_times_ns(recording)
        if not times_ns:
            raise ExportError(f"{recording} has no frame with markers")
        out.append(Timeline.of(times_ns, fps))
        fps = out[0].fps
    return out


def _path(folder: str, file: int) -> str:
    chunk_index, file_index = divmod(file, _FILES_A_CHUNK)
    return _PATH.format(folder=folder, chunk_index=chunk_index, file_index=file_index)


def _write_meta(folder: Path, episodes: list[Episode], task: str) -> None:
    meta = folder / "meta"
    meta.mkdir(parents=True)
    _write_json(meta / "info.json", _info(episodes))
    names = episodes[0].statistics
    stats = {name: pooled([episode.statistics[name] for episode in episodes]) for name in names}
    plain = {name: {key: value.tolist() for key, value in each.items()} for name, each in stats.items()}
    _write_json(meta / "stats.json", plain)
    _write_tasks(meta / "tasks.parquet", task)
    path = folder / _path("meta/episodes", 0)
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist([_episode_row(episode, task) for episode in episodes]), path)


def _info(episodes: list[Episode]) -> dict[str, Any]:
    data_path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    return {
        "codebase_version": FORMAT,
        "robot_type": None,
        "total_episodes": len(episodes),
        "total_frames": sum(episode.length for episode in episodes),
        "total_tasks": 1,
        "chunks_size": _FILES_A_CHUNK,
        "data_files_size_in_mb": _DATA_FILE_MB,
        "video_files_size_in_mb": _VIDEO_FILE_MB,
        "fps": episodes[0].timeline.fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": data_path,
        "video_path": None,
        "features": episodes[0].features,
    }


def _episode_row(episode: Episode, task: str) -> dict[str, Any]:
    chunk, file = divmod(episode.number, _FILES_A_CHUNK)
    row: dict[str, Any] = {
        "episode_index": episode.number,
        "tasks": [task],
        "length": episode.length,
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": episode.start,
        "dataset_to_index": episode.start + episode.length,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }
    for name, values in episode.statistics.items():
        row |= {f"stats/{name}/{key}": value.tolist() for key, value in values.items()}
    return row


def _write_tasks(path: Path, task: str) -> None:
    """Write the tasks; LeRobot reads them with pandas, whose metadata marks the task as the index column."""
    index = "__index_level_0__"
    texts = {"metadata": None, "numpy_type": "object", "pandas_type": "unicode"}
    notes = {
        "index_columns": [index],
        "column_indexes": [{"name": None, "field_name": None, **texts}],
        "columns": [
            {
                "name": "task_index",
                "field_name": "task_index",
                "metadata": None,
                "numpy_type": "int64",
                "pandas_type": "int64",
            },
            {"name": None, "field_name": index, **texts},
        ],
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), index: pa.array([task], pa.string())})
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(notes)}), path)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=4, ensure_ascii=False) + "\n", encoding="utf-8")
