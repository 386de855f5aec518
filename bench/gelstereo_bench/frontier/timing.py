"""Interleaved timing of methods, and instruction counts if callgrind is available."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelstereo import Error

__all__ = ["InstructionCounter", "Stopwatch", "Times", "time_side_by_side"]


@dataclass(frozen=True)
class Times:
    """Wall-clock times of one call on one thread."""

    median_ms: float
    p99_ms: float

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Times:
        """Summarise times; NaN without times."""
        if not nanoseconds:
            return cls(float("nan"), float("nan"))
        return cls(float(np.median(nanoseconds)) * 1e-6, float(np.percentile(nanoseconds, 99)) * 1e-6)


def time_side_by_side(
    calls: Mapping[str, Callable[[int], object]], rounds: int, running: int = 1
) -> dict[str, Times]:
    """Call each method once per round, so that disturbances of the machine affect all methods equally.

    Each call receives its number; a round may have several consecutive calls. Two warm-up rounds precede the
    measurement.
    """
    taken: dict[str, list[int]] = {name: [] for name in calls}
    for turn in range(-2, rounds):
        for name, call in calls.items():
            for again in range(running):
                begin = time.perf_counter_ns()
                call(max(turn, 0) * running + again)
                if turn >= 0:
                    taken[name].append(time.perf_counter_ns() - begin)
    return {name: Times.of(ns) for name, ns in taken.items()}


def _built(source: Path | None, example: str) -> Path | None:
    """One of the core's example programs, built if sources and cargo are available."""
    if source is None or not (source / "crates").is_dir() or shutil.which("cargo") is None:
        return None
    build = ["cargo", "build", "--release", "--quiet", "--package", "gelstereo-core"]
    build += ["--features", "serde", "--example", example]
    if subprocess.run(build, cwd=source, check=False).returncode != 0:
        return None
    return Path(os.environ.get("CARGO_TARGET_DIR", source / "target")) / "release" / "examples" / example


class InstructionCounter:
    """Counts instructions of single stages with callgrind on the core's example ``rung``.

    It needs the sources, cargo and valgrind; otherwise counts are `None`.
    """

    def __init__(self, source: Path | None) -> None:
        self._program = None if shutil.which("valgrind") is None else _built(source, "rung")

    @property
    def present(self) -> bool:
        """Whether instructions can be counted."""
        return self._program is not None

    def count(self, stage: str, files: Sequence[Path]) -> int | None:
        """Count the instructions for the last input; `None` on failure."""
        finished = self._run(stage, files, "--callgrind-out-file=/dev/null")
        found = re.search(r"Collected : (\d+)", finished.stderr) if finished else None
        return int(found[1]) if found else None

    def count_each(self, stage: str, files: Sequence[Path]) -> list[int]:
        """Count the instructions for every input of the stage, in order; empty on failure."""
        with tempfile.TemporaryDirectory() as folder:
            out = f"--callgrind-out-file={folder}/count"
            if self._run(stage, files, out, "--dump-after=rung::measured*") is None:
                return []
            parts = sorted(Path(folder).glob("count.*"), key=lambda part: int(part.suffix[1:]))
            found = [re.search(r"^totals: (\d+)", part.read_text(), re.MULTILINE) for part in parts]
        return [int(count[1]) for count in found if count]

    def workload(self, params: Path, image: Path) -> dict[str, int]:
        """What an image shows of the work of later ones, by name; empty on failure."""
        if self._program is None:
            return {}
        command = [str(self._program), "workload", str(params), str(image)]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = finished.stdout.splitlines() if finished.returncode == 0 else []
        return {name: int(value) for name, value in map(str.split, lines)}

    def _run(
        self, stage: str, files: Sequence[Path], *options: str
    ) -> subprocess.CompletedProcess[str] | None:
        """Run a stage under callgrind; `None` on failure."""
        if self._program is None:
            return None
        command = ["valgrind", "--tool=callgrind", "--collect-atstart=no", "--toggle-collect=*measured*"]
        command += [*options, str(self._program), stage, *map(str, files)]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        return finished if finished.returncode == 0 else None


class Stopwatch:
    """Times the stages of one pipeline call by call with the core's example ``time``, without the binding's
    cost.

    The program runs on request, so several of them and other code can alternate on one processor.
    """

    def __init__(self, program: Path, files: Sequence[Path]) -> None:
        """``files``: settings, rig, and images of left and right views in turn.

        Raises
        ------
        Error
            The pipeline refuses a frame.
        """
        self._process = subprocess.Popen(
            [str(program), *map(str, files)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        words = self._read().split()
        if len(words) != 2 or words[0] != "memory":
            told = self._process.communicate()[1].strip()
            raise Error(f"the pipeline cannot be timed: {told or words}")
        #: Peak memory of pipeline, scratch and results.
        self.memory_bytes = int(words[1])

    @staticmethod
    def program(source: Path | None) -> Path | None:
        """Build the program; `None` without sources or cargo."""
        return _built(source, "time")

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def times_ns(self, what: str, calls: int) -> list[int]:
        """Times of several calls; empty if the pipeline reports an error."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{what} {calls}\n")
        self._process.stdin.flush()
        answer = self._read()
        return [] if answer.startswith("refused") else [int(word) for word in answer.split()]

    def __enter__(self) -> Stopwatch:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
