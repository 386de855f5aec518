"""The picture of the price of accuracy: errors and success over time, with the front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelstereo.extras import needs
from gelstereo_bench.frontier.pipeline.cases import Origin
from gelstereo_bench.frontier.pipeline.labels import label_corners
from gelstereo_bench.frontier.pipeline.sensors import Family
from gelstereo_bench.frontier.pipeline.summary import Point, front_of, named_of

with needs(__name__):
    import matplotlib

__all__ = ["draw_front"]

#: One colour and marker for each family; colours of Okabe and Ito, which the colour-blind can tell apart.
_STYLES: Mapping[Family, tuple[str, str, str]] = {
    "soft threshold": ("#0072B2", "o", "gelstereo, centres by soft threshold"),
    "fit": ("#009E73", "^", "gelstereo, centres by fit"),
    "fine fit": ("#D55E00", "v", "gelstereo, centres by fine fit"),
    "paper": ("#CC79A7", "D", "preset paper: the method of Cui et al."),
    "peer": ("0.5", "s", "other libraries"),
}
#: Half sides of the squares around points that labels avoid, px.
_NAMED_PX, _FAINT_PX = 8.0, 3.0
#: Points that are not named.
_FAINT = {"markersize": 3.5, "alpha": 0.35, "linestyle": "none", "zorder": 2}


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

    figure, grid = plt.subplots(len(depth), 2, figsize=(14.5, 6.2 * len(depth)), squeeze=False, dpi=100)
    figure.subplots_adjust(left=0.055, right=0.99, top=0.925, bottom=0.105, wspace=0.14, hspace=0.25)
    for axes, (origin, points) in zip(grid, depth.items(), strict=True):
        _panel(axes[0], points, f"depth, {origin} images", "error of a marker's depth, um rms", 1.0)
        _panel(axes[1], poses[origin], f"pose, {origin} images", "error of the pose, median, um", 1e3)
    _legend(figure)
    figure.suptitle(
        "The price of accuracy: error over time, lower left is better, the line is the front", fontsize=15
    )
    figure.savefig(path, dpi="figure")
    plt.close(figure)


def _panel(axis: Any, points: Sequence[Point], title: str, label: str, unit: float) -> None:
    """One axis; errors are multiplied by `unit`."""
    with needs(__name__):
        from matplotlib.ticker import LogLocator, NullFormatter

    shown = [point for point in points if np.isfinite(point.ms) and np.isfinite(point.error.value)]
    axis.set(xscale="log", yscale="log")
    for scale in (axis.xaxis, axis.yaxis):
        scale.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        scale.set_major_formatter("{x:g}")
        scale.set_minor_formatter(NullFormatter())
    axis.set_title(title, fontsize=13)
    axis.set_xlabel("time of a frame, ms", fontsize=11)
    axis.set_ylabel(label, fontsize=11)
    axis.grid(alpha=0.25, which="major")
    if not shown:
        return
    times, errors = [point.ms for point in shown], [unit * point.error.value for point in shown]
    axis.set_xlim(min(times) / 1.5, max(times) * 1.8)
    axis.set_ylim(min(errors) / 1.5, max(errors) * 1.5)
    named = named_of(shown)
    for point in shown:
        _mark(axis, point, unit, point in named)
    _step(axis, [p for p, is_front in zip(shown, front_of(shown), strict=True) if is_front], unit)
    _name(axis, named, shown, unit)


def _mark(axis: Any, point: Point, unit: float, is_named: bool) -> None:
    colour, marker, _ = _STYLES[point.family]
    value, low, high = (unit * each for each in (point.error.value, point.error.low, point.error.high))
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


def _step(axis: Any, front: Sequence[Point], unit: float) -> None:
    """The front as a step line: the best value that a time buys."""
    if not front:
        return
    ordered = sorted(front, key=lambda point: point.ms)
    times = [point.ms for point in ordered]
    errors = [unit * point.error.value for point in ordered]
    right = axis.get_xlim()[1]
    axis.step([*times, right], [*errors, errors[-1]], where="post", color="black", linewidth=1.0, zorder=3)


def _name(axis: Any, named: Sequence[Point], shown: Sequence[Point], unit: float) -> None:
    """Label points directly; a thin line leads from a label that is not beside its point."""
    figure = axis.figure
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    # Presets are placed first, so that their labels are the nearest.
    ordered = sorted(named, key=lambda point: (not point.presets, point.ms))
    texts = [_text(axis, point) for point in ordered]
    sizes = np.array([(box.width, box.height) for box in (t.get_window_extent(renderer) for t in texts)])
    anchors = _pixels(axis, ordered, unit)
    others = [point for point in shown if point not in named]
    reach = np.repeat([_NAMED_PX, _FAINT_PX], [len(ordered), len(others)])[:, None]
    every = np.vstack([anchors, _pixels(axis, others, unit)])
    inside = axis.get_window_extent(renderer)
    bounds = (inside.x0 + 4.0, inside.y0 + 4.0, inside.x1 - 4.0, inside.y1 - 4.0)
    corners = label_corners(anchors, sizes, bounds, np.hstack([every - reach, every + reach]))
    for text, corner, size, anchor in zip(texts, corners, sizes, anchors, strict=True):
        text.set_position(corner)
        nearest = np.clip(anchor, corner, corner + size)
        if np.hypot(*(nearest - anchor)) > 2.5 * _NAMED_PX:
            way = np.transpose([nearest, anchor])
            axis.plot(*way, color="0.6", linewidth=0.7, transform=None, zorder=1)


def _pixels(axis: Any, points: Sequence[Point], unit: float) -> Any:
    """(N, 2) positions in the picture."""
    places = np.array([(point.ms, unit * point.error.value) for point in points]).reshape(-1, 2)
    return axis.transData.transform(places) if len(places) else places


def _text(axis: Any, point: Point) -> Any:
    """A label: name, success, and whether some scenes fail."""
    success = "" if point.success is None else f", {100.0 * point.success.value:.0f} %"
    return axis.text(
        0.0,
        0.0,
        point.label + success + ("" if point.is_complete else " *"),
        fontsize=13 if point.presets else 10,
        fontweight="bold" if point.presets else "normal",
        color=_STYLES[point.family][0] if point.family != "peer" else "0.35",
        transform=None,
        zorder=5,
    )


def _legend(figure: Any) -> None:
    with needs(__name__):
        from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker=marker, linestyle="none", markersize=8, label=text)
        for colour, marker, text in _STYLES.values()
    ]
    handles.append(Line2D([], [], color="0.4", marker="*", linestyle="none", markersize=15, label="preset"))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=10, frameon=False)
    figure.text(
        0.5,
        0.043,
        "Bars: 95 %. Poses: share with an error below 150 um. Small points: other combinations of methods. "
        "*, hollow: fails in some scenes.",
        ha="center",
        fontsize=10,
        color="0.3",
    )
