"""Text between markers of a Markdown page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gelstereo import Error

__all__ = ["ReportError", "replace_between", "table"]


class ReportError(Error):
    """A page cannot be written."""


def replace_between(page: Path, name: str, text: str) -> None:
    """Put ``text`` between the lines ``<!-- begin name -->`` and ``<!-- end name -->`` of a page.

    Raises
    ------
    ReportError
        The page or its markers are missing.
    """
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    if not page.is_file():
        raise ReportError(f"{page} does not exist; it must hold the lines {begin} and {end}")
    old = page.read_text(encoding="utf-8")
    if old.count(begin) != 1 or old.count(end) != 1 or old.index(begin) > old.index(end):
        raise ReportError(f"{page} must hold the lines {begin} and {end} once each, in this order")
    head, rest = old.split(begin)
    tail = rest.split(end)[1]
    page.write_text(f"{head}{begin}\n{text.strip()}\n{end}{tail}", encoding="utf-8")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a Markdown table; all columns but the first are aligned to the right."""
    rule = ["---"] + ["---:"] * (len(head) - 1)
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, rule, *rows))
