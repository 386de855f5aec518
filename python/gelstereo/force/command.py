"""The command ``gelstereo calibrate-force``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gelstereo.force.fit import calibrate, percent
from gelstereo.force.loads import Load, LoadsError, read_loads
from gelstereo.force.pressed import pressed_frames, recorded_pairs
from gelstereo.force.report import thickness, write_report
from gelstereo.force.resultant import ResultantCalibration, calibrate_resultant
from gelstereo.setup.sensor import load_sensor

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo calibrate-force loads.csv run.mcap --sensor cell/sensor.toml --thickness-mm 4
  gelstereo calibrate-force loads.csv run.mcap --sensor cell/sensor.toml --thickness-mm 4 --fit-poisson
  gelstereo calibrate-force loads.csv run.mcap --sensor cell/sensor.toml --thickness-mm 4 --method resultant

loads.csv says what lay on the gel, and when since the first frame:

  start_s,end_s,mass_g
  3,8,50
  12,17,100
  21,26,50

The settings are written as TOML for `--params` and `Params.load`, and a report beside them.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("loads", type=Path, metavar="LOADS.csv", help="known loads and their times")
    parser.add_argument(
        "recording", type=Path, metavar="RUN.mcap", help="recording with images; it begins at rest"
    )
    parser.add_argument(
        "--sensor", type=Path, required=True, metavar="FILE", help="sensor file of `gelstereo setup`"
    )
    parser.add_argument(
        "--thickness-mm", type=float, required=True, metavar="MM", help="thickness of the gel"
    )
    parser.add_argument(
        "--method",
        choices=["layer", "resultant"],
        default="layer",
        help="of the wrench: an elastic layer, or sums of the motion without a model (%(default)s)",
    )
    poisson = parser.add_mutually_exclusive_group()
    poisson.add_argument(
        "--poisson-ratio", type=float, default=0.48, metavar="NU", help="of the gel (%(default)s)"
    )
    poisson.add_argument(
        "--fit-poisson",
        action="store_true",
        help="find it too; needs parts of different widths, or shear beside pressure",
    )
    parser.add_argument(
        "--fit-thickness",
        action="store_true",
        help="find it too, near the given one; needs parts of different widths",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("force.toml"), metavar="FILE", help="settings (%(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, print the figures, and write settings and report; return the exit code."""
    if arguments.method == "resultant" and (arguments.fit_poisson or arguments.fit_thickness):
        raise LoadsError("--method resultant has no layer; leave out --fit-poisson and --fit-thickness")
    loads = read_loads(arguments.loads)
    sensor = load_sensor(arguments.sensor)

    def progress(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r{text}", end="", file=sys.stderr, flush=True)

    rest, frames = pressed_frames(recorded_pairs(arguments.recording), sensor, loads, progress)
    if arguments.method == "resultant":
        without_layer = calibrate_resultant(rest, frames, loads, sensor, thickness_mm=arguments.thickness_mm)
        return _resultant(arguments, loads, without_layer)
    found = calibrate(
        rest,
        frames,
        loads,
        sensor,
        thickness_mm=arguments.thickness_mm,
        poisson_ratio=None if arguments.fit_poisson else arguments.poisson_ratio,
        fits_thickness=arguments.fit_thickness,
    )
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(found.to_toml(), encoding="utf-8")
    page = arguments.output.with_suffix(".html")
    write_report(page, found)
    print(
        f"Young's modulus {found.young_kpa:.1f} +- {found.young_sigma_kpa:.1f} kPa, Poisson's ratio "
        f"{found.poisson_ratio:g}, thickness {thickness(found)}\n"
        f"rms error of a load that was left out: {percent(found.left_out_rms)}\n"
        f"hysteresis: {percent(found.hysteresis)}\n"
        f"wrote {arguments.output} and {page}"
    )
    return _cut([str(result.load) for result in found.results if result.is_cut])


def _resultant(arguments: argparse.Namespace, loads: list[Load], found: ResultantCalibration) -> int:
    """Write what was found without a layer, and print its figures."""
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(found.to_toml(), encoding="utf-8")
    print(
        f"stiffness {found.patch_n_per_mm3:.4g} N/mm3 under the part, {found.around_n_per_mm3:.4g} under and "
        f"around it, {found.shear_n_per_mm3:.4g} along the gel"
    )
    for load, error in zip(loads, found.left_out, strict=True):
        print(f"{load}: error without it {percent(error)}")
    print(f"rms error of a load that was left out: {percent(found.left_out_rms)}\nwrote {arguments.output}")
    return _cut([str(load) for load, is_cut in zip(loads, found.is_cut, strict=True) if is_cut])


def _cut(loads: list[str]) -> int:
    """The exit code, after a warning of loads that reach the border."""
    if loads:
        print(f"the contact reaches the print's border, so that forces are missing: {'; '.join(loads)}")
    return 1 if loads else 0
