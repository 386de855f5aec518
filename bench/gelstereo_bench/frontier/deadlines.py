"""How often deadlines are kept beside another busy process, and what is given up for them."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from gelstereo import MarkerState, Params, Pipeline, SimulatedFrame
from gelstereo_bench.frontier.scenes import VGA, sphere_press
from gelstereo_bench.frontier.table import Report, Table

__all__ = ["Kept", "deadline_table", "measure_deadlines"]

#: Deadlines that leave no choice, some, and all, ms.
_DEADLINES_MS = {"balanced": (1.0, 2.0, 3.0), "exact": (2.0, 5.0, 8.0)}
#: Frames in which the time of a unit of work is learned.
_WARM_UP = 2000
#: Pause after a frame over its time. A program waits for its camera; and of Linux's real-time class, one that
#: never waits is stopped for a twentieth of each second.
_PAUSE = 0.1


@dataclass(frozen=True)
class Kept:
    """Frames of one preset under one deadline."""

    preset: str
    deadline_ms: float
    frames: int
    late: int
    #: Frames by where and how the left view's markers were found.
    rungs: Mapping[str, int]
    held: int
    median_ms: float
    p999_ms: float
    #: Of the points along z, in the frames that were measured for it.
    depth_rms_um: float

    @property
    def late_share(self) -> float:
        """Share of frames that took longer than the deadline."""
        return self.late / self.frames


def _spin() -> None:
    if sys.platform == "linux":
        # Under `chrt`, the busy process would inherit the policy.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    while True:
        pass


@contextmanager
def _busy_process() -> Iterator[None]:
    """One other process that computes all the time."""
    process = multiprocessing.get_context("spawn").Process(target=_spin, daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def measure_deadlines(frames: int, report: Report) -> list[Kept]:
    """Follow a press, there and back, under each deadline, beside a busy process."""
    press = sphere_press()
    out = []
    with _busy_process():
        for preset, deadlines_ms in _DEADLINES_MS.items():
            for deadline_ms in deadlines_ms:
                report(f"deadlines: {preset}, {deadline_ms:g} ms")
                out.append(_follow(preset, deadline_ms, frames, press))
    return out


def _follow(preset: str, deadline_ms: float, frames: int, press: Sequence[SimulatedFrame]) -> Kept:
    pipeline = Pipeline(VGA.rig(), Params.preset(preset))
    way = [*range(len(press)), *range(len(press) - 2, 0, -1)]
    taken = np.empty(frames)
    held = 0
    rungs: Counter[str] = Counter()
    squared: list[float] = []
    for number in range(-_WARM_UP, frames):
        shown = press[way[(number + _WARM_UP) % len(way)]]
        begin = time.perf_counter_ns()
        found = pipeline.process(shown.left, shown.right, deadline_ms=deadline_ms)
        end = time.perf_counter_ns()
        time.sleep(1e-9 * _PAUSE * (end - begin))
        if number < 0:
            continue
        taken[number] = 1e-6 * (end - begin)
        rungs[f"{found.left.centre.replace('_', ' ')}, {found.left.searched}"] += 1
        held += "held" in (found.left.labels, found.right.labels)
        # A tenth of the frames: of every way the same share.
        if number % 10 == 0:
            seen = found.state == MarkerState.SEEN
            off_um = 1e3 * (found.points_mm[seen, 2] - shown.points_mm[seen, 2])
            squared.append(float((off_um**2).mean()))
    return Kept(
        preset,
        deadline_ms,
        frames,
        int((taken > deadline_ms).sum()),
        rungs,
        held,
        float(np.median(taken)),
        float(np.quantile(taken, 0.999)),
        float(np.sqrt(np.mean(squared))),
    )


def deadline_table(found: Sequence[Kept]) -> Table:
    """One row for each preset and deadline."""
    head = ["preset", "deadline ms", "late, %", "rungs", "held, %", "median ms", "99.9 % ms"]
    rows = [
        [
            kept.preset,
            f"{kept.deadline_ms:g}",
            f"{100.0 * kept.late_share:.3f}",
            "; ".join(f"{name} {100.0 * n / kept.frames:.1f} %" for name, n in kept.rungs.items()),
            f"{100.0 * kept.held / kept.frames:.3f}",
            f"{kept.median_ms:.2f}",
            f"{kept.p999_ms:.2f}",
            f"{kept.depth_rms_um:.1f}",
        ]
        for kept in found
    ]
    return Table("deadlines", [*head, "depth error um rms"], rows)
