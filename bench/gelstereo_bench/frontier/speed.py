"""Time of a stereo frame over image and lattice sizes, compared with a fast OpenCV implementation, and its
growth.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gelstereo import Error, Params, Pipeline, SimulatedFrame
from gelstereo.extras import needs
from gelstereo_bench.frontier.baseline_fast import FastBaseline
from gelstereo_bench.frontier.rungs import EXACT, FAST, rungs_of
from gelstereo_bench.frontier.runners import geometry_of, write_input
from gelstereo_bench.frontier.scenes import FORMATS, LATTICES, Format, sphere_press
from gelstereo_bench.frontier.table import Report, Table, Target, figure
from gelstereo_bench.frontier.timing import InstructionCounter, Stopwatch, Times

with needs(__name__):
    from scipy.optimize import nnls

__all__ = [
    "Growth",
    "Speed",
    "growth_table",
    "measure_speed",
    "measure_threads",
    "speed_table",
    "speed_targets",
    "stage_table",
]

#: Consecutive calls before switching to another method, like consecutive frames of a camera.
_BURST = 5
_THREADS: tuple[Literal[1, 2], ...] = (1, 2)
_STAGES = ("track", "again", "afresh", "detect", "triangulate")
BASELINE = "OpenCV (baseline)"


@dataclass(frozen=True)
class Speed:
    """Times of one method on one image size and lattice."""

    size: Format
    markers: int
    method: str
    times: Mapping[str, Times]
    #: Peak memory of the pipeline; None if the core's own program was not used.
    memory_bytes: int | None = None
    refused: str = ""
    #: Instructions of each frame except the first; None if not counted.
    instructions: Sequence[int] = ()

    @property
    def unevenness(self) -> float:
        """Maximum over median of the instructions per frame: variation of the code, independent of the
        machine.
        """
        counts = self.instructions
        return max(counts) / float(np.median(counts)) if counts else float("nan")

    @property
    def machine_tail(self) -> float:
        """99 % quantile over median of the time of one repeated frame: variation added by the machine."""
        again = self.times.get("again", Times.of([]))
        return again.p99_ms / again.median_ms

    @property
    def track_ms(self) -> float:
        """Median time of a tracked frame."""
        return self.times["track"].median_ms if "track" in self.times else float("nan")


def measure_speed(
    rounds: int, source: Path | None, report: Report, lattices: Sequence[int] = LATTICES
) -> list[Speed]:
    """Time every preset on every image size and lattice, alternating with OpenCV."""
    program, counter = Stopwatch.program(source), InstructionCounter(source)
    found: list[Speed] = []
    for size in FORMATS:
        for markers in lattices:
            report(f"speed: {size.name}, {markers}x{markers} markers")
            # Callgrind is slow, so the variation between frames is measured for one format only.
            counted = size is FORMATS[0] and markers == LATTICES[0]
            found += _measure(size, markers, rounds, program, counter if counted else None)
    return found


def _measure(
    size: Format, markers: int, rounds: int, program: Path | None, counter: InstructionCounter | None
) -> list[Speed]:
    scene = size.scene(markers)
    press = sphere_press(scene=scene)
    # A pitch of another print would be refused.
    pitch_mm = scene.to_dict()["gel"]["pitch_mm"]
    calls: dict[str, Callable[[str, int], list[int]]] = {}
    memory: dict[str, int | None] = {BASELINE: None}
    refused: dict[str, str] = {}
    instructions: dict[str, list[int]] = {}
    with contextlib.ExitStack() as stack:
        for rung in rungs_of("whole"):
            params = rung.params().replace({"lattice.pitch_mm": pitch_mm})
            try:
                if program is None:
                    calls[rung.name], memory[rung.name] = _from_python(size, params, press), None
                else:
                    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
                    files = write_input(folder, params, press, size.rig())
                    watch = stack.enter_context(Stopwatch(program, files))
                    calls[rung.name], memory[rung.name] = watch.times_ns, watch.memory_bytes
                    if counter is not None:
                        instructions[rung.name] = counter.count_each("frames", files)
            except Error as error:
                refused[rung.name] = str(error)
        calls[BASELINE] = _baseline(size, press)
        taken: dict[str, dict[str, list[int]]] = {name: {stage: [] for stage in _STAGES} for name in calls}
        for turn in range(-1, max(1, rounds // _BURST)):
            for name, call in calls.items():
                for stage in _STAGES if name != BASELINE else ("track",):
                    nanoseconds = call(stage, _BURST)
                    if turn >= 0:
                        taken[name][stage] += nanoseconds
    speeds = [
        Speed(
            size,
            markers,
            name,
            {s: Times.of(ns) for s, ns in stages.items() if ns},
            memory[name],
            instructions=instructions.get(name, ()),
        )
        for name, stages in taken.items()
    ]
    return [*speeds, *(Speed(size, markers, name, {}, refused=why) for name, why in refused.items())]


def _there_and_back(turn: int, count: int) -> int:
    """Frame index, forwards and backwards, as in the core's program."""
    period = 2 * max(count, 2) - 2
    return min(turn % period, period - turn % period, count - 1)


def _from_python(
    size: Format, params: Params, press: Sequence[SimulatedFrame]
) -> Callable[[str, int], list[int]]:
    """Time complete frames through the binding; this needs no sources."""
    pipeline = Pipeline(size.rig(), params)
    for frame in press:
        pipeline.process(frame.left, frame.right)
    turns = iter(range(2**62))

    def times_ns(stage: str, calls: int) -> list[int]:
        if stage != "track":
            return []
        return _timed(
            lambda frame: pipeline.process(frame.left, frame.right),
            [press[_there_and_back(next(turns), len(press))] for _ in range(calls)],
        )

    return times_ns


def _baseline(size: Format, press: Sequence[SimulatedFrame]) -> Callable[[str, int], list[int]]:
    # The baseline's threshold is set by hand for these scenes; estimating it would take additional time.
    settings = Params.preset("balanced").to_dict()
    settings["detect"] |= {"threshold_levels": 20, "min_area_px2": 3}
    fast = FastBaseline(geometry_of(size.rig()), settings)
    rest = press[0]
    fast.process(rest.left, rest.right, (rest.left_px, rest.right_px))
    turns = iter(range(2**62))
    return lambda _, calls: _timed(
        lambda frame: fast.process(frame.left, frame.right),
        [press[_there_and_back(next(turns), len(press))] for _ in range(calls)],
    )


def _timed(work: Callable[[SimulatedFrame], object], frames: Sequence[SimulatedFrame]) -> list[int]:
    taken = []
    for frame in frames:
        begin = time.perf_counter_ns()
        work(frame)
        taken.append(time.perf_counter_ns() - begin)
    return taken


# Tables


def speed_table(found: Sequence[Speed]) -> Table:
    """Times of complete frames."""
    baseline = {(s.size.name, s.markers): s.track_ms for s in found if s.method == BASELINE}
    rows = []
    for speed in found:
        place = f"{speed.size.name}, {speed.markers}x{speed.markers}"
        if speed.refused:
            rows.append([place, speed.method, "refused", *["-"] * 7])
            continue
        track, afresh = speed.times["track"], speed.times.get("afresh", Times.of([]))
        reference_ms = baseline[speed.size.name, speed.markers]
        held = "-" if speed.memory_bytes is None else figure(speed.memory_bytes / 2**20)
        row = [place, speed.method, figure(track.median_ms), figure(track.p99_ms)]
        row += [figure(track.p99_ms / track.median_ms), figure(speed.machine_tail)]
        row += [figure(reference_ms / track.median_ms)]
        row += [figure(afresh.median_ms), figure(reference_ms / afresh.median_ms), held]
        rows.append(row)
    head = ["images, markers", "method", "tracking ms", "p99 ms", "p99 / median"]
    head += ["p99 / median, one frame repeated", "speed-up over OpenCV"]
    return Table("speed", [*head, "afresh ms", "speed-up over OpenCV", "memory MiB"], rows)


def stage_table(found: Sequence[Speed]) -> Table:
    """Times of the stages, where the core's program was timed."""
    rows = []
    for speed in found:
        if speed.markers != 25 or not set(_STAGES) <= set(speed.times):
            continue
        ms = {stage: speed.times[stage].median_ms for stage in _STAGES}
        rest_ms = ms["afresh"] - ms["detect"] - ms["triangulate"]
        row = [f"{speed.method}, {speed.size.name}", figure(ms["detect"]), figure(ms["triangulate"])]
        row += [figure(max(rest_ms, 0.0)), figure(ms["afresh"]), figure(ms["track"])]
        counts = speed.instructions
        row += [figure(1e-6 * float(np.median(counts))), figure(speed.unevenness)] if counts else ["-", "-"]
        rows.append(row)
    head = ["preset", "detect both views", "points and covariances", "labels, rest surface, contact"]
    head += ["frame afresh", "frame tracking", "10^6 instructions, tracking", "largest / median"]
    return Table("stages", head, rows)


@dataclass(frozen=True)
class Growth:
    """Time as a sum of costs per pixel and per marker, by non-negative least squares."""

    base_ms: float
    ns_per_pixel: float
    us_per_marker: float
    #: Largest relative residual.
    residual: float

    @classmethod
    def of(cls, speeds: Sequence[Speed], stage: str) -> Growth | None:
        """Fit, or None with too few times. Weights make it a fit of relative errors."""
        known = [speed for speed in speeds if stage in speed.times]
        if len(known) < 4:
            return None
        ms = np.array([speed.times[stage].median_ms for speed in known])
        terms = np.array([[1.0, s.size.megapixels, 1e-3 * s.markers**2] for s in known])
        found, _ = nnls(terms / ms[:, None], np.ones(len(ms)))
        residual = float(np.abs(terms @ found / ms - 1.0).max())
        return cls(float(found[0]), float(found[1]), float(found[2]), residual)


def growth_table(found: Sequence[Speed]) -> Table:
    """Costs per pixel and per marker."""
    rows = []
    for method in dict.fromkeys(speed.method for speed in found):
        for stage in ("track", "afresh"):
            growth = Growth.of([speed for speed in found if speed.method == method], stage)
            if growth is not None:
                numbers = (growth.base_ms, growth.ns_per_pixel, growth.us_per_marker, 100.0 * growth.residual)
                rows.append([f"{method}, {'tracking' if stage == 'track' else stage}", *map(figure, numbers)])
    return Table("growth", ["method", "base ms", "ns per pixel", "us per marker", "largest residual %"], rows)


def measure_threads(rounds: int, report: Report) -> Table:
    """Time one and two threads through the binding, and compare all results bit by bit."""
    rows = []
    for size in FORMATS[:2]:
        press = sphere_press(scene=size.scene())
        for rung in rungs_of("whole"):
            report(f"threads: {rung.name}, {size.name}")
            pipelines = [Pipeline(size.rig(), rung.params()) for _ in _THREADS]
            digests: list[list[int]] = [[] for _ in _THREADS]
            taken: list[list[int]] = [[] for _ in _THREADS]
            for turn in range(max(rounds, len(press))):
                frame = press[_there_and_back(turn, len(press))]
                for index, threads in enumerate(_THREADS):
                    begin = time.perf_counter_ns()
                    result = pipelines[index].process(frame.left, frame.right, threads=threads)
                    taken[index].append(time.perf_counter_ns() - begin)
                    digests[index].append(result.digest)
            one, two = (float(np.median(ns)) * 1e-6 for ns in taken)
            same = "same bits" if digests[0] == digests[1] else "**different**"
            rows.append([f"{rung.name}, {size.name}", figure(one), figure(two), figure(one / two), same])
    return Table("threads", ["preset", "one thread ms", "two threads ms", "speed-up", "results"], rows)


#: OpenCV's time on the machine for which the targets in milliseconds are stated; it converts them to ratios.
_OPENCV_MS = {("640x480", 25): 8.0, ("1280x720", 25): 18.0}


def speed_targets(found: Sequence[Speed]) -> list[Target]:
    """Targets in milliseconds, and as ratios to OpenCV in the same run, which are independent of
    the machine.
    """
    limits = {
        ("640x480", 25): ((FAST, 0.6, 1.5), (EXACT, None, 8.0)),
        ("1280x720", 25): ((FAST, 1.0, 3.5),),
        ("1280x720", 71): ((FAST, 8.0, None),),
    }
    opencv_ms = {(s.size.name, s.markers): s.track_ms for s in found if s.method == BASELINE}
    targets = []
    for speed in found:
        key = (speed.size.name, speed.markers)
        place = f"{speed.size.name}, {speed.markers}x{speed.markers}"
        for method, track_ms, afresh_ms in limits.get(key, ()):
            if method != speed.method:
                continue
            for stage, limit in (("track", track_ms), ("afresh", afresh_ms)):
                if limit is not None:
                    median_ms = speed.times[stage].median_ms if stage in speed.times else float("nan")
                    what = f"speed, {method}, {place}, {'tracking' if stage == 'track' else stage}"
                    targets.append(Target(what, limit, median_ms, "ms"))
                    if key in _OPENCV_MS:
                        ratio = opencv_ms.get(key, float("nan")) / median_ms
                        min_ratio = round(_OPENCV_MS[key] / limit, 2)
                        targets.append(Target(f"{what}, speed-up over OpenCV", min_ratio, ratio, "", False))
            if track_ms is not None and "track" in speed.times:
                times = speed.times["track"]
                ratio = times.p99_ms / times.median_ms
                targets.append(Target(f"speed, {method}, {place}, p99 over median", 1.5, ratio, ""))
            if speed.instructions:
                what = f"speed, {method}, {place}, largest over median instructions of a frame"
                targets.append(Target(what, 1.5, speed.unevenness, ""))
    held = [
        speed.memory_bytes for speed in found if speed.memory_bytes is not None and speed.size is FORMATS[0]
    ]
    if held:
        targets.append(Target("memory, largest of all presets at 640x480", 16.0, max(held) / 2**20, "MiB"))
    return targets
