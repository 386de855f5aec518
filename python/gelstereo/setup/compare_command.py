"""The command ``gelstereo compare``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo.setup.compare import compare_sensors
from gelstereo.setup.sensor import load_sensor

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo compare sensor.toml again/sensor.toml   what changed since the gel was replaced

The exit code is 0 if the first file can serve for the second sensor, and 1 if its points would be off by more
than their noise.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("first", type=Path, metavar="FIRST", help="sensor file of `gelstereo setup`")
    parser.add_argument("second", type=Path, metavar="SECOND", help="sensor file to compare with it")


def run(arguments: argparse.Namespace) -> int:
    """Print what differs; return the exit code."""
    comparison = compare_sensors(load_sensor(arguments.first), load_sensor(arguments.second))
    print(comparison)
    return 0 if comparison.is_interchangeable else 1
