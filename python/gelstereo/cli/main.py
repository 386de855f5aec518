"""Argument parsing and error handling: an error prints one line and returns exit code 2, Ctrl-C
returns 130.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from types import ModuleType

import gelstereo
from gelstereo import Error
from gelstereo.cli.extras import module_of

#: Every command is a module with ``EXAMPLES``, ``add_arguments(parser)`` and ``run(arguments) -> int``.
COMMANDS = {
    "demo": ("gelstereo.cli.demo", "press a part into a simulated sensor, locate it, and draw the picture"),
    "calibrate": ("gelstereo.calibrate.command", "stereo images of a board to a rig file"),
    "calibrate-layers": (
        "gelstereo.calibrate.layers_command",
        "images of the sensor's own markers to the pose and index of its gel",
    ),
    "inspect": ("gelstereo.cli.inspect", "an image of a gel to what it shows, and the settings for it"),
    "setup": ("gelstereo.setup.command", "images of a new sensor to one sensor file and a report"),
    "calibrate-force": (
        "gelstereo.force.command",
        "known weights and their recording to the gel's modulus, with a report",
    ),
    "compliance": (
        "gelstereo.force.compliance_command",
        "a narrow gel's sizes to the matrix of its compliance, for forces",
    ),
    "compare": ("gelstereo.setup.compare_command", "two sensor files: what differs, and what it means"),
    "tune": ("gelstereo.tune.command", "presses or a scene, and a goal, to the settings that reach it"),
    "localize": ("gelstereo.cli.localize", "a point cloud or stereo images, and a template, to a pose"),
    "template": ("gelstereo.cli.template", "a part's mesh, checked, to a template and a picture of it"),
    "simulate": ("gelstereo.cli.simulate", "a scene to stereo images with their truth"),
    "dataset": ("gelstereo.datasets.command", "random variations of a scene to a data set for training"),
    "live": (
        "gelstereo.live.command",
        "a camera, a scene or a folder, sensed and shown while it is recorded",
    ),
    "view": (
        "gelstereo.cli.view",
        "a recording or a folder of stereo images to a picture, or a recording step by step",
    ),
    "export": ("gelstereo.export.command", "recordings to a dataset of another program"),
    # The benchmarks, available only in a clone of the repository.
    "experiment": (
        "gelstereo_bench.experiments.command",
        "the paper's experiments, simulated, with a report each",
    ),
    "frontier": (
        "gelstereo_bench.frontier.command",
        "measure every method and write docs/accuracy-vs-time.md",
    ),
}

EXAMPLES = """examples:
  gelstereo demo                                  the whole pipeline on a simulated sensor, in a few seconds
  gelstereo view run.mcap --output located.png    a picture of a recording by gelstereo-host
  gelstereo COMMAND --help                        more examples of each command
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    arguments
        Command-line arguments without the program's name. Default: those of the process.

    Returns
    -------
    int
        Exit code: 0 on success; 1 if a part does not explain the contact, or frames contradict the estimated
        layers, or a known load reaches the border; 2 if an input cannot be used; 130 after Ctrl-C.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        parser, modules = _parser(words)
        parsed = parser.parse_args(words)
        return int(modules[parsed.command].run(parsed))
    except KeyboardInterrupt:
        print("\nstopped", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of the output has closed the pipe; without this, Python would report it again at exit.
        sys.stderr.close()
        return 0
    except (Error, OSError) as error:
        print(f"gelstereo: {' '.join(_in_words(error).split())}", file=sys.stderr)
        return 2


def _in_words(error: Error | OSError) -> str:
    """The message without the operating system's error number."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _parser(words: Sequence[str]) -> tuple[argparse.ArgumentParser, dict[str, ModuleType]]:
    """The parser, with the arguments of the requested command only: other commands are not imported."""
    parser = argparse.ArgumentParser(
        prog="gelstereo",
        description="Visuotactile sensing with stereo markers: from a stereo frame to a pose.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gelstereo {gelstereo.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    modules = {}
    for name, (module_name, summary) in COMMANDS.items():
        module = module_of(f"gelstereo {name}", module_name) if name in words[:1] else None
        command = commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=module.EXAMPLES if module else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if module is not None:
            module.add_arguments(command)
            modules[name] = module
    return parser, modules
