"""Times side by side, and instruction counts where callgrind is present."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["InstructionCounter", "Times", "time_side_by_side"]


@dataclass(frozen=True)
class Times:
    """Wall-clock times of one call on one thread."""

    median_ms: float
    p99_ms: float


def time_side_by_side(calls: Mapping[str, Callable[[int], object]], rounds: int) -> dict[str, Times]:
    """Call everything once per round, so that whatever disturbs the machine disturbs all alike.

    Each call gets the round's number. Two rounds before the measurement warm up.
    """
    taken: dict[str, list[int]] = {name: [] for name in calls}
    for turn in range(-2, rounds):
        for name, call in calls.items():
            begin = time.perf_counter_ns()
            call(max(turn, 0))
            if turn >= 0:
                taken[name].append(time.perf_counter_ns() - begin)
    return {
        name: Times(float(np.median(ns)) * 1e-6, float(np.percentile(ns, 99)) * 1e-6)
        for name, ns in taken.items()
    }


class InstructionCounter:
    """Counts instructions of single stages by callgrind on the core's example ``rung``.

    Present only beside the sources, with cargo and valgrind; otherwise counts are `None`.
    """

    def __init__(self, source: Path | None) -> None:
        self._program: Path | None = None
        if source is None or not (source / "crates").is_dir():
            return
        if shutil.which("valgrind") is None or shutil.which("cargo") is None:
            return
        build = ["cargo", "build", "--release", "--quiet", "--package", "gelstereo-core"]
        build += ["--features", "serde", "--example", "rung"]
        if subprocess.run(build, cwd=source, check=False).returncode == 0:
            self._program = source / "target" / "release" / "examples" / "rung"

    @property
    def present(self) -> bool:
        """Whether there is a way to count."""
        return self._program is not None

    def count(self, stage: str, files: Sequence[Path]) -> int | None:
        """Count the instructions of the last piece of input, or `None` when that fails."""
        if self._program is None:
            return None
        command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", "--collect-atstart=no"]
        command += ["--toggle-collect=*measured*", str(self._program), stage, *map(str, files)]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        found = re.search(r"Collected : (\d+)", finished.stderr)
        return int(found[1]) if finished.returncode == 0 and found else None
