"""Plots as SVG: the same figure gives the same file."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure

__all__ = ["as_svg", "box_plots"]


def as_svg(figure: Figure) -> bytes:
    """Write a figure, without the time and without names drawn by chance."""
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gelstereo", "svg.fonttype": "path"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def box_plots(
    panels: Mapping[str, Mapping[str, Sequence[float]]],
    *,
    across: int,
    x_label: str,
    y_label: str,
    share: bool,
) -> Figure:
    """One panel of boxes for each name: quartiles, whiskers to 1.5 times their distance, dots beyond.

    Parameters
    ----------
    panels
        Values by panel and box.
    across
        Panels side by side.
    x_label, y_label
        What the boxes are of, and the values with their unit.
    share
        Whether all panels have the same scale.
    """
    down = -(-len(panels) // across)
    figure = Figure(figsize=(3.3 * across, 2.7 * down + 0.3), layout="constrained")
    axes: Any = figure.subplots(down, across, sharey=share, squeeze=False)
    for axis, (name, boxes) in zip(axes.flat, panels.items(), strict=False):
        axis.axhline(0.0, color="0.6", linewidth=0.8)
        axis.boxplot(
            list(boxes.values()),
            tick_labels=list(boxes),
            widths=0.6,
            flierprops={"marker": ".", "markersize": 2.0, "markeredgecolor": "0.5"},
            medianprops={"color": "C1", "linewidth": 1.4},
        )
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.grid(axis="y", alpha=0.3)
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    figure.supxlabel(x_label, fontsize=9)
    figure.supylabel(y_label, fontsize=9)
    return figure
