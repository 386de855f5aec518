"""The command `gelstereo frontier`."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import cv2

from gelstereo.frontier.page import draw, write_page
from gelstereo.frontier.registering import measure_registration
from gelstereo.frontier.sensing import measure_boards, measure_detection, measure_labels, measure_whole
from gelstereo.frontier.timing import InstructionCounter

__all__ = ["EXAMPLES", "add_arguments", "run"]

EXAMPLES = """examples:
  gelstereo frontier                     measure everything and write docs/accuracy-vs-time.md (minutes)
  gelstereo frontier --quick --docs out  a few rounds, to see that all methods run
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--docs", type=Path, default=Path("docs"), help="folder with the page accuracy-vs-time.md"
    )
    parser.add_argument("--quick", action="store_true", help="few rounds and starts: figures mean little")
    parser.add_argument("--rounds", type=count, help="rounds of timing (default 200, quick 3)")
    parser.add_argument("--starts", type=count, help="starts of registration per part (default 64, quick 4)")
    parser.add_argument("--no-instructions", action="store_true", help="do not run callgrind")


def count(text: str) -> int:
    """A whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no count; valid is a whole number from 1 on")
    return int(text)


def run(arguments: argparse.Namespace) -> int:
    """Measure every rung, print progress, and write the page and its figure; return the exit code."""
    rounds = arguments.rounds or (3 if arguments.quick else 200)
    starts = arguments.starts or (4 if arguments.quick else 64)
    pictures = arguments.docs / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)  # before the minutes that measuring takes
    source = None if arguments.no_instructions or arguments.quick else Path.cwd()
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        counter = InstructionCounter(source)
        rows = measure_detection(rounds, counter, _report)
        rows += measure_labels(rounds, counter, _report)
        rows += measure_whole(rounds, counter, _report)
        rows += measure_registration(max(rounds // 4, 2), starts, counter, _report)
        boards = measure_boards(1 if arguments.quick else 5, _report)
    finally:
        cv2.setNumThreads(threads)
    write_page(arguments.docs / "accuracy-vs-time.md", rows, boards, rounds)
    draw(pictures / "accuracy-vs-time.png", rows)
    print(f"wrote {arguments.docs / 'accuracy-vs-time.md'} and {pictures / 'accuracy-vs-time.png'}")
    return 0


def _report(what: str) -> None:
    """Print progress with the time of day."""
    print(f"{time.strftime('%H:%M:%S')} {what}", file=sys.stderr, flush=True)
