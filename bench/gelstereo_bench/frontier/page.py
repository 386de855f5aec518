"""Pages of measurements, with tables between comment markers."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from gelstereo_bench.frontier.scenes import CONDITIONS
from gelstereo_bench.frontier.sensing import Row
from gelstereo_bench.frontier.table import Table, Target
from gelstereo_bench.reports.markdown import ReportError, replace_between, table
from gelstereo_bench.reports.provenance import processor

__all__ = [
    "LOCALIZATION_SECTIONS",
    "SECTIONS",
    "check_page",
    "fill_page",
    "row_tables",
    "write_page",
    "write_tables",
]

#: Names of the markers of docs/localization.md.
LOCALIZATION_SECTIONS = ("conditions", "targets", "localization", "near", "budgets", "parts", "nees")

#: Names of the markers of docs/accuracy-vs-time.md.
SECTIONS = (
    "conditions",
    "targets",
    "centres",
    "covariance",
    "tracking",
    "detect",
    "label",
    "whole",
    "speed",
    "stages",
    "growth",
    "threads",
    "saliency",
    "boards",
    "refraction",
    "nearest",
    "templates",
    "register",
)


def check_page(page: Path, sections: Sequence[str] = SECTIONS) -> None:
    """Check that a page can be filled, before a long measurement; create a page that does not exist.

    Raises
    ------
    ReportError
        A marker is missing.
    """
    if not page.exists():
        places = [f"<!-- begin {name} -->\n<!-- end {name} -->\n" for name in sections]
        page.write_text("\n".join([f"# {page.stem}\n", *places]), encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    lines = [f"<!-- {side} {name} -->" for name in sections for side in ("begin", "end")]
    missing = [line for line in lines if text.count(line) != 1]
    if missing:
        raise ReportError(f"{page} must hold once each the lines {', '.join(missing)}")


def write_page(
    page: Path, tables: Sequence[Table], targets: Sequence[Target], rounds: int, conditions: str = CONDITIONS
) -> None:
    """Fill all of the page's tables or none, with conditions and targets."""
    said = (
        f"All figures: {conditions}. Times: one thread, {processor()}, {rounds} rounds in which all "
        f"methods take turns; {_load()}."
    )
    head = ["what", "target", "measured", "met"]
    texts = {"conditions": said, "targets": table(head, [target.line() for target in targets])}
    fill_page(page, texts | {part.name: table(part.head, part.rows) for part in tables})


def fill_page(page: Path, texts: Mapping[str, str]) -> None:
    """Put texts between the markers of their names; all or none, so that a page is never half written."""
    with tempfile.TemporaryDirectory(dir=page.parent) as folder:
        draft = Path(folder) / page.name
        shutil.copy(page, draft)
        for name, text in texts.items():
            replace_between(draft, name, text)
        os.replace(draft, page)


def write_tables(page: Path, *tables: Table) -> None:
    """Fill some tables of a page."""
    fill_page(page, {part.name: table(part.head, part.rows) for part in tables})


def row_tables(rows: Sequence[Row]) -> list[Table]:
    """Create the tables of error and time, one per stage."""
    head = ["method", "error", "median ms", "p99 ms", "10^6 instructions", "speed-up over the baseline"]
    stages = dict.fromkeys(row.stage for row in rows)
    return [Table(stage, head, [_line(row) for row in rows if row.stage == stage]) for stage in stages]


def _line(row: Row) -> list[str]:
    return [
        row.name,
        row.error,
        f"{row.times.median_ms:.2f}",
        f"{row.times.p99_ms:.2f}",
        "-" if row.instructions is None else f"{row.instructions * 1e-6:.2f}",
        f"{row.speed:.1f}",
    ]


def _load() -> str:
    """Describe the machine's load."""
    try:
        load = os.getloadavg()[1]
    except OSError:
        return "the machine's load is unknown"
    return f"load {load:.1f} on {os.cpu_count()} processors during the run, which raises the 99th percentiles"
