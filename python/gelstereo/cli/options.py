"""Options that several commands share."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Params
from gelstereo.geometry import se3_exp


def add_params(parser: argparse.ArgumentParser) -> None:
    """Add the options that select the settings."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--preset", default="balanced", help=f"settings: {' or '.join(Params.presets())} (%(default)s)"
    )
    group.add_argument("--params", type=Path, metavar="FILE", help="settings from a TOML file")


def params_of(arguments: argparse.Namespace) -> Params:
    """The selected settings."""
    return Params.load(arguments.params) if arguments.params else Params.preset(arguments.preset)


def add_guess(parser: argparse.ArgumentParser) -> None:
    """Add the guess of the part's pose in the sensor frame."""
    names = ("X", "Y", "Z")
    parser.add_argument(
        "--guess-mm",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=names,
        help="guess: the part's origin",
    )
    parser.add_argument(
        "--guess-deg",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=names,
        help="guess: rotation vector",
    )


def guess_of(arguments: argparse.Namespace) -> npt.NDArray[np.float64]:
    """The guess as a (4, 4) pose, ``t_sensor_object``."""
    pose = np.array(se3_exp([*np.radians(arguments.guess_deg), 0.0, 0.0, 0.0]))
    pose[:3, 3] = arguments.guess_mm
    return pose


def count(text: str) -> int:
    """Parse an integer of at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a count; valid is an integer of 1 or more")
    return int(text)
