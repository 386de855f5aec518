"""The command ``gelstereo view``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gelstereo import Error
from gelstereo.cli.extras import module_of
from gelstereo.cli.files import write_image
from gelstereo.cli.options import add_params, count, params_of
from gelstereo.cli.sense import sense_folder

if TYPE_CHECKING:
    from gelstereo.view.steps import Steps

EXAMPLES = """examples:
  gelstereo view run.mcap --output located.png        the moment at which the part was located
  gelstereo view run.mcap --steps out/steps           a picture of each stage, and a page of all of them
  gelstereo view run.mcap --steps out/steps --every 5  of each fifth frame instead
  gelstereo view run.mcap --rerun run.rrd             a file for Rerun; without a name its viewer opens
  gelstereo view out/press --output press.png         the last of a folder of stereo images
  gelstereo view out/press --rig rig.toml --frame 12 --output press.png
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "source", type=Path, help="recording (.mcap), or folder with left/NAME.png and right/NAME.png"
    )
    how = parser.add_mutually_exclusive_group(required=True)
    how.add_argument("--output", type=Path, metavar="PICTURE", help="one picture to write (.png, ...)")
    how.add_argument(
        "--steps", type=Path, metavar="FOLDER", help="pictures of a recording's steps, and index.html"
    )
    how.add_argument(
        "--window", action="store_true", help="step through a recording: arrow keys, Home, End, q"
    )
    how.add_argument(
        "--rerun",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="RRD",
        help="steps of a recording to a file for Rerun, or to Rerun's viewer if no file is named",
    )
    parser.add_argument(
        "--every", type=count, metavar="N", help="a step of each Nth frame instead of each stage"
    )
    parser.add_argument("--rig", type=Path, help="rig file of a folder; FOLDER/rig.toml if left out")
    parser.add_argument("--frame", type=int, default=-1, help="frame of a folder, counted from 0 (the last)")
    add_params(parser)


def run(arguments: argparse.Namespace) -> int:
    """Draw the requested picture; return the exit code."""
    if arguments.output is not None:
        _draw_picture(arguments)
    elif arguments.source.is_dir():
        raise Error(f"{arguments.source} is a folder of images; steps need a recording (.mcap)")
    else:
        _show_steps(arguments)
    return 0


def _draw_picture(arguments: argparse.Namespace) -> None:
    from gelstereo.view import Moment, draw
    from gelstereo.view.recording import moment_of_recording

    if arguments.source.is_dir():
        params = params_of(arguments)
        sensed = sense_folder(arguments.source, arguments.rig, params, arguments.frame)
        moment = Moment.of(
            sensed.left,
            sensed.frame,
            sensed.reference_px,
            (sensed.frame.rows, sensed.frame.cols),
            title=f"{arguments.source.name}: frame {sensed.name}",
            notes=(f"mean marker motion {sensed.frame.motion_px:.2f} px",),
        )
    else:
        moment = moment_of_recording(arguments.source)
    write_image(arguments.output, draw(moment))
    print(f"wrote {arguments.output}")


def _show_steps(arguments: argparse.Namespace) -> None:
    from gelstereo.view.steps import Steps

    steps = Steps(arguments.source, arguments.every)
    if arguments.steps is not None:
        from gelstereo.view.step_folder import write_steps

        print(f"wrote {write_steps(steps, arguments.steps, write_image)}")
    elif arguments.window:
        _open_window(steps)
    else:
        rerun = module_of("gelstereo view --rerun", "gelstereo.view.step_rerun")
        # An empty path is no file name.
        file = arguments.rerun if arguments.rerun.name else None
        logged = rerun.log_steps(steps, file)
        print(f"wrote {file}: {logged} steps" if file else f"{logged} steps are in Rerun's viewer")


def _open_window(steps: Steps) -> None:
    from gelstereo.view.step_window import step_through
    from gelstereo.view.window import window_problem

    problem = window_problem("use --steps FOLDER")
    if problem is not None:
        raise Error(problem)
    step_through(steps)
