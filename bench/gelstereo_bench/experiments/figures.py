"""Plots as reproducible SVG files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

with needs(__name__):
    import matplotlib
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

__all__ = ["as_svg", "box_plots", "contact_maps"]

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def as_svg(figure: Figure) -> bytes:
    """Write a figure without timestamp and random identifiers."""
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
) -> Figure:
    """Box plots, one panel per name: quartiles, whiskers to 1.5 times the interquartile range, outliers as
    dots.

    Parameters
    ----------
    panels
        Values by panel and box.
    across
        Number of panels side by side.
    x_label, y_label
        Labels of the boxes and of the values, with unit; every panel has its own scale.
    """
    down = -(-len(panels) // across)
    figure, axes = _panels(down, min(across, len(panels)))
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
    figure.supxlabel(x_label, fontsize=9, y=0.02 / down)
    figure.supylabel(y_label, fontsize=9, x=0.01)
    return figure


def _panels(down: int, across: int) -> tuple[Figure, Any]:
    """Panels of equal size at computed positions, because a layout engine takes as long as drawing."""
    width, height = 3.3 * across + 0.3, 2.6 * down + 0.5
    figure = Figure(figsize=(width, height))
    figure.subplots_adjust(
        left=0.75 / width,
        right=1.0 - 0.1 / width,
        bottom=0.55 / height,
        top=1.0 - 0.3 / height,
        wspace=0.2,
        hspace=0.28,
    )
    return figure, figure.subplots(down, across, squeeze=False)


def contact_maps(truth_mm: Array, found_mm: Array, touching: Mask, salient: Mask) -> Figure:
    """Maps of a contact, a cell per marker: true and measured heights, their difference, and the contact
    region.

    Parameters
    ----------
    truth_mm, found_mm : (rows, cols) float64
    touching, salient : (rows, cols) bool
        True contact, and markers classified as in contact.
    """
    figure = Figure(figsize=(13.0, 3.0))
    axes: Any = figure.subplots(1, 4)
    figure.subplots_adjust(left=0.01, right=0.95, bottom=0.03, top=0.9, wspace=0.2)
    top_mm = max(float(truth_mm.max()), float(found_mm.max()), 0.1)
    error_um = 1e3 * (found_mm - truth_mm)
    largest_um = max(float(np.abs(error_um).max()), 1.0)
    # 0 neither, 1 touches only, 2 salient only, 3 both.
    region = touching.astype(np.int64) + 2 * salient.astype(np.int64)
    colours = ListedColormap(["#eef0f2", "#3c9ec4", "#f6a828", "#2e7d4f"])
    shown: list[tuple[str, Array, dict[str, Any]]] = [
        ("height in truth, mm", truth_mm, {"cmap": "viridis", "vmin": 0.0, "vmax": top_mm}),
        ("height as measured, mm", found_mm, {"cmap": "viridis", "vmin": 0.0, "vmax": top_mm}),
        ("measured less true, um", error_um, {"cmap": "RdBu_r", "vmin": -largest_um, "vmax": largest_um}),
        ("region", region.astype(np.float64), {"cmap": colours, "vmin": -0.5, "vmax": 3.5}),
    ]
    for axis, (title, values, style) in zip(axes, shown, strict=True):
        drawn = axis.imshow(values, interpolation="nearest", **style)
        axis.set_title(title, fontsize=9)
        axis.set(xticks=[], yticks=[])
        bar = figure.colorbar(drawn, ax=axis, fraction=0.046, pad=0.03)
        bar.ax.tick_params(labelsize=8)
        if title == "region":
            bar.set_ticks([0, 1, 2, 3], labels=["neither", "touches", "salient", "both"])
    return figure
