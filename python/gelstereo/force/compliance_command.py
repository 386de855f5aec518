"""The command ``gelstereo compliance``."""

from __future__ import annotations

import argparse
from pathlib import Path

from gelstereo.force.compliance import compute_compliance
from gelstereo.progress import Progress

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo compliance --rows 25 --cols 25 --pitch-mm 0.9 --thickness-mm 3 --rim-mm 1.5
  gelstereo compliance --rows 9 --cols 14 --pitch-mm 1 --thickness-mm 2 --rim-mm 1 2.5 --output my.compliance

The host's configuration names the file: compliance_file = "gel.compliance". In Python: gs.Compliance.load.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--rows", type=int, required=True, metavar="N", help="markers from top to bottom")
    parser.add_argument("--cols", type=int, required=True, metavar="N", help="markers from left to right")
    parser.add_argument(
        "--pitch-mm", type=float, required=True, metavar="MM", help="distance of neighbouring markers"
    )
    parser.add_argument(
        "--thickness-mm", type=float, required=True, metavar="MM", help="thickness of the gel"
    )
    parser.add_argument(
        "--rim-mm",
        type=float,
        required=True,
        nargs="+",
        metavar="MM",
        help="gel beyond the outermost markers: one number, or one along rows and one along columns",
    )
    parser.add_argument(
        "--poisson-ratio", type=float, default=0.48, metavar="NU", help="of the gel (%(default)s)"
    )
    parser.add_argument(
        "--elements-per-pitch", type=int, default=1, metavar="N", help="of the mesh, 1 to 4 (%(default)s)"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("gel.compliance"), metavar="FILE", help="matrix (%(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Compute the matrix and write it; return the exit code."""
    with Progress("computing") as progress:
        made = compute_compliance(
            rows=arguments.rows,
            cols=arguments.cols,
            pitch_mm=arguments.pitch_mm,
            thickness_mm=arguments.thickness_mm,
            poisson_ratio=arguments.poisson_ratio,
            rim_mm=arguments.rim_mm,
            elements_per_pitch=arguments.elements_per_pitch,
            progress=progress,
        )
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    made.save(arguments.output)
    print(f"wrote {arguments.output}: {made.rows} x {made.cols} markers")
    return 0
