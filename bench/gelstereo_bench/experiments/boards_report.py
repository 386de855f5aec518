"""Report of the boards' experiment: Table I and Fig. 14."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gelstereo.view.html import Block, Figure, Grid, Heading, Paragraph
from gelstereo_bench.experiments.batch import Trial
from gelstereo_bench.experiments.figures import as_svg, box_plots
from gelstereo_bench.experiments.report import Report
from gelstereo_bench.experiments.store import Record
from gelstereo_bench.frontier.boards import BASELINE
from gelstereo_bench.frontier.scenes import CONDITIONS

__all__ = ["PAPER_UM", "boards_report", "errors_um", "height_table", "salient_table"]

#: Upper limit of the error that the paper reports for all its boards (section VI-A).
PAPER_UM = 60.0

_SENSORS = {
    "boards": "Cameras that see the markers directly",
    "refraction": "Through 20 mm of air, 3 mm of acrylic and 5 mm of gel",
}

#: Methods in the tables of the summary.
_PRESETS, _SALIENT = "presets, and the paper's pipeline in OpenCV", "salient points"

_ASKED = (
    "How accurate is the point cloud? Boards with a block of 0.4 to 1.8 mm, in steps of 0.2 mm, are pressed "
    "until the plate around the block lies on the gel, several times each. The height error is the measured "
    "height of the markers on the block above rest minus the true one. The paper presses each board five "
    "times and reports errors below 60 um on its sensor (Table I; box plot in Fig. 14)."
)


def boards_report(trials: Sequence[Trial], records: Sequence[Record], inputs: Mapping[str, str]) -> Report:
    """Create tables and figures from the records."""
    findings: list[Block] = []
    for sensor, title in _SENSORS.items():
        pairs = [(t, r) for t, r in zip(trials, records, strict=True) if t.configuration["sensor"] == sensor]
        if pairs:
            findings += _sensor_blocks(title, [t for t, _ in pairs], [r for _, r in pairs])
    grids = [block for block in findings if isinstance(block, Grid)]
    summary = [grid for grid in grids if _PRESETS in grid.caption or _SALIENT in grid.caption]
    return Report("Boards of known height", _ASKED, CONDITIONS, findings, inputs, summary)


def _sensor_blocks(title: str, trials: Sequence[Trial], records: Sequence[Record]) -> list[Block]:
    methods = list(records[0]["methods"])
    whole = [name for name in methods if ":" not in name]
    rungs = [name for name in methods if name not in whole]
    errors = errors_um(trials, records)
    refused = sorted(
        {(m, r["methods"][m]["refused"]) for r in records for m in methods if "refused" in r["methods"][m]}
    )
    blocks: list[Block] = [Heading(title)]
    for name, group in ((_PRESETS, whole), ("rungs of single stages", rungs)):
        if group:
            blocks += _height_blocks(title, name, {method: errors[method] for method in group})
    blocks += [
        Heading("The paper's measure", 3),
        Paragraph(
            "The paper measures a block by its salient points. With a threshold in depth (0.35 mm, Eq. 4; "
            "preset paper), the slopes beside a block that is higher than the threshold are salient too. The "
            "mean is then lower than the block. The other presets find the points under pressure, whose "
            "height is that of the block."
        ),
        salient_table(f"{title}, {_SALIENT}", trials, records, [name for name in whole if name != BASELINE]),
    ]
    if refused:
        blocks.append(
            Grid(f"{title}, refusals", ["method", "why"], [list(line) for line in refused], words=True)
        )
    return blocks


def _height_blocks(title: str, name: str, errors: Mapping[str, Mapping[str, Sequence[float]]]) -> list[Block]:
    """Table I and Fig. 14 of some methods."""
    return [
        Heading(name[0].upper() + name[1:], 3),
        height_table(f"{title}, {name}", errors),
        Figure(
            f"{title}, {name}: height error by protrusion; quartiles, whiskers to 1.5 times their distance, "
            "dots beyond (as Fig. 14). Every panel has its own scale.",
            as_svg(box_plots(errors, across=4, x_label="protrusion, mm", y_label="height error, um")),
            "svg",
        ),
    ]


def errors_um(trials: Sequence[Trial], records: Sequence[Record]) -> dict[str, dict[str, list[float]]]:
    """Errors of all markers and presses by method and protrusion; empty where all presses were refused."""
    found: dict[str, dict[str, list[float]]] = {name: {} for name in records[0]["methods"]}
    for trial, record in zip(trials, records, strict=True):
        for name, result in record["methods"].items():
            board = found[name].setdefault(_board(trial), [])
            board += result.get("errors_um", [])
    return found


def height_table(title: str, errors: Mapping[str, Mapping[str, Sequence[float]]]) -> Grid:
    """Table I: mean and standard deviation over markers and presses."""
    boards = list(next(iter(errors.values())))
    rows = [
        [method, *map(_mean_std, found.values()), _largest([float(np.mean(e)) for e in found.values() if e])]
        for method, found in errors.items()
    ]
    rows.append(["the paper's sensor", *[f"< {PAPER_UM:.0f}"] * (len(boards) + 1)])
    caption = f"{title}: height error by protrusion, mean ± standard deviation over markers and presses, um"
    return Grid(caption, ["method", *(f"{board} mm" for board in boards), "largest mean"], rows)


def salient_table(
    title: str, trials: Sequence[Trial], records: Sequence[Record], methods: Sequence[str]
) -> Grid:
    """Mean height of the salient points less the protrusion, per press."""
    found: dict[str, dict[str, list[float]]] = {name: {} for name in methods}
    for trial, record in zip(trials, records, strict=True):
        for name in methods:
            board = found[name].setdefault(_board(trial), [])
            height_mm = record["methods"][name].get("salient_mm")
            if height_mm is not None:
                board.append(1e3 * (height_mm - trial.configuration["protrusion_mm"]))
    boards = list(next(iter(found.values())))
    rows = [[name, *map(_mean_std, values.values())] for name, values in found.items()]
    caption = f"{title}: mean height minus the protrusion, mean ± standard deviation over presses, um"
    return Grid(caption, ["method", *(f"{board} mm" for board in boards)], rows)


def _board(trial: Trial) -> str:
    protrusion_mm: Any = trial.configuration["protrusion_mm"]
    return f"{protrusion_mm:.1f}"


def _mean_std(values: Sequence[float]) -> str:
    return f"{np.mean(values):+.1f} ± {np.std(values):.1f}" if values else "none"


def _largest(means: Sequence[float]) -> str:
    return f"{max(means, key=abs):+.1f}" if means else "none"
