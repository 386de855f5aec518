"""Rendering of many random scenes on several processes; the bits do not depend on how many."""

from __future__ import annotations

import functools
import math
import pickle
import time
from collections.abc import Callable, Iterator, Mapping
from os import PathLike
from typing import Any, TypeAlias

from gelstereo._native import Error, Scene, Simulator
from gelstereo.datasets.sample import Sample, sample_seed, simulate_sample
from gelstereo.extras import needs
from gelstereo.randomization import Distribution

#: Called with the numbers of finished and of all samples.
Progress: TypeAlias = Callable[[int, int], None]

#: Samples of a task: some tenths of a second of work, so that starting it costs little.
_SAMPLES_A_TASK = 16

#: What starting processes costs: on two busy processors, the first results came after 1 to 1.6 s, in which
#: each process worked for 0.16 s. Sets that would save less are rendered in this process.
_START_S = 1.5


class DatasetError(Error):
    """A data set cannot be rendered or written."""


def render(
    simulator: Simulator | Scene,
    distribution: Distribution | Mapping[str, Any] | str | PathLike[str],
    count: int,
    *,
    seed: int = 0,
    workers: int = 1,
    images: bool = True,
    progress: Progress | None = None,
) -> Iterator[Sample]:
    """Simulate random variations of a scene, one by one in the order of their numbers.

    A sample depends on scene, distribution, seed and its number alone: the samples are the same for any
    number of workers, and the first ones are the same for any count. Ctrl-C, or leaving the loop, stops all
    workers.

    Parameters
    ----------
    simulator
        The scene that varies.
    distribution
        What varies: a `Distribution`, its plain data, or a TOML file of it. Its lowest and highest values are
        checked before the first sample.
    count
        Number of samples.
    seed
        Seed of the data set, 0 to 2^63 - 1.
    workers
        Processes on this machine, at most: small sets are rendered in this one, as processes take over a
        second to start. More than one needs joblib (``pip install gelstereo[batch]``).
    images
        Whether images are rendered. Without them a sample takes a fraction of the time.
    progress
        Called with the numbers of finished and of all samples.

    Returns
    -------
    iterator of Sample

    Raises
    ------
    DistributionError
        If the distribution is not valid, or draws a scene that is not.
    DatasetError
        If `count` or `workers` is not valid.
    MissingExtra
        If joblib is missing.

    Examples
    --------
    >>> import gelstereo as gs
    >>> scene = gs.Scene().replace(indenter={"kind": "sphere", "radius_mm": 4.0}, effects={"shoulder": {}})
    >>> varied = {"press": {"depth_mm": {"uniform": [0.5, 1.5]}}}
    >>> [sample.frames["points_mm"].shape for sample in render(scene, varied, 2, images=False)]
    [(1, 625, 3), (1, 625, 3)]
    """
    if count < 1:
        raise DatasetError(f"the number of samples is {count}; valid is 1 or more")
    if workers < 1:
        raise DatasetError(f"{workers} workers cannot render; valid is 1 or more")
    if isinstance(distribution, (str, PathLike)):
        distribution = Distribution.load(distribution)
    elif not isinstance(distribution, Distribution):
        distribution = Distribution(distribution)
    if isinstance(simulator, Scene):
        simulator = Simulator(simulator)
    distribution.check(simulator)
    sample_seed(seed, 0)
    task = _Task(simulator, distribution, seed, images)
    return _told(task.samples(count, workers), count, progress)


class _Task:
    """Samples by their numbers; a process that has one renders any of them."""

    def __init__(self, simulator: Simulator, distribution: Distribution, seed: int, images: bool) -> None:
        self._simulator = simulator
        self._distribution = distribution
        self._seed = seed
        self._images = images

    def sample(self, index: int) -> Sample:
        seed = sample_seed(self._seed, index)
        return simulate_sample(self._simulator, self._distribution, seed, index=index, images=self._images)

    def samples(self, count: int, workers: int) -> Iterator[Sample]:
        if workers == 1:
            return map(self.sample, range(count))
        with needs(f"rendering with {workers} workers"):
            import joblib  # noqa: F401
        return self._fastest(count, workers)

    def _fastest(self, count: int, workers: int) -> Iterator[Sample]:
        """On processes, if they save more time than they take to start."""
        first = range(min(2, count))
        took_s = math.inf
        for index in first:
            start_s = time.perf_counter()
            sample = self.sample(index)
            took_s = min(took_s, time.perf_counter() - start_s)
            yield sample
        saved_s = took_s * (count - len(first)) * (1.0 - 1.0 / workers)
        rest = range(len(first), count)
        yield from map(self.sample, rest) if saved_s < _START_S else self._on_processes(rest, workers)

    def _on_processes(self, numbers: range, workers: int) -> Iterator[Sample]:
        import joblib

        size = min(_SAMPLES_A_TASK, math.ceil(len(numbers) / workers))
        starts = numbers[::size]
        # Results wait for the consumer in this process: at most two tasks for each worker.
        parallel = joblib.Parallel(
            n_jobs=workers, batch_size=1, pre_dispatch=2 * workers, return_as="generator"
        )
        job, pickled = joblib.delayed(_run), pickle.dumps(self)
        for samples in parallel(job(pickled, start, min(start + size, numbers.stop)) for start in starts):
            yield from samples


@functools.lru_cache(maxsize=1)
def _task(pickled: bytes) -> _Task:
    """The task of this process: its simulator is built once."""
    task: _Task = pickle.loads(pickled)
    return task


def _run(pickled: bytes, start: int, stop: int) -> list[Sample]:
    return [_task(pickled).sample(index) for index in range(start, stop)]


def _told(samples: Iterator[Sample], count: int, progress: Progress | None) -> Iterator[Sample]:
    for done, sample in enumerate(samples):
        if progress is not None:
            progress(done, count)
        yield sample
    if progress is not None:
        progress(count, count)
