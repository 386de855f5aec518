"""The command `gelstereo calibrate`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from . import calibrate_stereo
from .errors import CalibrationError

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo calibrate --left 'left*.png' --right 'right*.png' --board 9x6 --square-mm 2 --out rig.toml
  gelstereo calibrate --left left*.png --right right*.png --board 9x6 --square-mm 2 --drop-outliers
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--left", nargs="+", required=True, metavar="IMAGE", help="left images, or a quoted pattern"
    )
    parser.add_argument(
        "--right", nargs="+", required=True, metavar="IMAGE", help="right images, or a quoted pattern"
    )
    parser.add_argument(
        "--board", type=board_size, required=True, metavar="COLSxROWS", help="inner corners, for example 9x6"
    )
    parser.add_argument("--square-mm", type=float, required=True, help="side of one square, mm")
    parser.add_argument("--out", type=Path, help="rig file to write (TOML)")
    parser.add_argument("--time-limit-s", type=float, default=10.0, help="longest corner search in one image")
    parser.add_argument("--drop-outliers", action="store_true", help="leave out pairs whose error stands out")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the rig file; return the exit code."""
    calibration = calibrate_stereo(
        expand(arguments.left),
        expand(arguments.right),
        board=arguments.board,
        square_mm=arguments.square_mm,
        time_limit_s=arguments.time_limit_s,
        drop_outliers=arguments.drop_outliers,
        progress=_show_progress if sys.stderr.isatty() else None,
    )
    print(calibration.summary())
    if arguments.out is not None:
        calibration.save(arguments.out)
        print(f"wrote {arguments.out}")
    return 0


def board_size(text: str) -> tuple[int, int]:
    """Columns and rows of ``9x6``."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a board; write inner corners as 9x6")
    return int(parts[0]), int(parts[1])


def expand(patterns: list[str]) -> list[Path]:
    """Files of names and patterns.

    Raises
    ------
    CalibrationError
        A pattern matches no file.
    """
    paths: list[Path] = []
    for pattern in patterns:
        if Path(pattern).is_file():
            paths.append(Path(pattern))
            continue
        folder, name = Path(pattern).parent, Path(pattern).name
        # A pattern without a file name, such as "" or "/", matches nothing.
        matches = sorted(folder.glob(name)) if name else []
        if not matches:
            raise CalibrationError(
                f"no file matches {pattern!r}; valid is an image, or a pattern such as 'left*.png'"
            )
        paths += matches
    return paths


def _show_progress(done: int, total: int, what: str) -> None:
    width = 30
    filled = width * done // max(total, 1)
    print(f"\r[{'#' * filled}{'.' * (width - filled)}] {what[:40]:<40}", end="", file=sys.stderr, flush=True)
    if done + 1 >= total:
        print("\r" + " " * (width + 44) + "\r", end="", file=sys.stderr, flush=True)
