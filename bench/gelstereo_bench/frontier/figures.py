"""Figures of docs/accuracy-vs-time.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gelstereo.extras import needs
from gelstereo_bench.frontier.scenes import FORMATS
from gelstereo_bench.frontier.sensing import Row
from gelstereo_bench.frontier.speed import Speed

with needs(__name__):
    import matplotlib

__all__ = ["draw_errors", "draw_growth"]

_AXES = {
    "detect": "centre error, px rms",
    "label": "wrong labels, %",
    "register": "pose error of successes, um rms",
    "whole": "depth error, um rms",
}


def draw_errors(path: Path, rows: Sequence[Row], bound_px: float | None = None) -> None:
    """Plot error over time, one panel per stage, with the bound on centres as a line."""
    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt
        from matplotlib.ticker import LogLocator, NullFormatter

    figure, axes = plt.subplots(2, 2, figsize=(14, 10), layout="constrained")
    for axis, (stage, label) in zip(axes.ravel(), _AXES.items(), strict=True):
        shown = [row for row in rows if row.stage == stage and np.isfinite(row.value)]
        for index, row in enumerate(shown):
            marker = "sDPX"[index % 4] if row.baseline else "o^v<>p"[index % 6]
            colour = "0.45" if row.baseline else f"C{index % 10}"
            axis.plot(row.times.median_ms, row.value, marker, color=colour, markersize=9, label=row.name)
        if stage == "detect" and bound_px is not None:
            axis.axhline(bound_px, color="k", linestyle="--", linewidth=1.0, label="Cramér-Rao bound")
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set(title=stage, xlabel="median time, ms", ylabel=label)
        top = max((row.value for row in shown), default=0.0) or 1.0
        axis.set_ylim(-0.03 * top, 1.1 * top)
        low, high = axis.get_xlim()
        axis.set_xlim(low / 1.3, high * 1.3)
        axis.grid(alpha=0.3, which="both")
        # Legend below the panel, because methods may lie anywhere in it.
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3)
    figure.suptitle("accuracy and time, simulated; lower left is better, grey is OpenCV and SciPy")
    figure.savefig(path, dpi=100)
    plt.close(figure)


def draw_growth(path: Path, speeds: Sequence[Speed]) -> None:
    """Plot the time of a tracked frame over pixels and over markers; a straight line indicates
    linear growth.
    """
    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(14, 5.5), layout="constrained", sharey=True)
    methods = list(dict.fromkeys(speed.method for speed in speeds))
    middle = FORMATS[1].name
    for index, method in enumerate(methods):
        known = [s for s in speeds if s.method == method and np.isfinite(s.track_ms)]
        baseline = "baseline" in method
        style = {"color": "0.45" if baseline else f"C{index}", "marker": "s" if baseline else "o"}
        coarse = [s for s in known if s.markers == speeds[0].markers]
        fine = [s for s in known if s.size.name == middle]
        axes[0].plot([s.size.megapixels for s in coarse], [s.track_ms for s in coarse], label=method, **style)
        axes[1].plot([s.markers**2 for s in fine], [s.track_ms for s in fine], label=method, **style)
    markers = speeds[0].markers
    axes[0].set(
        xlabel="pixels of both views, millions", title=f"{markers}x{markers} markers", ylabel="median, ms"
    )
    axes[1].set(xlabel="markers", title=middle)
    for axis in axes:
        axis.set_ylim(bottom=0.0)
        axis.set_xlim(left=0.0)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=9)
    figure.suptitle("time of a stereo frame, tracking, one thread")
    figure.savefig(path, dpi=100)
    plt.close(figure)
