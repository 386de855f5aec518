"""The command `gelstereo calibrate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo.progress import Progress

from . import calibrate_stereo
from .board_names import BoardKind
from .boards import Board
from .errors import CalibrationError
from .pairs import expand

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo calibrate --left 'left*.png' --right 'right*.png' --board 9x6 --square-mm 2 --out rig.toml
  gelstereo calibrate --left left*.png --right right*.png --board 9x6 --square-mm 2 --drop-outliers
  gelstereo calibrate --left left*.png --right right*.png --board charuco:8x6 --square-mm 4 --marker-mm 3
  gelstereo calibrate --left left*.png --right right*.png --board apriltag:6x4 --marker-mm 3 --gap-mm 1

A chessboard must be visible as a whole. Boards with markers may reach beyond the image.
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
        "--board",
        type=_board_kind,
        required=True,
        metavar="BOARD",
        help="inner corners of a chessboard (9x6), squares of a ChArUco board (charuco:8x6), "
        "or tags (apriltag:6x4)",
    )
    parser.add_argument("--square-mm", type=float, help="side of one square, mm")
    parser.add_argument("--marker-mm", type=float, help="side of one ChArUco marker or AprilTag, mm")
    parser.add_argument("--gap-mm", type=float, help="distance between the black squares of AprilTags, mm")
    parser.add_argument(
        "--dictionary",
        help="markers: 4x4_50 (default of ChArUco), 5x5_100, 36h11 (default of AprilTags), ...",
    )
    parser.add_argument("--out", type=Path, help="rig file to write (TOML)")
    parser.add_argument("--time-limit-s", type=float, default=10.0, help="longest corner search in one image")
    parser.add_argument("--drop-outliers", action="store_true", help="leave out pairs whose error stands out")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the rig file; return the exit code."""
    with Progress("calibrating") as progress:
        calibration = calibrate_stereo(
            expand(arguments.left),
            expand(arguments.right),
            board=_board(arguments),
            time_limit_s=arguments.time_limit_s,
            drop_outliers=arguments.drop_outliers,
            progress=progress,
        )
    print(calibration.summary())
    if arguments.out is not None:
        calibration.save(arguments.out)
        print(f"wrote {arguments.out}")
    return 0


def _board_kind(text: str) -> BoardKind:
    try:
        return BoardKind.parse(text)
    except CalibrationError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _board(arguments: argparse.Namespace) -> Board:
    lengths = {name: getattr(arguments, name) for name in BoardKind.OPTIONS}
    kind: BoardKind = arguments.board
    return kind.board(lengths, lambda name: "--" + name.replace("_", "-"))
