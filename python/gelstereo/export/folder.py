"""A folder that exists only once it is complete."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from gelstereo.export.errors import ExportError


@contextlib.contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A context manager of the folder's contents under another name; without an error it gets its own.

    Raises
    ------
    ExportError
        If the folder exists.
    """
    if folder.exists():
        raise ExportError(f"{folder} exists; name a new folder, or remove this one")
    unfinished = folder.with_name(folder.name + ".partial")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    try:
        yield unfinished
        unfinished.rename(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
