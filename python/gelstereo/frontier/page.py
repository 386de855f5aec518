"""The page docs/accuracy-vs-time.md: tables between markers, and the figure beside them."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np

from gelstereo.frontier.rungs import rungs_of
from gelstereo.frontier.scenes import CONDITIONS
from gelstereo.frontier.sensing import Row
from gelstereo.reports.markdown import replace_between, table

__all__ = ["draw", "write_page"]

_AXES = {
    "detect": "centre error, px rms",
    "label": "wrong labels, %",
    "register": "pose error of successes, um rms",
    "whole": "depth error, um rms",
}


def write_page(page: Path, rows: Sequence[Row], boards: Sequence[Sequence[str]], rounds: int) -> None:
    """Fill the page's tables; a page that does not exist yet is begun."""
    if not page.exists():
        page.write_text(_blank(), encoding="utf-8")
    processor = _processor()
    replace_between(
        page,
        "conditions",
        f"All figures: {CONDITIONS}. Times: one thread, {processor}, {rounds} rounds (registration a quarter) in "
        f"which all methods take turns; {_load()}.",
    )
    head = ["method", "error", "median ms", "p99 ms", "10^6 instructions", "baseline's time over this"]
    for stage in _AXES:
        lines = [_line(row) for row in rows if row.stage == stage]
        replace_between(page, stage, table(head, lines))
    head = ["protrusion mm", *(rung.name for rung in rungs_of("whole")), "OpenCV pipeline (baseline)"]
    replace_between(page, "boards", table(head, boards))


def _blank() -> str:
    """A page with room for every table."""
    places = [f"<!-- begin {name} -->\n<!-- end {name} -->\n" for name in ("conditions", *_AXES, "boards")]
    return "\n".join(["# Accuracy versus time\n", *places])


def _line(row: Row) -> list[str]:
    return [
        row.name,
        row.error,
        f"{row.times.median_ms:.2f}",
        f"{row.times.p99_ms:.2f}",
        "-" if row.instructions is None else f"{row.instructions * 1e-6:.2f}",
        f"{row.speed:.1f}",
    ]


def _processor() -> str:
    """Name the processor."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _load() -> str:
    """Say how busy the machine was."""
    try:
        load = os.getloadavg()[1]
    except OSError:
        return "the machine's load is unknown"
    return (
        f"{load:.1f} programs on {os.cpu_count()} processors meanwhile, which shows in the 99th percentiles"
    )


def draw(path: Path, rows: Sequence[Row]) -> None:
    """Draw error over time, one panel per stage."""
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(13, 8.5), layout="constrained")
    for axis, (stage, label) in zip(axes.ravel(), _AXES.items(), strict=True):
        shown = [row for row in rows if row.stage == stage and np.isfinite(row.value)]
        for index, row in enumerate(shown):
            marker = "sDPX"[index % 4] if row.baseline else "o^v<>p"[index % 6]
            axis.plot(row.times.median_ms, row.value, marker, color=f"C{index}", markersize=9, label=row.name)
        axis.set_xscale("log")
        axis.set(title=stage, xlabel="median time, ms", ylabel=label)
        axis.set_ylim(0.0, 1.5 * max(row.value for row in shown) + 1e-9)  # room for the legend
        low, high = axis.get_xlim()
        axis.set_xlim(low / 1.3, high * 1.3)
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize=8, loc="upper center", ncols=2)
    figure.suptitle("accuracy and time, simulated; lower left is better")
    figure.savefig(path, dpi=110)
    plt.close(figure)
