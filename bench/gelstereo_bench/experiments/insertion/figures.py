"""Figures of the insertion's report, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs
from gelstereo_bench.experiments.figures import as_svg
from gelstereo_bench.experiments.insertion.analysis import wilson
from gelstereo_bench.experiments.insertion.grasp import Fit
from gelstereo_bench.experiments.insertion.hole import Hole

with needs(__name__):
    from matplotlib.figure import Figure

__all__ = ["calibration_curve", "error_curves", "over_the_hole"]

Array = npt.NDArray[np.float64]


def calibration_curve(curve: Sequence[tuple[float, int, int]]) -> bytes:
    """Predicted chance against the observed share; each point is (mean chance, grasps, insertions)."""
    figure = Figure(figsize=(5.0, 4.2), layout="constrained")
    axis: Any = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    for chance, grasps, inserted in curve:
        low, high = wilson(inserted, grasps)
        share = inserted / grasps
        axis.plot([chance, chance], [low, high], color="C0", linewidth=1.0)
        axis.plot([chance], [share], "o", color="C0", markersize=4)
        axis.annotate(str(grasps), (chance, share), xytext=(5, -9), textcoords="offset points", fontsize=7)
    axis.set_xlabel("predicted chance", fontsize=9)
    axis.set_ylabel("share that went in (number: grasps)", fontsize=9)
    axis.set_xlim(-0.03, 1.06)
    axis.set_ylim(-0.03, 1.03)
    axis.grid(alpha=0.3)
    return as_svg(figure)


def error_curves(curves: Mapping[str, Sequence[tuple[float, float]]], goal: float) -> bytes:
    """Success rate over the size of an error, one panel per kind of error, with a line at `goal`."""
    figure = Figure(figsize=(3.1 * len(curves), 2.8), layout="constrained")
    axes: Any = figure.subplots(1, len(curves), sharey=True, squeeze=False)
    for axis, (name, points) in zip(axes.flat, curves.items(), strict=True):
        axis.axhline(goal, color="C1", linewidth=0.9)
        axis.plot(*zip(*points, strict=True), marker=".", color="C0")
        axis.set_xlabel(name, fontsize=9)
        axis.set_ylim(-0.03, 1.03)
        axis.grid(alpha=0.3)
        axis.tick_params(labelsize=8)
    axes.flat[0].set_ylabel("share that goes in", fontsize=9)
    return as_svg(figure)


def over_the_hole(panels: Mapping[str, tuple[Fit, Array]]) -> bytes:
    """Parts at their poses (4, 4) in the hole's frame, seen along the hole; one panel per part."""
    figure = Figure(figsize=(2.7 * len(panels), 2.9), layout="constrained")
    axes: Any = figure.subplots(1, len(panels), squeeze=False)
    for axis, (letter, (fit, placed)) in zip(axes.flat, panels.items(), strict=True):
        lowered = np.array(placed)
        heights = fit.end.vertices_mm @ lowered[2, :3] + lowered[2, 3]
        lowered[2, 3] += fit.hole.tip_mm - heights.max()
        points = fit.end.below(fit.hole.mouth_mm, lowered)
        _outline(axis, _corners(fit.hole), color="0.55", linewidth=2.0)
        middle = 0.5 * (points[:, 2].min() + points[:, 2].max())
        _outline(axis, points[points[:, 2] <= middle, :2], color="C0", linewidth=1.0)
        _outline(axis, points[points[:, 2] > middle, :2], color="C3", linewidth=1.0)
        axis.set_aspect("equal")
        axis.set_title(f"({letter})", fontsize=9)
        axis.tick_params(labelsize=7)
    axes.flat[0].set_ylabel("mm", fontsize=8)
    return as_svg(figure)


def _outline(axis: Any, points: Array, **style: Any) -> None:
    order = cv2.convexHull(points.astype(np.float32), returnPoints=False)[:, 0]
    ring = points[[*order, order[0]]]
    axis.plot(ring[:, 0], ring[:, 1], **style)


def _corners(hole: Hole) -> Array:
    """Corners of the hole: intersections of neighbouring walls."""
    angle = np.argsort(np.arctan2(hole.normals[:, 1], hole.normals[:, 0]))
    normals, offsets = hole.normals[angle], hole.offsets_mm[angle]
    corners = []
    for here, after in zip(range(len(offsets)), np.roll(range(len(offsets)), -1), strict=True):
        pair = normals[[here, after]]
        if abs(np.linalg.det(pair)) > 1e-9:
            corners.append(np.linalg.solve(pair, offsets[[here, after]]))
    return np.array(corners)
