"""The picture of the price of accuracy: errors and success over time, with the front."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelstereo.extras import needs
from gelstereo_bench.frontier.pipeline.cases import Origin
from gelstereo_bench.frontier.pipeline.front import is_on_front
from gelstereo_bench.frontier.pipeline.labels import label_corners
from gelstereo_bench.frontier.pipeline.sensors import Family
from gelstereo_bench.frontier.pipeline.summary import Point

with needs(__name__):
    import matplotlib

__all__ = ["draw_front", "front_of"]

#: One colour and marker for each family; colours of Okabe and Ito, which the colour-blind can tell apart.
_STYLES: Mapping[Family, tuple[str, str, str]] = {
    "soft threshold": ("#0072B2", "o", "gelstereo, centres by soft threshold"),
    "fit": ("#009E73", "^", "gelstereo, centres by fit"),
    "fine fit": ("#D55E00", "v", "gelstereo, centres by fine fit"),
    "paper": ("#CC79A7", "D", "preset paper: the method of Cui et al."),
    "peer": ("0.5", "s", "other libraries"),
}
#: Points of one family that nothing names.
_FAINT = {"markersize": 3.5, "alpha": 0.35, "linestyle": "none", "zorder": 2}


def front_of(points: Sequence[Point]) -> list[bool]:
    """Whether each method is on the front of error and time; only methods that work in every scene can be."""
    errors = [point.error.value if point.is_complete else np.inf for point in points]
    return [bool(flag) for flag in is_on_front([point.ms for point in points], errors)]


def draw_front(
    path: Path, depth: Mapping[Origin, Sequence[Point]], poses: Mapping[Origin, Sequence[Point]]
) -> None:
    """Plot depth error, pose error and success over time; one row for each kind of images.

    Parameters
    ----------
    path
        PNG file that is written.
    depth, poses
        Points by kind of images.
    """
    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    figure, grid = plt.subplots(len(depth), 3, figsize=(19, 7.2 * len(depth)), squeeze=False, dpi=75)
    figure.subplots_adjust(left=0.05, right=0.99, top=0.93, bottom=0.075, wspace=0.15, hspace=0.22)
    for axes, (origin, points) in zip(grid, depth.items(), strict=True):
        _panel(axes[0], points, f"depth error, {origin} images", "depth error of a marker, um rms", _depth)
        located = poses[origin]
        _panel(axes[1], located, f"pose error, {origin} images", "pose error, median, um", _pose)
        _panel(axes[2], located, f"success, {origin} images", "poses with an error above 150 um, %", _failed)
    _legend(figure)
    figure.suptitle("The price of accuracy: lower left is better; the line is the front", fontsize=15)
    figure.savefig(path, dpi="figure")
    plt.close(figure)


#: Value of a point with the ends of its interval.
_Values = Callable[[Point], tuple[float, float, float]]


def _depth(point: Point) -> tuple[float, float, float]:
    return point.error.value, point.error.low, point.error.high


def _pose(point: Point) -> tuple[float, float, float]:
    return 1e3 * point.error.value, 1e3 * point.error.low, 1e3 * point.error.high


def _failed(point: Point) -> tuple[float, float, float]:
    assert point.success is not None
    rate = point.success
    return 100.0 * (1.0 - rate.value), 100.0 * (1.0 - rate.high), 100.0 * (1.0 - rate.low)


def _panel(axis: Any, points: Sequence[Point], title: str, label: str, values: _Values) -> None:
    with needs(__name__):
        from matplotlib.ticker import LogLocator, NullFormatter

    shown = [point for point in points if np.isfinite(point.ms) and np.isfinite(values(point)[0])]
    axis.set_xscale("log")
    if values is _failed:
        axis.set_ylim(-3.0, 103.0)
    else:
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_title(title, fontsize=12)
    axis.set_xlabel("time of a frame, ms")
    axis.set_ylabel(label)
    axis.grid(alpha=0.25, which="major")
    if not shown:
        return
    times = [point.ms for point in shown]
    axis.set_xlim(min(times) / 1.4, max(times) * 1.6)
    complete = [values(point)[0] if point.is_complete else np.inf for point in shown]
    on_front = is_on_front(times, complete)
    named = [
        point
        for point, flag in zip(shown, on_front, strict=True)
        if flag or point.presets or point.family in ("paper", "peer")
    ]
    for point in shown:
        _mark(axis, point, values, point in named)
    _step(axis, [p for p, flag in zip(shown, on_front, strict=True) if flag], values)
    _name(axis, named, values)


def _mark(axis: Any, point: Point, values: _Values, is_named: bool) -> None:
    colour, marker, _ = _STYLES[point.family]
    value, low, high = values(point)
    if not is_named:
        axis.plot(point.ms, value, marker, color=colour, **_FAINT)
        return
    bars = [[max(value - low, 0.0)], [max(high - value, 0.0) if np.isfinite(high) else 0.0]]
    axis.errorbar(
        point.ms,
        value,
        yerr=bars,
        fmt="*" if point.presets else marker,
        color=colour,
        markersize=17 if point.presets else 8,
        markerfacecolor=colour if point.is_complete else "white",
        markeredgecolor="black" if point.presets else colour,
        elinewidth=1.2,
        capsize=2.5,
        zorder=4,
    )


def _step(axis: Any, front: Sequence[Point], values: _Values) -> None:
    """The front as a step line: the best value that a time buys."""
    ordered = sorted(front, key=lambda point: (point.ms, values(point)[0]))
    times = [point.ms for point in ordered]
    errors = [values(point)[0] for point in ordered]
    right = axis.get_xlim()[1]
    axis.step([*times, right], [*errors, errors[-1]], where="post", color="black", linewidth=1.0, zorder=3)


def _name(axis: Any, points: Sequence[Point], values: _Values) -> None:
    """Label points directly; a thin line leads from a label that is not beside its point."""
    figure = axis.figure
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    # Presets are placed first, so that their labels are the nearest.
    ordered = sorted(points, key=lambda point: (not point.presets, point.ms))
    anchors = axis.transData.transform([(point.ms, values(point)[0]) for point in ordered])
    texts = [
        axis.text(
            0.0,
            0.0,
            point.label + ("" if point.is_complete else " (not in every scene)"),
            fontsize=11 if point.presets else 8.5,
            fontweight="bold" if point.presets else "normal",
            color=_STYLES[point.family][0] if point.family != "peer" else "0.35",
            transform=None,
            zorder=5,
        )
        for point in ordered
    ]
    sizes = np.array([(box.width, box.height) for box in (t.get_window_extent(renderer) for t in texts)])
    inside = axis.get_window_extent(renderer)
    half = 6.0
    boxes = np.array([[x - half, y - half, x + half, y + half] for x, y in anchors])
    bounds = (inside.x0 + 4.0, inside.y0 + 4.0, inside.x1 - 4.0, inside.y1 - 4.0)
    corners = label_corners(anchors, sizes, bounds, boxes)
    for text, corner, size, anchor in zip(texts, corners, sizes, anchors, strict=True):
        text.set_position(corner)
        nearest = np.clip(anchor, corner, corner + size)
        if np.hypot(*(nearest - anchor)) > 2.0 * half:
            axis.plot(*np.transpose([nearest, anchor]), color="0.6", linewidth=0.6, transform=None, zorder=1)


def _legend(figure: Any) -> None:
    with needs(__name__):
        from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker=marker, linestyle="none", markersize=8, label=text)
        for colour, marker, text in _STYLES.values()
    ]
    handles.append(Line2D([], [], color="0.4", marker="*", linestyle="none", markersize=15, label="preset"))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=10.5, frameon=False)
