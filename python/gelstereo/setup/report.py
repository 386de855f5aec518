"""The report of a setup, as one page that opens offline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gelstereo.setup.step import Step
from gelstereo.view import html

__all__ = ["write_report"]


def write_report(path: Path, steps: Sequence[Step]) -> None:
    """Write the page: a summary, then each step with its figures, doubts and picture."""
    doubtful = [step.title.lower() for step in steps if not step.is_good]
    verdict = f"In doubt: {', '.join(doubtful)}." if doubtful else "All steps are good."
    blocks: list[html.Block] = [
        html.Paragraph(f"{verdict} The sensor is in sensor.toml beside this page."),
    ]
    for step in steps:
        blocks.append(html.Heading(f"{step.title}: {'good' if step.is_good else 'doubtful'}"))
        if step.figures:
            rows = [(figure.name, figure.value, figure.usual) for figure in step.figures]
            blocks.append(
                html.Grid("Figures of merit", ("figure", "value", "usual or given"), rows, words=True)
            )
        blocks += [html.Paragraph(f"Doubt: {doubt}.") for doubt in step.doubts]
        blocks += [html.Paragraph(f"Better: {advice}.") for advice in step.advice]
        if step.picture is not None:
            blocks.append(html.Figure(step.caption, step.picture, "png"))
    path.write_text(html.document("Setup of a sensor", blocks), encoding="utf-8")
