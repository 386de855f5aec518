"""Known loads and when they acted."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Error

__all__ = ["COMPONENTS", "Load", "LoadsError", "read_loads"]

Floats = npt.NDArray[np.float64]

#: Components of a load: towards the camera, along the rows, along the columns, and the torque about the
#: direction towards the camera.
COMPONENTS = ("normal_n", "x_n", "y_n", "twist_nmm")
#: Standard gravity, m/s².
_GRAVITY = 9.80665
_TIMES = ("start_s", "end_s")
_MASS = ("mass_g", "tilt_deg", "towards_deg")


class LoadsError(Error):
    """A table of loads cannot be used."""


@dataclass(frozen=True)
class Load:
    """A load that acted for a time.

    Attributes
    ----------
    start_s, end_s : float
        Since the first frame of the recording.
    known : (4,) float64
        Exerted on the gel: pressing force, forces along the rows (to the right) and along the columns (down),
        newtons; and torque about the pressing direction at the middle of the contact, newton millimetres.
        NaN where it is not known.
    """

    start_s: float
    end_s: float
    known: Floats

    def __str__(self) -> str:
        parts = [
            f"{name} {value:.3g}"
            for name, value in zip(COMPONENTS, self.known, strict=True)
            if value == value
        ]
        return f"{self.start_s:g} to {self.end_s:g} s: {', '.join(parts)}"


def read_loads(path: str | Path) -> list[Load]:
    """Read a table of loads.

    Parameters
    ----------
    path
        CSV with a header. ``start_s`` and ``end_s`` are required. A load is given by some of ``normal_n``,
        ``x_n``, ``y_n`` and ``twist_nmm``, or by ``mass_g`` of a weight that lies on the gel. With
        ``tilt_deg``, the gel is tilted, and the weight pulls towards ``towards_deg`` (from the direction of
        the rows towards that of the columns). Cells may be empty. Lines that begin with ``#`` are comments.

    Returns
    -------
    list of Load
        In the order of their times.

    Raises
    ------
    LoadsError
        A column is unknown or missing, a cell is no number, or times overlap.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        lines = csv.DictReader(line for line in file if line.strip() and not line.startswith("#"))
        columns = [name.strip() for name in lines.fieldnames or ()]
        _check_columns(path, columns)
        lines.fieldnames = columns
        loads = [_load(f"{path}, load {number}", row) for number, row in enumerate(lines, start=1)]
    loads.sort(key=lambda load: load.start_s)
    for before, after in pairwise(loads):
        if after.start_s < before.end_s:
            raise LoadsError(f"{path}: the loads at {before} and at {after} overlap; one acts at a time")
    if not loads:
        raise LoadsError(f"{path} has no loads; give at least two of different size")
    return loads


def _check_columns(path: str | Path, columns: list[str]) -> None:
    valid = (*_TIMES, *COMPONENTS, *_MASS)
    unknown = [name for name in columns if name not in valid]
    missing = [name for name in _TIMES if name not in columns]
    if unknown or missing or not {"mass_g", *COMPONENTS} & set(columns):
        raise LoadsError(
            f"{path} has the columns {', '.join(columns) or 'none'}; needed are start_s, end_s, and mass_g "
            f"or some of {', '.join(COMPONENTS)}; also valid are tilt_deg and towards_deg"
        )


def _load(where: str, row: Mapping[str, str | None]) -> Load:
    def number(name: str) -> float:
        text = (row.get(name) or "").strip()
        try:
            found = float(text) if text else math.nan
        except ValueError:
            raise LoadsError(f"{where}: {name} is {text!r}; valid is a number, or nothing") from None
        if math.isinf(found):
            raise LoadsError(f"{where}: {name} is {text!r}; valid is a finite number")
        return found

    start_s, end_s = (number(name) for name in _TIMES)
    if not 0 <= start_s < end_s:
        raise LoadsError(f"{where}: start_s is {start_s} and end_s {end_s}; valid is 0 <= start_s < end_s")
    known = np.array([number(name) for name in COMPONENTS])
    mass_g, tilt_deg, towards_deg = (number(name) for name in _MASS)
    if math.isnan(mass_g):
        if np.isnan(known).all():
            raise LoadsError(f"{where}: no load is given; fill mass_g or one of {', '.join(COMPONENTS)}")
        return Load(start_s, end_s, known)
    if mass_g < 0.0:
        raise LoadsError(f"{where}: mass_g is {mass_g:g}; valid is 0 or more")
    weight_n = mass_g * 1e-3 * _GRAVITY
    tilt, towards = (math.radians(0.0 if math.isnan(x) else x) for x in (tilt_deg, towards_deg))
    shear_n = weight_n * math.sin(tilt)
    of_mass = (weight_n * math.cos(tilt), shear_n * math.cos(towards), shear_n * math.sin(towards))
    known[:3] = np.where(np.isnan(known[:3]), of_mass, known[:3])
    return Load(start_s, end_s, known)
