"""Batches of independent trials, on this machine or on a cluster; results do not depend on the workers.

A trial is a pure function of its configuration and its seed, and its record is plain JSON. Records are
returned in the order of the trials, whatever the number and speed of workers.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from gelstereo import Error
from gelstereo.extras import said
from gelstereo_bench.experiments.store import Record, Store
from gelstereo_bench.reports.provenance import build_digest

__all__ = ["BatchError", "Configuration", "Progress", "Run", "Trial", "keyed_seed", "run_batch"]

Configuration: TypeAlias = Mapping[str, Any]
#: A trial: maps configuration and seed to a record. It must be a module-level function, so that other
#: processes can import it.
Run: TypeAlias = Callable[[Configuration, int], Record]
#: Called with the numbers of finished and of all trials.
Progress: TypeAlias = Callable[[int, int], None]

#: Below this duration, the cost of sending dominates a task.
TASK_S = 0.5

_CLUSTER_TIMEOUT_S = 30.0


class BatchError(Error):
    """A batch cannot be run."""


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes
    ----------
    configuration
        Settings of the trial, JSON-compatible.
    seed
        Seed of all random numbers in the trial.
    """

    configuration: Configuration
    seed: int

    @property
    def digest(self) -> str:
        """SHA-256 of configuration and seed: the key of the trial's record."""
        text = json.dumps([self.configuration, self.seed], sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def keyed_seed(seed: int, *key: object) -> int:
    """Seed of one trial: 48 bits of a hash of the batch's seed and the trial's name.

    Examples
    --------
    >>> keyed_seed(1, "boards", 0.4, 0) == keyed_seed(1, "boards", 0.4, 1)
    False
    """
    text = json.dumps([seed, *key])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")


def run_batch(
    run: Run,
    trials: Sequence[Trial],
    *,
    workers: int = 1,
    scheduler_address: str | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
) -> list[Record]:
    """Run trials, and return their records in the order of the trials.

    Parameters
    ----------
    run
        Called once for every trial that is not in the store.
    trials
        Trials; duplicates of configuration and seed are run once.
    workers
        Processes on this machine. More than one needs joblib (``pip install ./bench[batch]``).
    scheduler_address
        Address of a dask scheduler, whose workers then run the trials (``pip install ./bench[batch]``).
    store
        Stores every finished trial, and supplies those of earlier runs.
    progress
        Called with the numbers of finished and of all trials.

    Raises
    ------
    BatchError
        A library is missing, the cluster cannot be used, or a record is not JSON-compatible.
    """
    keys = [trial.digest for trial in trials]
    known: dict[str, Record] = {} if store is None else dict(store.records)
    missing = [index for key, index in _first_of(keys).items() if key not in known]
    total = len(_first_of(keys))
    done = total - len(missing)
    tell = progress or _silent
    tell(done, total)
    chunks = _Chunks([(index, trials[index]) for index in missing], max(workers, 1))
    for result in _results(run, chunks, workers, scheduler_address):
        for index, line in result.lines:
            record = json.loads(line)
            known[keys[index]] = record
            if store is not None:
                store.add(keys[index], record)
        chunks.learn(result.seconds / len(result.lines))
        done += len(result.lines)
        tell(done, total)
    return [known[key] for key in keys]


def _silent(done: int, total: int) -> None:
    """Ignore progress."""


def _first_of(keys: Sequence[str]) -> dict[str, int]:
    """Unique keys, each with its first index."""
    found: dict[str, int] = {}
    for index, key in enumerate(keys):
        found.setdefault(key, index)
    return found


# Tasks

_Chunk: TypeAlias = list[tuple[int, Trial]]


@dataclass(frozen=True)
class _Result:
    """Result of a task: records as JSON by the index of their trial, and their duration in seconds."""

    lines: list[tuple[int, str]]
    seconds: float


class _Chunks:
    """Groups trials into tasks of about half a second: single trials at first, more once their duration is
    known.
    """

    def __init__(self, trials: _Chunk, workers: int) -> None:
        self._trials = trials
        self._next = 0
        self._workers = workers
        self._trial_s = math.inf

    def learn(self, trial_s: float) -> None:
        """Record the duration of a trial; the minimum is used, because the first trial also loads modules."""
        self._trial_s = min(self._trial_s, max(trial_s, 1e-6))

    def share_among(self, workers: int) -> None:
        """Set the number of workers."""
        self._workers = max(workers, 1)

    def __iter__(self) -> Iterator[_Chunk]:
        while self._next < len(self._trials):
            # The last trials are divided among all workers.
            fair = math.ceil((len(self._trials) - self._next) / self._workers)
            size = min(math.ceil(TASK_S / self._trial_s), fair) if self._trial_s < math.inf else 1
            start, self._next = self._next, self._next + max(size, 1)
            yield self._trials[start : self._next]


def _run_chunk(run: Run, chunk: _Chunk, build: str) -> _Result:
    """Run some trials in a worker."""
    if build_digest() != build:
        raise BatchError(
            f"a worker has another build of gelstereo ({build_digest()[:12]}) than this program "
            f"({build[:12]}); install the same on all machines, so that results do not depend on who ran them"
        )
    start = time.perf_counter()
    lines = []
    for index, trial in chunk:
        try:
            record = run(trial.configuration, trial.seed)
        except Error as error:
            raise BatchError(
                f"the trial {dict(trial.configuration)} with seed {trial.seed} failed: {error}"
            ) from error
        lines.append((index, _as_json(record, trial)))
    return _Result(lines, time.perf_counter() - start)


def _as_json(record: Record, trial: Trial) -> str:
    try:
        return json.dumps(record, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BatchError(
            f"the record of {dict(trial.configuration)} is no JSON ({error}); valid are finite numbers, "
            "texts, null, lists and dictionaries of them"
        ) from error


# Executors


def _results(run: Run, chunks: _Chunks, workers: int, scheduler_address: str | None) -> Iterator[_Result]:
    if workers < 1:
        raise BatchError(f"{workers} workers cannot run a trial; valid is 1 or more")
    if scheduler_address is not None:
        return _on_cluster(run, chunks, scheduler_address)
    if workers > 1:
        return _on_processes(run, chunks, workers)
    return (_run_chunk(run, chunk, build_digest()) for chunk in chunks)


def _on_processes(run: Run, chunks: _Chunks, workers: int) -> Iterator[_Result]:
    try:
        import joblib
    except ModuleNotFoundError as error:
        raise BatchError(f"{said(f'a run with {workers} workers', error)}, or use 1 worker") from error
    build = build_digest()
    parallel = joblib.Parallel(
        n_jobs=workers, batch_size=1, pre_dispatch=2 * workers, return_as="generator_unordered"
    )
    yield from parallel(joblib.delayed(_run_chunk)(run, chunk, build) for chunk in chunks)


def _check_address(address: str) -> None:
    """Check the form of an address, because dask takes long to reject an invalid one."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    try:
        usable = parts.scheme == "inproc" or (bool(parts.hostname) and parts.port is not None)
    except ValueError:
        usable = False
    if not usable:
        raise BatchError(
            f"{address!r} is no scheduler's address; valid is one as the scheduler prints it, as "
            "tcp://10.0.0.2:8786"
        )


def _on_cluster(run: Run, chunks: _Chunks, address: str) -> Iterator[_Result]:
    try:
        from distributed import Client, KilledWorker, as_completed
    except ModuleNotFoundError as error:
        raise BatchError(said("a scheduler's address", error)) from error
    _check_address(address)
    try:
        client = Client(address, timeout=_CLUSTER_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise BatchError(f"no dask scheduler answers at {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_CLUSTER_TIMEOUT_S)
        except TimeoutError as error:
            raise BatchError(
                f"the scheduler at {address} has no workers; start some: dask worker {address}"
            ) from error
        try:
            yield from _tasks(client, as_completed(loop=client.loop), run, chunks)
        except (CancelledError, KilledWorker, OSError) as error:
            raise BatchError(f"the cluster at {address} gave trials up: {error}") from error


def _tasks(client: Any, running: Any, run: Run, chunks: _Chunks) -> Iterator[_Result]:
    """Results in order of completion; `running` is dask's ``as_completed``."""
    build, waiting = build_digest(), iter(chunks)
    while True:
        places = max(sum(client.nthreads().values()), 1)
        chunks.share_among(places)
        # Twice as many tasks as workers, so that no worker waits for this process.
        while running.count() < 2 * places and (chunk := next(waiting, None)) is not None:
            running.add(client.submit(_run_chunk, run, chunk, build, pure=False))
        if running.count() == 0:
            return
        yield next(running).result()
