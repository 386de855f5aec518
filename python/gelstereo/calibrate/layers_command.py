"""The command `gelstereo calibrate-layers`."""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

from gelstereo import Frame, Pipeline, PitchWarning, Rig
from gelstereo.cli.files import read_image
from gelstereo.cli.options import add_params, params_of

from .errors import CalibrationError
from .layers import LayersCalibration, SeatedFrame, calibrate_layers

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo calibrate-layers --rig rig.toml --rest left0.png right0.png --board 0.8 left1.png right1.png \\
      --board 1.8 left2.png right2.png --prior plate_0_thickness_mm=0.05 \\
      --prior plate_0_index=0.005 --out gel.toml

The rig file holds the cameras as calibrated in air, and under [layers] the layers as designed. Nothing
touches the gel in --rest; in --board it is seated on a flat board of that protrusion in mm. Boards make the
gel's index known, the higher the better; thickness and index of a plate need priors. The exit code is 1 where
the frames contradict the model (doubts of kind pitch, prior, misfit or print); the rig file is written all
the same.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--rig", type=Path, required=True, help="cameras, with the layers as designed (TOML)")
    parser.add_argument(
        "--rest",
        nargs=2,
        action="append",
        type=Path,
        required=True,
        metavar=("LEFT", "RIGHT"),
        help="at rest",
    )
    parser.add_argument(
        "--board", nargs=3, action="append", default=[], metavar=("MM", "LEFT", "RIGHT"), help="on a board"
    )
    parser.add_argument(
        "--prior",
        type=prior,
        action="append",
        default=[],
        metavar="NAME=SIGMA",
        help="what is known beforehand",
    )
    parser.add_argument(
        "--pitch-sigma-mm",
        type=float,
        help="tolerance of lattice.pitch_mm (half a per cent of it if left out)",
    )
    parser.add_argument("--out", type=Path, help="rig file to write (TOML)")
    add_params(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, print the report, and write the rig file; return the exit code."""
    found = calibrate_images(arguments)
    print(found.summary())
    if arguments.out is not None:
        found.rig.save(arguments.out)
        print(f"wrote {arguments.out}")
    if found.doubts:
        kinds = ", ".join(sorted({doubt.kind for doubt in found.doubts}))
        print(f"gelstereo: the frames contradict the layers found ({kinds}); see the report", file=sys.stderr)
        return 1
    return 0


def calibrate_images(arguments: argparse.Namespace) -> LayersCalibration:
    """Calibrate from the images named by the arguments."""
    rig, params = Rig.load(arguments.rig), params_of(arguments)
    if rig.layers is None:
        raise CalibrationError(f"{arguments.rig} has no [layers]; add their design values")
    pipeline = Pipeline(rig, params)

    def frame(left: Path, right: Path) -> Frame:
        with warnings.catch_warnings():
            # The layers are not yet known, and the pitch is checked with those that are found.
            warnings.simplefilter("ignore", PitchWarning)
            return pipeline.process(read_image(left), read_image(right))

    frames = [SeatedFrame.from_frame(frame(*pair)) for pair in arguments.rest]
    for height, left, right in sorted(arguments.board, key=lambda board: protrusion(board[0])):
        frames.append(SeatedFrame.from_frame(frame(Path(left), Path(right)), protrusion(height)))
    tree = params.to_dict()
    return calibrate_layers(
        rig,
        frames,
        pitch_mm=tree["lattice"]["pitch_mm"],
        pitch_sigma_mm=arguments.pitch_sigma_mm,
        priors=dict(arguments.prior),
        sigma_px=tree["detect"]["centre_sigma_px"],
    )


def prior(text: str) -> tuple[str, float]:
    """Parse name and standard deviation, for example ``gap_mm=0.5``."""
    name, _, sigma = text.partition("=")
    try:
        return name, float(sigma)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a prior; write NAME=SIGMA, for example gap_mm=0.5"
        ) from None


def protrusion(text: str) -> float:
    """A board's protrusion, mm."""
    try:
        height_mm = float(text)
    except ValueError:
        height_mm = float("nan")
    if not height_mm > 0.0:
        raise CalibrationError(
            f"the board's protrusion is {text!r} mm; valid is a number above 0, then its two images"
        )
    return height_mm
