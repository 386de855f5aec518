"""The search's budget in a table and a figure: what a robot's default is chosen from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Params
from gelstereo.extras import needs
from gelstereo_bench.frontier.pipeline.budgets import OTHER_LAWS, SIMULATED, Budget
from gelstereo_bench.frontier.pipeline.labels import label_corners
from gelstereo_bench.frontier.table import Table, figure

with needs(__name__):
    import matplotlib

__all__ = ["budget_table", "draw_budgets", "lost_and_won", "time_share"]

#: Kinds that are drawn, in colours of Okabe and Ito. From near guesses, success is about the same.
_COLOURS = {SIMULATED: "#0072B2", OTHER_LAWS: "#D55E00"}
#: Budgets that are labelled.
_NAMED = (60_000, 80_000, 120_000, 200_000, 370_000)
Array = npt.NDArray[np.float64]
#: Results by kind of contacts and budget.
Found = Mapping[str, Mapping[int, Budget]]


def default_budget() -> int:
    """The budget of the presets with a search."""
    return int(Params().to_dict()["register"]["surface_search"]["budget"])


def time_share(result: Budget, usual: Budget) -> float:
    """Median over searches of the time, as a share of the time with the default budget.

    Both searches of a pair ran one after the other, so the machine's other load cancels. NaN if one of them
    refused.
    """
    if len(result.ms) != len(usual.ms):
        return float("nan")
    return float(np.median(np.array(result.ms) / np.array(usual.ms)))


def lost_and_won(result: Budget, usual: Budget) -> tuple[int, int]:
    """Searches that succeed with the default budget alone, and with this one alone."""
    own, other = np.array(result.success, bool), np.array(usual.success, bool)
    return int(np.sum(other & ~own)), int(np.sum(own & ~other))


def budget_table(found: Found) -> Table:
    """One row for each budget."""
    usual = found[SIMULATED][default_budget()]
    rows = []
    for budget, own in found[SIMULATED].items():
        row = [f"{budget}" + (" (default)" if budget == default_budget() else "")]
        for results in found.values():
            rate = results[budget].rate
            lost, won = lost_and_won(results[budget], results[default_budget()])
            row.append(f"{100 * rate.value:.1f} ({100 * rate.low:.1f} to {100 * rate.high:.1f})")
            row += [f"{lost} / {won} of {len(results[budget].success)}", figure(results[budget].over_bound)]
        row += [f"{100 * np.mean(own.converged):.0f}", f"{100 * np.mean(own.cut):.0f}"]
        row += [f"{np.median(own.ms):.1f}", f"{np.percentile(own.ms, 99):.1f}"]
        rows.append([*row, f"{time_share(own, usual):.2f}"])
    head = ["budget"]
    for kind in found:
        head += [f"success, {kind}, %", "lost / won", "over the bound"]
    head += [
        "converged, %",
        "may have more answers, %",
        "median ms",
        "p99 ms",
        "time, share of the default's",
    ]
    return Table("front-budgets", head, rows)


def draw_budgets(path: Path, found: Found) -> None:
    """Plot success over time, one line for each kind of contacts, every point a budget.

    Parameters
    ----------
    path
        PNG file that is written.
    found
        Results by kind and budget.
    """
    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    drawing, axis = plt.subplots(figsize=(11, 6.4))
    # A layout that adapts would move the axes after labels are placed.
    drawing.subplots_adjust(left=0.07, right=0.98, top=0.94, bottom=0.09)
    names, bars = [], []
    for (kind, colour), marker in zip(_COLOURS.items(), "o^", strict=True):
        results = found[kind]
        if not all(result.success for result in results.values()):
            continue
        rates = [(100.0 * r.rate.value, 100.0 * r.rate.low, 100.0 * r.rate.high) for r in results.values()]
        values, low, high = np.transpose(rates)
        shares = [time_share(result, results[default_budget()]) for result in results.values()]
        sides = [values - low, high - values]
        axis.errorbar(shares, values, yerr=sides, fmt=f"{marker}-", color=colour, capsize=3, label=kind)
        bars += list(zip(shares, low, shares, high, strict=True))
        names += [
            (share, value, budget, colour)
            for budget, share, value in zip(results, shares, values, strict=True)
            if budget in _NAMED and (kind == SIMULATED or budget != default_budget())
        ]
    axis.set(xlabel="time of one search, share of the default's (median of pairs)", ylabel="success, %")
    axis.set_title("surface_search: success over its budget")
    axis.margins(x=0.08, y=0.12)
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right")
    _name(axis, names, np.array(bars).reshape(-1, 4))
    drawing.savefig(path, dpi="figure")
    plt.close(drawing)


def _name(axis: Any, names: Sequence[tuple[float, float, int, str]], bars: Array) -> None:
    """Label points (time, success, budget, colour) beside the bars of all points (left, low, right, high)."""
    texts = []
    for _, _, budget, colour in names:
        said = f"{budget:,}".replace(",", " ") + (" (default)" if budget == default_budget() else "")
        texts.append(axis.text(0.0, 0.0, said, fontsize=10, color=colour, transform=None))
    axis.figure.canvas.draw()
    boxes = [text.get_window_extent() for text in texts]
    sizes = np.array([(box.width, box.height) for box in boxes]).reshape(-1, 2)
    anchors = axis.transData.transform(np.array([name[:2] for name in names]).reshape(-1, 2))
    low, high = (axis.transData.transform(ends) for ends in (bars[:, :2], bars[:, 2:]))
    inside = axis.get_window_extent()
    bounds = (inside.x0, inside.y0, inside.x1, inside.y1)
    corners = label_corners(anchors, sizes, bounds, np.hstack([low - 5.0, high + 5.0]))
    for text, corner in zip(texts, corners, strict=True):
        text.set_position(corner)
