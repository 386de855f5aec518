"""One recording as one episode of a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo.export.features import (
    COUNTED,
    IMAGES,
    Features,
    Values,
    features_of,
    row_of,
    schema_of,
    values_of,
)
from gelstereo.export.recording import RecordedFrame
from gelstereo.export.statistics import Statistics, image_statistics, statistics
from gelstereo.export.timeline import Timeline
from gelstereo.extras import needs

with needs(__name__):
    import pyarrow as pa
    import pyarrow.parquet as pq

_ROWS_AT_ONCE = 64
#: Largest number of frames for image statistics; every fourth pixel along each axis is used, similar to
#: LeRobot.
_SAMPLED_IMAGES, _SAMPLED_PIXELS = 100, 4


@dataclass(frozen=True)
class Source:
    """Where the frames of an episode come from.

    Attributes
    ----------
    name : Path or str
        For messages.
    frames : callable
        Iterates over all frames, in the order of their times.
    rest_mm : (N, 3) float64, optional
        Markers without contact. Default: those of the first frame.
    """

    name: Path | str
    frames: Callable[[], Iterator[RecordedFrame]]
    rest_mm: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Episode:
    """A recording as an episode of a dataset.

    Attributes
    ----------
    recording : Path or str
    number, start : int
        Number of the episode, and index of its first frame in the dataset.
    timeline : Timeline
        The recorded frame of each step.
    features : dict
    statistics : dict
        Statistics of each feature.
    """

    recording: Path | str
    number: int
    start: int
    timeline: Timeline
    features: Features
    statistics: dict[str, Statistics]

    @property
    def length(self) -> int:
        """Frames of the episode."""
        return len(self.timeline.taken)


class EpisodeWriter:
    """Writes one episode's data file.

    Parameters
    ----------
    source, timeline
        The frames and their steps.
    number, start
        As in `Episode`.
    features
        Features of the dataset, or None in its first episode.
    views
        Views whose images are exported.
    """

    def __init__(
        self,
        source: Source,
        timeline: Timeline,
        number: int,
        start: int,
        features: Features | None,
        views: tuple[str, ...],
    ) -> None:
        self._source = source
        self._timeline = timeline
        self._number, self._start = number, start
        self._features = features
        self._views = views
        self._kept: dict[str, list[Any]] = {}
        steps = len(timeline.taken)
        self._sampled = set(
            np.linspace(0, steps - 1, min(steps, _SAMPLED_IMAGES)).round().astype(int).tolist()
        )

    def write(self, path: Path, progress: Callable[[int], None]) -> Episode:
        """Write the file; `progress` is called with the number of steps done."""
        frames = self._frames()
        repeats, first = next(frames)
        features = self._features or features_of(self._source.name, first, self._views)
        rest_mm = first.points_mm if self._source.rest_mm is None else self._source.rest_mm
        schema = schema_of(features)
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(path, schema) as writer:
            rows: list[dict[str, Any]] = []
            step = 0
            for count, frame in chain([(repeats, first)], frames):
                values = values_of(self._source.name, frame, rest_mm, features)
                row = row_of(values)
                for _ in range(count):
                    self._keep(values, step)
                    rows.append(row | self._counted(step))
                    step += 1
                    if len(rows) >= _ROWS_AT_ONCE:
                        writer.write_table(pa.Table.from_pylist(rows, schema=schema))
                        rows = []
                        progress(step)
            if rows:
                writer.write_table(pa.Table.from_pylist(rows, schema=schema))
        progress(step)
        return Episode(
            self._source.name, self._number, self._start, self._timeline, features, self._statistics()
        )

    def _frames(self) -> Iterator[tuple[int, RecordedFrame]]:
        """Frames used by at least one step, with the number of steps."""
        repeats = Counter(self._timeline.taken)
        for index, frame in enumerate(self._source.frames()):
            if repeats[index]:
                yield repeats[index], frame

    def _counted(self, step: int) -> dict[str, Any]:
        return {
            "timestamp": step / self._timeline.fps,
            "frame_index": step,
            "episode_index": self._number,
            "index": self._start + step,
            "task_index": 0,
        }

    def _keep(self, values: Values, step: int) -> None:
        """Keep the data for statistics: all displacements, and a sample of the images' pixels."""
        for name, value in values.items():
            if name.startswith(IMAGES):
                if step not in self._sampled:
                    continue
                value = value[::_SAMPLED_PIXELS, ::_SAMPLED_PIXELS]
            self._kept.setdefault(name, []).append(value)
        for name, number in self._counted(step).items():
            self._kept.setdefault(name, []).append(number)

    def _statistics(self) -> dict[str, Statistics]:
        out: dict[str, Statistics] = {}
        for name, values in self._kept.items():
            if name.startswith(IMAGES):
                out[name] = image_statistics(np.stack(values), len(values))
            elif name in COUNTED:
                out[name] = statistics(np.array(values, dtype=np.float64))
            else:
                out[name] = statistics(np.stack(values))
        return out
