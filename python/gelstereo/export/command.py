"""The command ``gelstereo export``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo import Error, Params
from gelstereo.cli.options import count
from gelstereo.export.lerobot import FORMAT, export_lerobot
from gelstereo.progress import Progress

EXAMPLES = """examples:
  gelstereo export run.mcap --to lerobot out/dataset --task "grasp the peg"
  gelstereo export run.mcap run.mcap --to lerobot out/two --task "grasp the peg" --images none --fps 10

  gelstereo export run.mcap --to lerobot out/forces --task "grasp the peg" --force force.toml

Each recording becomes an episode. Displacements are millimetres since the recording's first frame.
"""

FORMATS = ("lerobot",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "recordings", type=Path, nargs="+", metavar="RECORDING", help="MCAP file; one episode each"
    )
    parser.add_argument(
        "--to",
        nargs=2,
        required=True,
        metavar=("FORMAT", "FOLDER"),
        help=f"format ({' or '.join(FORMATS)}: a LeRobotDataset {FORMAT}) and the new folder to write",
    )
    parser.add_argument("--task", default="touch", help="what was done, in words (%(default)s)")
    parser.add_argument("--fps", type=count, help="frames a second; those of the recording if left out")
    parser.add_argument(
        "--force",
        nargs="?",
        const=True,
        type=Path,
        metavar="FILE",
        help="also force at each marker, full and wrench: the images are sensed again, with the settings of "
        "the recording or those of FILE (TOML, as by gelstereo calibrate-force)",
    )
    parser.add_argument(
        "--images",
        choices=["left", "right", "both", "none"],
        default="left",
        help="images to take along (%(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Export the recordings; return the exit code."""
    kind, folder = arguments.to
    if kind not in FORMATS:
        raise Error(f"there is no format {kind!r}; valid is {' or '.join(FORMATS)}")
    views = {"both": ("left", "right"), "none": ()}.get(arguments.images, (arguments.images,))
    settings = Params.load(arguments.force) if isinstance(arguments.force, Path) else None
    with Progress("exporting") as progress:
        episodes = export_lerobot(
            arguments.recordings,
            Path(folder),
            task=arguments.task,
            fps=arguments.fps,
            views=views,
            forces=arguments.force is not None,
            force_settings=settings,
            progress=progress,
        )
    for episode in episodes:
        timeline = episode.timeline
        print(
            f"episode {episode.number}  {episode.recording}: {episode.length} frames at {timeline.fps} Hz, "
            f"{timeline.repeated} repeated, {timeline.passed_over} passed over"
        )
    print(f"wrote {folder}")
    return 0
