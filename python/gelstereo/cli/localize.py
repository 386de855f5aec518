"""The command ``gelstereo localize``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from gelstereo import Localization, Template, localize
from gelstereo.cli.options import add_guess, add_params, guess_of, params_of
from gelstereo.cli.sense import sense_folder
from gelstereo.point_files import read_points
from gelstereo.templates import MM_PER_UNIT

EXAMPLES = """examples:
  gelstereo localize --points patch.npy --template peg.stl --units mm --guess-mm 4 0 30.7 --guess-deg 0 90 0
  gelstereo localize --images out/press --rig rig.toml --template plug.stl --units m --guess-mm 4 0 31

Points are millimetres in the sensor frame (x right, y down, z away from the camera). With images, the first
pair is the rest frame and the contact of the last one is localized. The pose is printed as JSON. The exit
code is 1 where the part does not explain the contact.
"""

DOES_NOT_FIT = (
    "the part does not explain the contact (log_odds {odds:.1f}, a part that does has more than 4.6): it is "
    "another part, another face of it, or farther from the guess than register.start_sigma_deg and "
    "register.start_sigma_mm say"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--points",
        type=Path,
        metavar="FILE",
        help="contact patch, in mm: .npy, .ply, .pcd, .csv, .txt or .xyz",
    )
    source.add_argument(
        "--images", type=Path, metavar="FOLDER", help="stereo images: left/NAME.png, right/NAME.png"
    )
    parser.add_argument("--rig", type=Path, help="rig file of the images; FOLDER/rig.toml if left out")
    parser.add_argument(
        "--template", type=Path, required=True, metavar="MESH", help="mesh of the part, or a saved .template"
    )
    parser.add_argument("--units", choices=list(MM_PER_UNIT), help="unit of the mesh; STEP files say it")
    parser.add_argument(
        "--spacing-mm", type=float, default=0.25, help="distance of template points (%(default)s)"
    )
    parser.add_argument("--output", type=Path, metavar="FILE", help="JSON file to write instead of printing")
    add_guess(parser)
    add_params(parser)


def run(arguments: argparse.Namespace) -> int:
    """Localize and print the pose; return the exit code."""
    params = params_of(arguments)
    template = _template(arguments)
    guess = guess_of(arguments)
    if arguments.points is not None:
        found = localize(read_points(arguments.points), template, guess=guess, params=params)
    else:
        frame = sense_folder(arguments.images, arguments.rig, params).frame
        found = localize(frame, template, guess=guess, params=params)
    text = json.dumps(as_json(found), indent=2)
    if arguments.output is None:
        print(text)
    else:
        arguments.output.write_text(text + "\n")
    if found.verdict == "does_not_fit":
        print(f"gelstereo: {DOES_NOT_FIT.format(odds=found.log_odds)}", file=sys.stderr)
        return 1
    return 0


def _template(arguments: argparse.Namespace) -> Template:
    if arguments.template.suffix == ".template":
        return Template.load(arguments.template)
    return Template.from_mesh(arguments.template, units=arguments.units, spacing_mm=arguments.spacing_mm)


def as_json(found: Localization) -> dict[str, Any]:
    """All results of a localization, for JSON."""
    return {
        "t_sensor_object": found.t_sensor_object.tolist(),
        "information": found.information.tolist(),
        "covariance": found.covariance.tolist(),
        "determined_covariance": found.determined_covariance.tolist(),
        "converged": found.converged,
        "iterations": found.iterations,
        "inliers": found.inliers,
        "points": found.points,
        "rmse_mm": found.rmse_mm,
        "free": [str(direction) for direction in found.free],
        "log_likelihood": found.log_likelihood,
        "verdict": found.verdict,
        "model": found.model,
        "log_odds": found.log_odds,
        "gel_decay_mm": found.gel_decay_mm,
        "gel_decay_at_limit": found.gel_decay_at_limit,
        "alternatives": [
            {"t_sensor_object": pose.tolist(), "log_likelihood": likelihood}
            for pose, likelihood in found.alternatives
        ],
        "alternatives_cut": found.alternatives_cut,
        "digest": f"{found.digest:016x}",
    }
