"""The command `gelstereo experiment`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gelstereo.cli.extras import module_of
from gelstereo.cli.options import count
from gelstereo.progress import Progress
from gelstereo_bench.experiments.experiment import Experiment, carry_out

__all__ = ["EXAMPLES", "EXPERIMENTS", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo experiment boards --output out/boards                  Table I and Fig. 14 of the paper
  gelstereo experiment boards --output out/boards --resume         go on where it was interrupted
  gelstereo experiment objects --output out/objects --workers 4    Fig. 12, on four processes
  gelstereo experiment insertion --output out/insertion --trials 1000 --workers 2
  gelstereo experiment boards --output out/boards --scheduler tcp://10.0.0.2:8786

All write report.html into the output folder: one file with its figures inside, for reading without a network.
"""

#: Every experiment is a module with an `Experiment` named ``EXPERIMENT``.
EXPERIMENTS = {
    "boards": (
        "gelstereo_bench.experiments.boards",
        "height of boards pressed into the gel (Table I, Fig. 14)",
    ),
    "objects": ("gelstereo_bench.experiments.objects", "objects pressed into the gel, and located (Fig. 12)"),
    "insertion": (
        "gelstereo_bench.experiments.insertion",
        "grasp, localize, insert (Tables II and III, Fig. 15)",
    ),
    "insertion-physics": (
        "gelstereo_bench.experiments.insertion.physics_check",
        "insertions judged by geometry against contact physics (extra physics)",
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    said = "; ".join(f"{name}: {summary}" for name, (_, summary) in EXPERIMENTS.items())
    parser.add_argument("experiment", choices=sorted(EXPERIMENTS), help=said)
    parser.add_argument(
        "--output", type=Path, required=True, metavar="FOLDER", help="folder for report.html and the trials"
    )
    parser.add_argument(
        "--trials", type=count, metavar="N", help="trials of every case (as many as the paper's)"
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of all trials (%(default)s)")
    who = parser.add_mutually_exclusive_group()
    who.add_argument("--workers", type=count, default=1, metavar="N", help="processes (%(default)s)")
    who.add_argument("--scheduler", metavar="ADDRESS", help="a dask scheduler, whose workers run the trials")
    parser.add_argument("--page", type=Path, metavar="FILE", help="Markdown page to fill the summary in")
    parser.add_argument("--resume", action="store_true", help="use the trials that the folder already holds")


def experiment_of(name: str) -> Experiment:
    """Look up an experiment by name."""
    found: Experiment = module_of(f"gelstereo experiment {name}", EXPERIMENTS[name][0]).EXPERIMENT
    return found


def run(arguments: argparse.Namespace) -> int:
    """Run the experiment; return the exit code."""
    experiment = experiment_of(arguments.experiment)
    with Progress(experiment.name) as progress:
        try:
            done = carry_out(
                experiment,
                arguments.output,
                repeats=arguments.trials,
                seed=arguments.seed,
                workers=arguments.workers,
                scheduler_address=arguments.scheduler,
                resume=arguments.resume,
                progress=progress,
                page=arguments.page,
            )
        except KeyboardInterrupt:
            if progress.done:
                print(
                    f"\n{progress.done} of {progress.total} trials are kept in {arguments.output}; --resume "
                    "goes on",
                    file=sys.stderr,
                )
            raise
    print(f"report     {done.report} ({done.trials} trials)")
    print(f"SHA-256    {done.digest}")
    return 0
