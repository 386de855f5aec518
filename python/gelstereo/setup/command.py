"""The command ``gelstereo setup``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gelstereo.setup import Plan, set_up
from gelstereo.setup.plan import EXAMPLE

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo setup --example > plan.toml     a plan with every key, to edit
  gelstereo setup plan.toml --output cell   all steps, to cell/sensor.toml and cell/report.html

Stopped or repeated, it goes on with what has changed. The exit code is 1 if a step is in doubt.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("plan", type=Path, nargs="?", metavar="PLAN", help="TOML file that names the images")
    parser.add_argument(
        "--output", type=Path, default=Path("sensor"), metavar="FOLDER", help="folder to write (%(default)s)"
    )
    parser.add_argument("--example", action="store_true", help="print a plan and stop")


def run(arguments: argparse.Namespace) -> int:
    """Run the steps, print their figures, and write the sensor file and the report; return the exit code."""
    if arguments.example:
        print(EXAMPLE, end="")
        return 0
    if arguments.plan is None:
        print("gelstereo: setup needs a plan; `gelstereo setup --example` prints one", file=sys.stderr)
        return 2
    steps = set_up(Plan.load(arguments.plan), arguments.output, report=print)
    for name in ("sensor.toml", "report.html"):
        print(f"wrote {arguments.output / name}")
    return 0 if all(step.is_good for step in steps) else 1
