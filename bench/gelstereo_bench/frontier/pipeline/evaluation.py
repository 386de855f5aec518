"""Modules of the independent evaluation, ``bench/outside``, which are not installed."""

from __future__ import annotations

import importlib
from typing import Any

from gelstereo import Error

__all__ = ["outside"]


def outside(module: str) -> Any:
    """A module of ``bench/outside``.

    Raises
    ------
    Error
        The folder ``bench`` is not on Python's path.
    """
    try:
        return importlib.import_module(f"outside.{module}")
    except ModuleNotFoundError as error:
        raise Error(
            f"the independent evaluation cannot be read ({error}); run the command in a clone of the "
            "repository with PYTHONPATH=bench"
        ) from error
