"""Libraries that only some parts of gelstereo need, and the extras of the package that bring them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from gelstereo._native import Error

__all__ = ["MissingExtra", "needs", "said"]

#: The extra of the package that brings a library.
EXTRAS = {
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
    "open3d": "rivals",
    "small_gicp": "rivals",
    "probreg": "rivals",
    "meshlib": "rivals",
}


class MissingExtra(Error, ModuleNotFoundError):
    """A library that an extra of the package brings is not installed; the message names the extra."""


def _library(error: ImportError) -> str:
    """The library that is missing; trimesh raises such errors again with their text alone."""
    named = re.search(r"No module named '([^']+)'", str(error))
    return (error.name or (named[1] if named else "")).partition(".")[0]


def said(who: str, error: ImportError) -> str:
    """One sentence: who needs which library, and how to get it."""
    missing = _library(error) or "a package"
    extra = EXTRAS.get(missing)
    remedy = f": pip install 'gelstereo[{extra}]'" if extra else ""
    return f"{who} needs {missing}, which is not installed{remedy}"


@contextlib.contextmanager
def needs(who: str) -> Iterator[None]:
    """Imports of libraries that are not always installed.

    Parameters
    ----------
    who
        What needs them, for the message.

    Raises
    ------
    MissingExtra
        One is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if isinstance(error, MissingExtra) or _library(error) not in EXTRAS:
            raise
        missing = MissingExtra(said(who, error))
        missing.name = _library(error)
        raise missing from error
