"""The command ``gelstereo dataset``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

from gelstereo import simulate
from gelstereo.cli.options import count
from gelstereo.datasets.files import write_npz, write_zarr
from gelstereo.datasets.rendering import render
from gelstereo.datasets.sample import Sample
from gelstereo.progress import Progress

EXAMPLES = """examples:
  gelstereo dataset scenes/press_sphere.toml --vary varied.toml --count 4 --output out/presses
  gelstereo dataset scenes/press_sphere.toml --vary varied.toml --count 4 --no-images --output out/points

The file of --vary states what varies between samples, as in the tutorial on simulated data. The samples do
not depend on the number of workers.
"""

FORMATS = ("npz", "zarr", "lerobot")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument("--vary", type=Path, required=True, help="distribution of what varies (TOML)")
    parser.add_argument("--count", type=count, required=True, help="number of samples")
    parser.add_argument("--output", type=Path, required=True, help="new folder of the data set")
    parser.add_argument("--format", choices=FORMATS, default=FORMATS[0], help="format (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the data set (%(default)s)")
    parser.add_argument(
        "--workers", type=count, default=1, help="processes that render, at most (%(default)s)"
    )
    parser.add_argument("--no-images", action="store_true", help="only the truth, which takes less time")
    parser.add_argument("--task", default="touch", help="of lerobot: what was done, in words (%(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Render and write the data set; return the exit code."""
    simulator, folder = simulate(arguments.scene), arguments.output
    with Progress("rendering") as progress:
        samples = render(
            simulator,
            arguments.vary,
            arguments.count,
            seed=arguments.seed,
            workers=arguments.workers,
            images=not arguments.no_images,
            progress=progress,
        )
        frames = _writer(arguments)(samples)
    print(f"wrote {arguments.count} samples of {frames} frames to {folder}")
    return 0


def _writer(arguments: argparse.Namespace) -> Callable[[Iterator[Sample]], int]:
    """Writes samples in the format that is asked for, and returns the number of frames."""
    folder = arguments.output
    if arguments.format != "lerobot":
        write = write_npz if arguments.format == "npz" else write_zarr
        return lambda samples: write(samples, folder)

    def write_episodes(samples: Iterator[Sample]) -> int:
        # LeRobot's extra is needed by this format alone.
        from gelstereo.datasets.lerobot import write_lerobot_samples

        views = () if arguments.no_images else ("left", "right")
        episodes = write_lerobot_samples(samples, folder, task=arguments.task, views=views)
        return sum(episode.length for episode in episodes)

    return write_episodes
