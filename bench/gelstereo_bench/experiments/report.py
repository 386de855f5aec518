"""The report of an experiment: question, results, and provenance."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gelstereo.view.html import Block, Details, Grid, Heading, Paragraph, document
from gelstereo_bench.experiments.batch import Trial
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.provenance import build_digest, digest_of, machine, processor, versions

__all__ = ["Report", "fill_page", "write_report"]


@dataclass(frozen=True)
class Report:
    """Contents of an experiment's report.

    Attributes
    ----------
    title
        Title of the page.
    asked
        Question of the experiment, and the paper's answer.
    conditions
        Conditions of all figures; starts with "simulated" for simulated data.
    findings
        Tables and figures.
    inputs
        Scenes and settings used, as TOML, by name.
    summary
        Tables that the manual includes.
    """

    title: str
    asked: str
    conditions: str
    findings: Sequence[Block]
    inputs: Mapping[str, str]
    summary: Sequence[Grid] = ()


def write_report(path: Path, report: Report, *, seed: int, trials: Sequence[Trial]) -> str:
    """Write a report as one HTML file; the same trials give an identical file on the same machine.

    Parameters
    ----------
    path
        Path of the file; its folder must exist.
    report
        The report.
    seed
        Seed of the batch, from which the trials' seeds are derived.
    trials
        Trials whose records were used.

    Returns
    -------
    str
        SHA-256 of the file.
    """
    text = document(report.title, [*_opening(report), *report.findings, *_evidence(report, seed, trials)])
    draft = path.with_name(path.name + ".part")
    draft.write_text(text, encoding="utf-8")
    draft.replace(path)
    return hashlib.sha256(text.encode()).hexdigest()


def fill_page(page: Path, name: str, report: Report, *, seed: int, trials: Sequence[Trial]) -> None:
    """Put a report's summary between the lines ``<!-- begin name -->`` and ``<!-- end name -->`` of a
    Markdown page.

    Raises
    ------
    ReportError
        The page or its markers are missing.
    """
    conditions = f"{report.conditions[0].upper()}{report.conditions[1:]}"
    said = f"{conditions}; {len(trials)} trials, seed {seed}, {processor()}."
    grids = [f"{grid.caption}:\n\n{table(grid.head, grid.rows)}" for grid in report.summary]
    replace_between(page, name, "\n\n".join([said, *grids]))


def _opening(report: Report) -> list[Block]:
    return [
        Heading("What is asked"),
        Paragraph(report.asked),
        Paragraph(f"All figures: {report.conditions}."),
    ]


def _evidence(report: Report, seed: int, trials: Sequence[Trial]) -> list[Block]:
    """Provenance of the figures, sufficient to reproduce them bit for bit."""
    names = sorted({name for trial in trials for name in trial.configuration})
    lines = [
        [*(_cell(trial.configuration.get(name)) for name in names), str(trial.seed), trial.digest[:12]]
        for trial in trials
    ]
    made = [
        *([name, text] for name, text in versions().items()),
        ["build of gelstereo", build_digest()],
        ["written on", machine()],
        ["seed", str(seed)],
        ["trials", str(len(trials))],
    ]
    blocks: list[Block] = [
        Heading("What the figures rest on"),
        Grid("Build and machine", ["what", "which"], made, words=True),
        Grid(
            "Inputs by the SHA-256 of their TOML",
            ["input", "SHA-256"],
            [[name, digest_of(text)] for name, text in report.inputs.items()],
            words=True,
        ),
    ]
    blocks += [Details(name, text) for name, text in report.inputs.items()]
    table = [[*names, "seed", "digest"], *lines]
    return [*blocks, Details("every trial", "\n".join("  ".join(row) for row in _padded(table)))]


def _cell(value: object) -> str:
    return "-" if value is None else str(value)


def _padded(table: Sequence[Sequence[str]]) -> list[list[str]]:
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in table]
