"""The steps of a recording as a folder of pictures with an index page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gelstereo._native import Error
from gelstereo.view.canvas import Image
from gelstereo.view.html import Beside, Block, Grid, Heading, Paragraph, document
from gelstereo.view.picture import draw
from gelstereo.view.steps import Step, Steps, notes_of

_PAGE = "index.html"


class FolderError(Error):
    """A folder for pictures already has other contents."""


def write_steps(steps: Steps, folder: Path, write: Callable[[Path, Image], None]) -> Path:
    """Write a picture of every step, ``000_rest.png`` and so on, and ``index.html``; returns the page.

    Parameters
    ----------
    steps
        The recording.
    folder
        A new or empty folder, or one written by this function before; its older pictures are replaced.
    write
        Function that writes an image to a file.

    Raises
    ------
    FolderError
        If the folder has files, but no pictures of steps.
    RecordingError
        If the recording has no steps.
    """
    page = folder / _PAGE
    if folder.is_dir() and any(folder.iterdir()) and not page.is_file():
        raise FolderError(f"{folder} has other files; valid is a new or an empty folder")
    blocks: list[Block] = []
    rows, last = [], None
    for step in steps:
        if last is None:
            _clear(folder)
        name = f"{step.number:03d}_{_letters(step.stage)}.png"
        write(folder / name, draw(steps.moment(step)))
        blocks += [Heading(f"{step.number}: {step.place}"), *map(Paragraph, notes_of(step))]
        blocks.append(Beside(f"Step {step.number}: {step.place}", name))
        rows.append(_row(step))
        last = step
    head = ("step", "stage", "frame", "source time, s", "mean marker motion, px", "what happened")
    ending = last.outcome if last is not None else ""
    summary: list[Block] = [
        Paragraph(f"The run ended: {ending}." if ending else "The recording does not say how the run ended."),
        Grid("Steps", head, rows, words=True),
    ]
    page.write_text(document(f"{steps.path.name}, step by step", [*summary, *blocks]), encoding="utf-8")
    return page


def _row(step: Step) -> list[str]:
    return [
        str(step.number),
        step.stage,
        "" if step.index is None else str(step.index),
        f"{step.time_ns * 1e-9:.3f}",
        "" if step.motion_px is None else f"{step.motion_px:.2f}",
        "; ".join([*step.events, *([step.outcome] if step.outcome else [])]),
    ]


def _letters(stage: str) -> str:
    """A stage's name as part of a file name, without characters that could lead out of the folder."""
    return "".join(letter for letter in stage if letter.isascii() and letter.isalnum()) or "frame"


def _clear(folder: Path) -> None:
    """Remove older steps; other files stay."""
    for older in folder.glob("[0-9][0-9][0-9]*_*.png"):
        older.unlink()
