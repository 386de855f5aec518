"""Import of command modules that need optional libraries."""

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
        A library is not installed. The message names it and how to install it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise Error(said(f"`{command}`", error)) from error
