"""Optional libraries, and how to install them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from gelstereo._native import Error

__all__ = ["MissingExtra"]

#: Argument of `pip install` for each library; `./bench` is a folder of the project's repository.
REQUIREMENTS = {
    # Installed with gelstereo, except with `pip install --no-deps`.
    "cv2": "opencv-contrib-python-headless",
    "trimesh": "trimesh",
    "cascadio": "gelstereo[step]",
    "mcap": "gelstereo[recording]",
    "lz4": "gelstereo[recording]",
    "rosbags": "gelstereo[recording]",
    "rerun": "gelstereo[rerun]",
    "pyarrow": "gelstereo[lerobot]",
    "zarr": "gelstereo[zarr]",
    "gelstereo_bench": "./bench",
    "scipy": "gelstereo[fem]",
    "matplotlib": "./bench",
    "rtree": "./bench",
    "mujoco": "./bench[physics]",
    "joblib": "./bench[batch]",
    "distributed": "./bench[batch]",
    "optuna": "./bench[tune]",
    "open3d": "./bench[rivals]",
    "small_gicp": "./bench[rivals]",
    "probreg": "./bench[rivals]",
    "meshlib": "./bench[rivals]",
}


class MissingExtra(Error, ModuleNotFoundError):
    """An optional library is not installed. The message states what to install."""


def _library(error: ImportError) -> str:
    """Name of the missing library. trimesh raises such errors again with only their text."""
    named = re.search(r"No module named '([^']+)'", str(error))
    return (error.name or (named[1] if named else "")).partition(".")[0]


def said(who: str, error: ImportError) -> str:
    """One sentence: which function needs which library, and how to install it."""
    missing = _library(error) or "a package"
    requirement = REQUIREMENTS.get(missing)
    remedy = f": pip install '{requirement}'" if requirement else ""
    return f"{who} needs {missing}, which is not installed{remedy}"


@contextlib.contextmanager
def needs(who: str) -> Iterator[None]:
    """Context manager for imports of optional libraries.

    Parameters
    ----------
    who
        The feature that needs them, for the message.

    Raises
    ------
    MissingExtra
        A library is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if isinstance(error, MissingExtra) or _library(error) not in REQUIREMENTS:
            raise
        missing = MissingExtra(said(who, error))
        missing.name = _library(error)
        raise missing from error
