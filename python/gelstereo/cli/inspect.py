"""The command ``gelstereo inspect``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo import Params
from gelstereo.cli.files import read_color_image, write_image
from gelstereo.inspection import inspect
from gelstereo.inspection.picture import draw_inspection

EXAMPLES = """examples:
  gelstereo inspect gel.png                                 what is there, and the settings for it
  gelstereo inspect gel.png --output seen.png --settings cell.toml
  gelstereo inspect left.png right.png --output seen        a picture of each image in the folder `seen`

The gel should be at rest. Only settings that differ from the preset are printed, in the form of the file
that gelstereo-host reads.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "images", type=Path, nargs="+", metavar="IMAGE", help="images of a gel, grey or in colour"
    )
    parser.add_argument(
        "--preset", default="balanced", choices=Params.presets(), help="preset to try (%(default)s)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="PICTURE",
        help="picture to write; a folder if there are several images",
    )
    parser.add_argument(
        "--settings",
        type=Path,
        metavar="FILE",
        help="TOML file to write with the settings of the first image",
    )


def run(arguments: argparse.Namespace) -> int:
    """Inspect each image, print what it shows, and write the requested files; return the exit code."""
    for at, path in enumerate(arguments.images):
        image = read_color_image(path)
        found = inspect(image, preset=arguments.preset)
        print(("\n" if at else "") + f"{path}\n{found}")
        if arguments.output is not None:
            several = len(arguments.images) > 1
            target = arguments.output / f"{path.stem}.png" if several else arguments.output
            write_image(target, draw_inspection(image, found))
            print(f"wrote {target}")
        if arguments.settings is not None and at == 0:
            arguments.settings.write_text(found.to_toml())
            print(f"wrote {arguments.settings}")
    return 0
