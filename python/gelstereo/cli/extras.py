"""Modules of commands that need what is not always installed."""

from __future__ import annotations

import importlib
from types import ModuleType

from gelstereo import Error
from gelstereo.extras import said

__all__ = ["module_of"]


def module_of(command: str, name: str) -> ModuleType:
    """Import a command's module.

    Raises
    ------
    Error
        A library is not installed; the message says which, and how to get it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise Error(said(f"`{command}`", error)) from error
