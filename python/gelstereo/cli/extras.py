"""Modules that need what is not always installed."""

from __future__ import annotations

import importlib
from types import ModuleType

from gelstereo import Error

__all__ = ["module_of"]

#: The extra of the package that brings a library.
_EXTRAS = {
    "cascadio": "step",
    "scipy": "bench",
    "matplotlib": "bench",
    "rtree": "bench",
    "mcap": "recording",
    "lz4": "recording",
    "rosbags": "recording",
    "rerun": "rerun",
    "pyarrow": "lerobot",
    "mujoco": "physics",
    "joblib": "batch",
    "distributed": "batch",
}


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
        missing = (error.name or "a package").partition(".")[0]
        extra = _EXTRAS.get(missing)
        remedy = f": pip install 'gelstereo[{extra}]'" if extra else ""
        raise Error(f"`{command}` needs {missing}, which is not installed{remedy}") from error
