"""The command ``gelstereo view``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo.cli.files import write_image
from gelstereo.cli.options import add_params, params_of
from gelstereo.cli.sense import sense_folder

EXAMPLES = """examples:
  gelstereo view run.mcap --output located.png        the moment at which the part was located
  gelstereo view out/press --output press.png         the last of a folder of stereo images
  gelstereo view out/press --rig rig.toml --frame 12 --output press.png
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "source", type=Path, help="recording (.mcap), or folder with left/NAME.png and right/NAME.png"
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="PICTURE", help="picture to write (.png, ...)"
    )
    parser.add_argument("--rig", type=Path, help="rig file of a folder; FOLDER/rig.toml if left out")
    parser.add_argument("--frame", type=int, default=-1, help="frame of a folder, counted from 0 (the last)")
    add_params(parser)


def run(arguments: argparse.Namespace) -> int:
    """Draw the picture; the exit code."""
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
    return 0
