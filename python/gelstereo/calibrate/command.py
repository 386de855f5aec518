"""The command `gelstereo calibrate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo.progress import Progress

from . import calibrate_stereo
from .boards import AprilTagBoard, Board, CharucoBoard, Chessboard
from .errors import CalibrationError

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
        type=board_kind,
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
            board=board_of_options(arguments),
            time_limit_s=arguments.time_limit_s,
            drop_outliers=arguments.drop_outliers,
            progress=progress,
        )
    print(calibration.summary())
    if arguments.out is not None:
        calibration.save(arguments.out)
        print(f"wrote {arguments.out}")
    return 0


def board_kind(text: str) -> tuple[str, tuple[int, int]]:
    """Kind and size of ``9x6``, ``charuco:8x6`` or ``apriltag:6x4``."""
    kind, colon, size = text.lower().rpartition(":")
    if kind not in ("charuco", "apriltag") and colon:
        raise argparse.ArgumentTypeError(f"{kind!r} is not a kind of board; valid are charuco and apriltag")
    return kind or "chessboard", board_size(size)


def board_of_options(arguments: argparse.Namespace) -> Board:
    """The board that the options describe.

    Raises
    ------
    CalibrationError
        An option that this kind of board needs is missing, or one is given that it does not have.
    """
    kind, size = arguments.board
    has = {
        "chessboard": ["square_mm"],
        "charuco": ["square_mm", "marker_mm"],
        "apriltag": ["marker_mm", "gap_mm"],
    }
    for name in ("square_mm", "marker_mm", "gap_mm", "dictionary"):
        given, option = getattr(arguments, name) is not None, "--" + name.replace("_", "-")
        if name in has[kind] and not given:
            raise CalibrationError(f"{option} is missing; a board of kind {kind} needs it")
        if given and name not in has[kind] and (name != "dictionary" or kind == "chessboard"):
            raise CalibrationError(f"{option} is given, but a board of kind {kind} has none")
    if kind == "chessboard":
        return Chessboard(size, arguments.square_mm)
    if kind == "charuco":
        dictionary = arguments.dictionary or "4x4_50"
        return CharucoBoard(size, arguments.square_mm, arguments.marker_mm, dictionary)
    return AprilTagBoard(size, arguments.marker_mm, arguments.gap_mm, arguments.dictionary or "36h11")


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
