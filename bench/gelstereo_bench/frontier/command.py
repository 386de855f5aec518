"""The command `gelstereo frontier`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import cv2

from gelstereo import Error
from gelstereo.cli.options import count
from gelstereo_bench.frontier.boards import measure_boards
from gelstereo_bench.frontier.building import measure_building
from gelstereo_bench.frontier.centres import CONDITIONS, measure_centres
from gelstereo_bench.frontier.cost import (
    cost_table,
    fit_costs,
    measure_costs,
    measure_times,
    rust_lines,
    time_table,
)
from gelstereo_bench.frontier.cost_reflections import FITTED, measure_reflections, reflection_table
from gelstereo_bench.frontier.cost_registration import (
    measure_registration_costs,
    registration_line,
    registration_table,
)
from gelstereo_bench.frontier.covariance import measure_covariance
from gelstereo_bench.frontier.deadlines import deadline_table, measure_deadlines
from gelstereo_bench.frontier.figures import draw_errors, draw_growth
from gelstereo_bench.frontier.grasps import GRASPED, NOISES
from gelstereo_bench.frontier.localization import measure_localization
from gelstereo_bench.frontier.nearest import measure_nearest
from gelstereo_bench.frontier.page import (
    LOCALIZATION_SECTIONS,
    SECTIONS,
    check_page,
    row_tables,
    write_page,
    write_tables,
)
from gelstereo_bench.frontier.registering import measure_registration
from gelstereo_bench.frontier.saliency import measure_saliency
from gelstereo_bench.frontier.scenes import LATTICES
from gelstereo_bench.frontier.sensing import Row, measure_detection, measure_labels, measure_whole
from gelstereo_bench.frontier.sequences import SEQUENCES
from gelstereo_bench.frontier.speed import (
    Speed,
    growth_table,
    measure_speed,
    measure_threads,
    speed_table,
    speed_targets,
    stage_table,
)
from gelstereo_bench.frontier.table import Report, Table, Target
from gelstereo_bench.frontier.timing import InstructionCounter
from gelstereo_bench.frontier.tracking import measure_tracking
from gelstereo_bench.frontier.tuning import SCENES, measure_tuning

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo frontier                     measure everything and write docs/accuracy-vs-time.md (minutes)
  gelstereo frontier localization        registration beside other libraries: docs/localization.md
  gelstereo frontier cost                instructions over image size, markers and faces: the cost model
  gelstereo frontier deadlines           how often deadlines are kept beside another process
  gelstereo frontier tuning              the tuner beside exhaustive search and Optuna: docs/tuning.md
  gelstereo frontier pipeline            whole pipelines beside other libraries: the picture of the price of
                                         accuracy; goes on where it was interrupted
  gelstereo frontier --quick --docs out  a few rounds, to see that all methods run
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "topic",
        nargs="?",
        choices=("sensing", "localization", "pipeline", "cost", "deadlines", "tuning"),
        default="sensing",
        help="what is measured",
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder with the pages")
    parser.add_argument("--quick", action="store_true", help="few rounds and starts: figures mean little")
    parser.add_argument("--rounds", type=count, help="rounds of timing (default 200, quick 3)")
    parser.add_argument("--starts", type=count, help="starts of registration per part (default 64, quick 4)")
    parser.add_argument(
        "--results",
        type=Path,
        default=Path("out/frontier"),
        help="folder where the topic pipeline keeps finished measurements",
    )
    parser.add_argument(
        "--no-instructions",
        action="store_true",
        help="run neither callgrind nor the core's own timing program; of the topic cost, only the times",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure every rung, print progress, and write the page and its figures; return the exit code."""
    rounds = arguments.rounds or (3 if arguments.quick else 200)
    starts = arguments.starts or (4 if arguments.quick else 64)
    (arguments.docs / "pictures").mkdir(parents=True, exist_ok=True)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        if arguments.topic == "pipeline":
            return _pipeline(arguments)
        if arguments.topic == "localization":
            return _localization(arguments, rounds, starts)
        if arguments.topic == "cost":
            return _cost(arguments)
        if arguments.topic == "deadlines":
            return _deadlines(arguments)
        if arguments.topic == "tuning":
            return _tuning(arguments.docs / "tuning.md", arguments.quick)
        return _sensing(arguments, rounds, starts)
    finally:
        cv2.setNumThreads(threads)


def _sensing(arguments: argparse.Namespace, rounds: int, starts: int) -> int:
    page, pictures = arguments.docs / "accuracy-vs-time.md", arguments.docs / "pictures"
    check_page(page, SECTIONS)
    source = None if arguments.no_instructions or arguments.quick else Path.cwd()
    rows = _rows(rounds, starts, InstructionCounter(source), _report)
    tables, targets, speeds = _tables(arguments.quick, rounds, source, _report)
    write_page(page, [*row_tables(rows), *tables], targets, rounds)
    draw_errors(pictures / "accuracy-vs-time.png", rows, CONDITIONS[0].bound_px())
    draw_growth(pictures / "time-over-size.png", speeds)
    return _done(page, targets)


def _localization(arguments: argparse.Namespace, rounds: int, starts: int) -> int:
    page = arguments.docs / "localization.md"
    check_page(page, LOCALIZATION_SECTIONS)
    # Cost differs between parts and noise levels, so all contacts are used.
    rounds = max(rounds, starts * len(GRASPED) * len(NOISES))
    tables, targets = measure_localization(range(1, 1 + starts), rounds, _report)
    said = (
        f"simulated, {starts} contacts of each part and noise, markers every 0.9 mm, gel shoulder and "
        "spread; fixed seeds"
    )
    write_page(page, tables, targets, rounds, said)
    return _done(page, targets)


def _cost(arguments: argparse.Namespace) -> int:
    page = arguments.docs / "accuracy-vs-time.md"
    source, quick = Path.cwd(), arguments.quick
    check_page(page, ("cost", "cost-reflections", "cost-registration", "cost-times"))
    timed = measure_times(source, _report, quick)
    write_tables(page, time_table(timed))
    if arguments.no_instructions:
        print(f"wrote the times into {page}")
        return 0
    samples, reflections = measure_costs(source, _report, quick), measure_reflections(source, _report, quick)
    samples += [sample for (_, name), sample in reflections.items() if name == FITTED]
    cost = fit_costs(samples)
    registered = measure_registration_costs(source, _report, quick)
    write_tables(
        page,
        cost_table(samples, cost),
        reflection_table(reflections, cost),
        registration_table(registered),
    )
    print(f"registration: {registration_line(registered)}")
    print(f"wrote {page}; for crates/gelstereo-core/src/pipeline/work.rs:\n{rust_lines(cost)}")
    return 0


def _deadlines(arguments: argparse.Namespace) -> int:
    page = arguments.docs / "accuracy-vs-time.md"
    check_page(page, ("deadlines",))
    found = measure_deadlines(500 if arguments.quick else 100_000, _report)
    write_tables(page, deadline_table(found))
    late = [kept for kept in found if kept.late_share > 0.001]
    print(f"wrote {page}; {len(found) - len(late)} of {len(found)} deadlines kept in 99.9 % of the frames")
    return 0


def _tuning(page: Path, is_quick: bool) -> int:
    check_page(page, ["tuning"])
    found = measure_tuning(_report, SCENES[:1] if is_quick else SCENES, seeds=1 if is_quick else 5)
    write_tables(page, found)
    print(f"wrote {page}")
    return 0


def _pipeline(arguments: argparse.Namespace) -> int:
    # Imported here, because other topics need none of it.
    from gelstereo_bench.frontier.pipeline.topic import FULL, QUICK, run_pipeline

    if arguments.rounds or arguments.starts:
        raise Error(
            "--rounds and --starts do not apply to the topic pipeline, which has fixed seeds and guesses; "
            "--quick measures fewer"
        )
    page = run_pipeline(arguments.docs, arguments.results, QUICK if arguments.quick else FULL)
    print(f"wrote {page} and its pictures; {arguments.results} holds the measurements")
    return 0


def _done(page: Path, targets: Sequence[Target]) -> int:
    missed = [target for target in targets if not target.met]
    print(f"wrote {page} and its figures; {len(targets) - len(missed)} of {len(targets)} targets met")
    return 0


def _rows(rounds: int, starts: int, counter: InstructionCounter, report: Report) -> list[Row]:
    """Error beside time, rung by rung."""
    rows = measure_detection(rounds, counter, report)
    rows += measure_labels(rounds, counter, report)
    rows += measure_whole(rounds, counter, report)
    return rows + measure_registration(max(rounds // 4, 2), starts, counter, report)


def _tables(
    quick: bool, rounds: int, source: Path | None, report: Report
) -> tuple[list[Table], list[Target], list[Speed]]:
    """All other tables, the targets, and the times for the figures."""
    seeds = 1 if quick else 3
    centres, targets, matches = measure_centres(seeds, report)
    covariance, more = measure_covariance(matches, seeds, report)
    targets += more
    tracking, more = measure_tracking(report, SEQUENCES[:1] if quick else SEQUENCES)
    targets += more
    speeds = measure_speed(rounds, source, report, LATTICES[:1] if quick else LATTICES)
    targets += speed_targets(speeds)
    saliency, more = measure_saliency(1 if quick else 12, report)
    targets += more
    boards, more = measure_boards(1 if quick else 5, report)
    targets += more
    nearest, more = measure_nearest(max(rounds // 20, 2), report)
    targets += more
    templates, more = measure_building(1 if quick else 3, report)
    targets += more
    tables = [centres, covariance, tracking, speed_table(speeds), stage_table(speeds), growth_table(speeds)]
    return (
        [*tables, measure_threads(rounds // 2, report), saliency, *boards, nearest, templates],
        targets,
        speeds,
    )


def _report(what: str) -> None:
    """Print progress with the time of day."""
    print(f"{time.strftime('%H:%M:%S')} {what}", file=sys.stderr, flush=True)
