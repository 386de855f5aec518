"""The command ``gelstereo tune``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo._native import Params, Scene, Template
from gelstereo.cli.options import add_guess, guess_of
from gelstereo.geometry import shape_mesh
from gelstereo.setup.sensor import Sensor, load_sensor
from gelstereo.templates import MM_PER_UNIT
from gelstereo.tune.cache import default_folder, file_name
from gelstereo.tune.contacts import Part
from gelstereo.tune.goal import Goal, TuneError
from gelstereo.tune.run import conditions_of, laboratory_of, tune
from gelstereo.tune.takes import Takes, recorded_takes, simulated_takes

__all__ = ["EXAMPLES", "add_arguments", "run", "scene_part"]

EXAMPLES = """examples:
  gelstereo tune --scene scenes/grasp_cylinder.toml --budget-ms 2                  sensing only, within 2 ms
  gelstereo tune --scene scenes/usb_plug.toml --part own --success 99              the cheapest that succeeds
  gelstereo tune --sensor cell/sensor.toml --recording run.mcap --error-um 10      your sensor, your presses
  gelstereo tune --sensor cell/sensor.toml --recording press --part peg.stl --units mm \\
      --guess-mm 4 0 30.7 --guess-deg 0 90 0 --success 99 --budget-ms 20

The settings are written as TOML for `--params` and `Params.load`, with what they are expected to do. The exit
code is 1 where no setting reaches the goal, or frames that tuning did not see do not confirm the result.
"""

#: Value of --part for the scene's own part.
_OWN = "own"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--sensor", type=Path, metavar="FILE", help="sensor file of `gelstereo setup`")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--recording",
        type=Path,
        metavar="PATH",
        help="presses: an MCAP file with images, or a folder of stereo images; it begins at rest",
    )
    source.add_argument(
        "--scene", type=Path, metavar="FILE", help="scene to simulate; on the sensor, if one is given"
    )
    goal = parser.add_argument_group("goal", "at least one; all are kept")
    goal.add_argument("--budget-ms", type=float, metavar="MS", help="largest time of a frame")
    goal.add_argument(
        "--error-um",
        type=float,
        metavar="UM",
        help="largest rms error: of a marker's depth, or with a part of its pose at the patch's radius",
    )
    goal.add_argument("--success", type=float, metavar="PERCENT", help="least success of registration")
    part = parser.add_argument_group("part", "without one, only sensing is tuned")
    part.add_argument("--part", metavar="MESH", help="mesh or .template of the part; own: that of the scene")
    part.add_argument("--units", choices=list(MM_PER_UNIT), help="unit of the mesh; STEP files say it")
    part.add_argument(
        "--tolerance-mm",
        type=float,
        default=Part.tolerance_mm,
        help="pose error up to which a registration succeeds (%(default)s)",
    )
    part.add_argument(
        "--guess-error",
        type=float,
        nargs=2,
        default=(Part.guess_error_deg, Part.guess_error_mm),
        metavar=("DEG", "MM"),
        help="largest error of guesses from which it must succeed (5 1)",
    )
    add_guess(parser)
    parser.add_argument("--takes", type=_takes, default=12, metavar="N", help=_TAKES_HELP)
    parser.add_argument(
        "--output", type=Path, default=Path("tuned.toml"), metavar="FILE", help="settings (%(default)s)"
    )
    parser.add_argument(
        "--cache", type=Path, metavar="DIR", help="folder of kept measurements (the user's cache folder)"
    )
    parser.add_argument(
        "--measure-again", action="store_true", help="replace kept measurements instead of using them"
    )


_TAKES_HELP = "pieces of the recording, or simulations of the scene; a third is held out (%(default)s)"


def run(arguments: argparse.Namespace) -> int:
    """Tune, print and write the settings; return the exit code."""
    goal = Goal(arguments.budget_ms, arguments.error_um, arguments.success)
    goal.check(arguments.part is not None)
    sensor = None if arguments.sensor is None else load_sensor(arguments.sensor)
    base = Params.preset("balanced") if sensor is None else sensor.params
    part = _part(arguments)
    source, takes = _takes_of(arguments, sensor)
    conditions = conditions_of(takes, base, part)
    name = file_name(source, arguments.part or "", conditions)
    laboratory = laboratory_of(
        takes,
        base,
        part,
        cache=(arguments.cache or default_folder()) / name,
        measure_again=arguments.measure_again,
    )
    tuned = tune(laboratory, goal)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(tuned.to_toml(conditions), encoding="utf-8")
    print(f"{tuned}\nwrote {arguments.output}")
    return 0 if tuned.is_reached and tuned.is_confirmed else 1


def _takes_of(arguments: argparse.Namespace, sensor: Sensor | None) -> tuple[Path, Takes]:
    if arguments.scene is not None:
        scene = Scene.load(arguments.scene)
        return arguments.scene, simulated_takes(scene, arguments.takes, sensor=sensor)
    if sensor is None:
        raise TuneError(
            "a recording needs its sensor: add --sensor sensor.toml, written by `gelstereo setup`"
        )
    return arguments.recording, recorded_takes(arguments.recording, sensor, arguments.takes)


def _part(arguments: argparse.Namespace) -> Part | None:
    if arguments.part is None:
        return None
    template = _template(arguments).with_symmetries()
    guess = None if arguments.scene is not None else guess_of(arguments)
    return Part(template, guess, arguments.tolerance_mm, *arguments.guess_error)


def _template(arguments: argparse.Namespace) -> Template:
    if arguments.part == _OWN:
        if arguments.scene is None:
            raise TuneError("only a scene has a part of its own; give --part the part's mesh")
        return scene_part(arguments.scene)
    path = Path(arguments.part)
    if path.suffix == ".template":
        return Template.load(path)
    return Template.from_mesh(path, units=arguments.units)


def scene_part(path: Path) -> Template:
    """Template of a scene's part.

    Raises
    ------
    TuneError
        It has none.
    """
    shape = Scene.load(path).to_dict().get("indenter")
    if shape is None:
        raise TuneError(f"the scene {path} has no part; add [indenter], or leave out --part")
    if shape["kind"] == "mesh":
        return Template.from_mesh(path.parent / shape["path"], units=shape["units"])
    return Template.from_triangles(*shape_mesh(shape))


def _takes(text: str) -> int:
    if not text.isdecimal() or int(text) < 2:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of takes; valid is an integer of 2 or more")
    return int(text)
