"""Time moving frames with a tray in view, compared with OpenCV: `python -m outside.speed`.

Each sequence's pairs are played forwards and backwards, so consecutive frames differ. The core's own program
is timed; it needs cargo and the sources. OpenCV is `gelstereo_bench.frontier.baseline_fast`, in the same run
and alternating with the presets. Its threshold is set by hand, and it receives the markers' true positions at
rest.

- tracking, ms: tracked frame, median;
- afresh, ms: the same frames, each labelled as a first one;
- speed-up over OpenCV: OpenCV's time divided by this.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import gelstereo
from gelstereo_bench.frontier.baseline_fast import FastBaseline
from gelstereo_bench.frontier.runners import geometry_of, write_input
from gelstereo_bench.frontier.timing import Stopwatch, Times

from .images import Condition, Sequence, names

REPOSITORY = Path(__file__).parents[2]
PRESETS = ("fast", "balanced", "exact")
BASELINE = "OpenCV"
# Consecutive calls before switching to another method.
BURST = 5
# Levels below the box background; a run ends where it loses more than a tenth of the markers.
THRESHOLD_LEVELS = 12

Call = Callable[[str, int], list[int]]


def baseline(sequence: Sequence, pairs: list[SimpleNamespace]) -> Call:
    """OpenCV's times over the frames, forwards and backwards."""
    settings = gelstereo.Params.preset("balanced").replace({"lattice.pitch_mm": sequence.about["pitch_mm"]})
    params = settings.to_dict()
    params["detect"] |= {"threshold_levels": THRESHOLD_LEVELS, "min_area_px2": 12}
    fast = FastBaseline(geometry_of(gelstereo.Rig.from_toml(sequence.about["rig"])), params)
    rest_px = (sequence.truth["left_px"][0], sequence.truth["right_px"][0])
    fast.process(pairs[0].left, pairs[0].right, rest_px)
    way = [*range(len(pairs)), *range(len(pairs) - 2, 0, -1)]
    turns = iter(range(2**62))

    def times_ns(_: str, calls: int) -> list[int]:
        taken = []
        for _ in range(calls):
            pair = pairs[way[next(turns) % len(way)]]
            begin = time.perf_counter_ns()
            found = fast.process(pair.left, pair.right)
            taken.append(time.perf_counter_ns() - begin)
            if found.seen.mean() < 0.9:
                raise SystemExit(f"{sequence.name}: OpenCV lost markers; this is no comparison")
        return taken

    return times_ns


def measure(sequence: Sequence, rounds: int, program: Path) -> dict[str, dict[str, Times]]:
    """Times by method and stage."""
    pairs = [
        SimpleNamespace(left=left, right=right, index=index)
        for index, (left, right) in enumerate(sequence.pair(i, Condition()) for i in range(len(sequence)))
    ]
    taken: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    with contextlib.ExitStack() as stack:
        calls = {BASELINE: baseline(sequence, pairs)}
        for preset in PRESETS:
            params = gelstereo.Params.preset(preset).replace({"lattice.pitch_mm": sequence.about["pitch_mm"]})
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            files = write_input(folder, params, pairs, gelstereo.Rig.from_toml(sequence.about["rig"]))
            calls[preset] = stack.enter_context(Stopwatch(program, files)).times_ns
        for turn in range(-1, max(1, rounds // BURST)):
            for name, call in calls.items():
                for stage in ("track",) if name == BASELINE else ("track", "afresh"):
                    times_ns = call(stage, BURST)
                    if turn >= 0:
                        taken[name][stage] += times_ns
    return {name: {s: Times.of(ns) for s, ns in stages.items()} for name, stages in taken.items()}


def main() -> int:
    """Print one row for each sequence and preset."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--half", choices=("w", "j"), default="w", help="w: for work, j: judged")
    parser.add_argument("--rounds", type=int, default=60, help="calls of each stage")
    options = parser.parse_args()
    program = Stopwatch.program(REPOSITORY)
    if program is None:
        parser.error("the core's program cannot be built: it needs cargo and the sources")
    head = ("sequence", "preset", "OpenCV, ms", "tracking, ms", "speed-up over OpenCV", "afresh, ms")
    sys.stdout.write(f"| {' | '.join((*head, head[4]))} |\n{7 * '|---'}|\n")
    ratios: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for sequence in map(Sequence.load, names(options.half)):
        times = measure(sequence, options.rounds, program)
        other_ms = times[BASELINE]["track"].median_ms
        for preset in PRESETS:
            track_ms, afresh_ms = (times[preset][stage].median_ms for stage in ("track", "afresh"))
            ratios[preset].append((other_ms / track_ms, other_ms / afresh_ms))
            cells = [f"{ms:.2f}" for ms in (other_ms, track_ms)] + [f"{other_ms / track_ms:.1f}"]
            cells += [f"{afresh_ms:.2f}", f"{other_ms / afresh_ms:.1f}"]
            sys.stdout.write(f"| {sequence.name} | {preset} | {' | '.join(cells)} |\n")
            sys.stdout.flush()
    for preset, pairs in ratios.items():
        track, afresh = np.median(pairs, axis=0)
        sys.stdout.write(f"\n{preset}: median {track:.1f} tracking, {afresh:.1f} afresh\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
