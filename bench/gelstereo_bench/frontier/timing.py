"""Times side by side, and instruction counts where callgrind is present."""

from __future__ import annotations

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
        """Summarise times; not a number when there are none."""
        if not nanoseconds:
            return cls(float("nan"), float("nan"))
        return cls(float(np.median(nanoseconds)) * 1e-6, float(np.percentile(nanoseconds, 99)) * 1e-6)


def time_side_by_side(
    calls: Mapping[str, Callable[[int], object]], rounds: int, running: int = 1
) -> dict[str, Times]:
    """Call everything once per round, so that whatever disturbs the machine disturbs all alike.

    Each call gets its number; a round may be several calls running. Two rounds before the measurement warm up.
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
    """One of the core's example programs, built when sources and cargo are here."""
    if source is None or not (source / "crates").is_dir() or shutil.which("cargo") is None:
        return None
    build = ["cargo", "build", "--release", "--quiet", "--package", "gelstereo-core"]
    build += ["--features", "serde", "--example", example]
    if subprocess.run(build, cwd=source, check=False).returncode != 0:
        return None
    return source / "target" / "release" / "examples" / example


class InstructionCounter:
    """Counts instructions of single stages by callgrind on the core's example ``rung``.

    Present only beside the sources, with cargo and valgrind; otherwise counts are `None`.
    """

    def __init__(self, source: Path | None) -> None:
        self._program = None if shutil.which("valgrind") is None else _built(source, "rung")

    @property
    def present(self) -> bool:
        """Whether there is a way to count."""
        return self._program is not None

    def count(self, stage: str, files: Sequence[Path]) -> int | None:
        """Count the instructions of the last piece of input, or `None` when that fails."""
        finished = self._run(stage, files, "--callgrind-out-file=/dev/null")
        found = re.search(r"Collected : (\d+)", finished.stderr) if finished else None
        return int(found[1]) if found else None

    def count_each(self, stage: str, files: Sequence[Path]) -> list[int]:
        """Count the instructions of every piece of input that the stage measures, in order; empty when that fails."""
        with tempfile.TemporaryDirectory() as folder:
            out = f"--callgrind-out-file={folder}/count"
            if self._run(stage, files, out, "--dump-after=rung::measured*") is None:
                return []
            parts = sorted(Path(folder).glob("count.*"), key=lambda part: int(part.suffix[1:]))
            found = [re.search(r"^totals: (\d+)", part.read_text(), re.MULTILINE) for part in parts]
        return [int(count[1]) for count in found if count]

    def _run(
        self, stage: str, files: Sequence[Path], *options: str
    ) -> subprocess.CompletedProcess[str] | None:
        """Run a stage under callgrind; `None` when that fails."""
        if self._program is None:
            return None
        command = ["valgrind", "--tool=callgrind", "--collect-atstart=no", "--toggle-collect=*measured*"]
        command += [*options, str(self._program), stage, *map(str, files)]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        return finished if finished.returncode == 0 else None


class Stopwatch:
    """Times stages of one pipeline call by call, without the binding's cost, by the core's example ``time``.

    The program waits for its turn, so that several, and other code, can take turns on one processor.
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
        #: The most memory that pipeline, scratch and results held at one time.
        self.memory_bytes = int(words[1])

    @staticmethod
    def program(source: Path | None) -> Path | None:
        """Build the program; `None` without sources or cargo."""
        return _built(source, "time")

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def times_ns(self, what: str, calls: int) -> list[int]:
        """Times of so many calls; empty when the pipeline refuses."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{what} {calls}\n")
        self._process.stdin.flush()
        answer = self._read()
        return [] if answer.startswith("refused") else [int(word) for word in answer.split()]

    def __enter__(self) -> Stopwatch:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
