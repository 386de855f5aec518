"""Correctness of marker identities over difficult sequences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gelstereo import Error, MarkerState, Params, Pipeline
from gelstereo.extras import needs
from gelstereo_bench.frontier.baseline import Baseline, nearest_within_gate
from gelstereo_bench.frontier.baseline_fast import FastBaseline
from gelstereo_bench.frontier.rungs import EXACT, FAST, rungs_of
from gelstereo_bench.frontier.runners import geometry_of
from gelstereo_bench.frontier.scenes import VGA
from gelstereo_bench.frontier.sequences import SEQUENCES, Run, Shot, Task
from gelstereo_bench.frontier.table import Report, Table, Target

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = ["Score", "measure_tracking", "score"]

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Named:
    """A method's result for a frame: position of marker ``row * cols + col`` in each view, and whether it was
    seen.
    """

    left_px: Array
    right_px: Array
    seen: Flags
    cols: int


#: Function from a frame to labelled positions; may raise `Error` or `ValueError`.
Method = Callable[[Shot], Named]


@dataclass
class Score:
    """Counts over all markers of all frames of a task."""

    #: Seen, with the right identity.
    right: int = 0
    #: Seen, with a wrong identity: the worst error.
    switched: int = 0
    #: Visible in both images, but held or lost.
    unseen: int = 0
    #: Frames without a result; their markers count as unseen.
    refused: int = 0
    frames: int = 0
    #: Calm frames of each run until all visible markers were seen with the right identity; None if never.
    reacquired: list[int | None] = field(default_factory=list)

    @property
    def right_share(self) -> float:
        """Fraction of seen markers with the right identity."""
        seen = self.right + self.switched
        return self.right / seen if seen else float("nan")

    @property
    def unseen_share(self) -> float:
        """Fraction of visible markers held or lost."""
        shown = self.right + self.switched + self.unseen
        return self.unseen / shown if shown else float("nan")

    def cell(self) -> str:
        """Format for the table."""
        if self.refused == self.frames:
            return "refused"
        known = [frames for frames in self.reacquired if frames is not None]
        again = f"{max(known)}" if known and len(known) == len(self.reacquired) else "never"
        share = 100.0 * self.right_share
        right = "-" if np.isnan(share) else f"{share:.2f}" if self.switched else "100"
        text = f"{right} / {self.switched} / {100 * self.unseen_share:.1f} / {again}"
        return text + (f"; {self.refused} of {self.frames} refused" if self.refused else "")


def score(task: Task, runs: Sequence[Run], begin: Callable[[Shot], Method]) -> Score:
    """Run a method, restarted with each first frame, over a task's sequences."""
    total = Score()
    for run in runs:
        _score_run(run, begin(run.shots[0]), total)
    return total


def _score_run(run: Run, method: Method, total: Score) -> None:
    names: npt.NDArray[np.intp] | None = None
    again: int | None = None
    for index, shot in enumerate(run.shots):
        total.frames += 1
        shown = int(shot.visible.sum())
        try:
            found = method(shot)
        except (Error, ValueError):
            total.refused += 1
            total.unseen += shown
            continue
        if names is None:
            names = _names(found, shot)
        if names is None:  # another number of markers: no identity can be right
            total.switched += int(found.seen.sum())
            continue
        right, wrong = _judge(found, shot, names)
        total.right += int(right.sum())
        total.switched += int(wrong.sum())
        total.unseen += int((shot.visible & ~right & ~wrong).sum())
        if index >= run.calm and again is None and right.sum() == shown and not wrong.any():
            again = index - run.calm
    total.reacquired.append(again)


def _judge(found: Named, shot: Shot, names: npt.NDArray[np.intp]) -> tuple[Flags, Flags]:
    """Masks of true markers seen with the right identity, and with a wrong one."""
    near = np.ones(len(names), bool)
    for truth, claimed in ((shot.left_px, found.left_px), (shot.right_px, found.right_px)):
        pitch_px = float(np.median(cKDTree(truth).query(truth, k=2)[0][:, 1]))
        near &= np.linalg.norm(claimed[names] - truth, axis=1) < pitch_px / 3.0
    seen = found.seen[names]
    return seen & near & shot.visible, seen & ~(near & shot.visible)


def _names(found: Named, shot: Shot) -> npt.NDArray[np.intp] | None:
    """Label of every true marker; a rotated square lattice may be counted from any of its four corners."""
    side = round(np.sqrt(len(shot.left_px)))
    if len(found.left_px) != side * side or found.cols != side:
        return None
    places = np.arange(side * side).reshape(side, side)
    turned = [np.rot90(places, quarter).ravel() for quarter in range(4)]
    shown = shot.visible
    off = [np.median(np.linalg.norm((found.left_px[t] - shot.left_px)[shown], axis=1)) for t in turned]
    return turned[int(np.argmin(off))]


# Methods


def _native(params: Params) -> Callable[[Shot], Method]:
    def begin(_: Shot) -> Method:
        pipeline = Pipeline(VGA.rig(), params)

        def method(shot: Shot) -> Named:
            frame = pipeline.process(shot.left, shot.right)
            return Named(frame.left_px, frame.right_px, frame.state == MarkerState.SEEN, frame.cols)

        return method

    return begin


def _paper(params: Params) -> Callable[[Shot], Method]:
    """Plain OpenCV with Algorithm 1."""

    def begin(_: Shot) -> Method:
        baseline = Baseline(geometry_of(VGA.rig()), params.to_dict())

        def method(shot: Shot) -> Named:
            frame = baseline.process(shot.left, shot.right)
            return Named(frame.left_px, frame.right_px, frame.seen, round(np.sqrt(len(frame.seen))))

        return method

    return begin


def _linked(params: Params) -> Callable[[Shot], Method]:
    """Plain OpenCV with nearest neighbours; the first frame's labels are given, which favours it."""

    def begin(first: Shot) -> Method:
        fast = FastBaseline(geometry_of(VGA.rig()), params.to_dict())
        tracks = {"left": first.left_px.copy(), "right": first.right_px.copy()}
        gate = params.to_dict()["track"]["gate_pitches"]

        def method(shot: Shot) -> Named:
            seen = np.ones(len(first.left_px), bool)
            for view, image in (("left", shot.left), ("right", shot.right)):
                pitch_px = float(np.median(cKDTree(tracks[view]).query(tracks[view], k=2)[0][:, 1]))
                tracks[view], here = nearest_within_gate(tracks[view], fast.detect(image), gate * pitch_px)
                seen &= here
            return Named(tracks["left"], tracks["right"], seen, round(np.sqrt(len(seen))))

        return method

    return begin


def measure_tracking(report: Report, tasks: Sequence[Task] = SEQUENCES) -> tuple[Table, list[Target]]:
    """Run every label rung, every preset and plain OpenCV over all sequences."""
    rungs = {rung.name: rung for rung in (*rungs_of("label"), *rungs_of("whole"))}
    baseline = Params.preset("balanced").replace({"label": {"method": "foresight"}})
    names = [*rungs, "OpenCV + Algorithm 1 (baseline)", "OpenCV + nearest neighbours"]
    cells: dict[str, list[str]] = {}
    totals = {name: Score() for name in names}
    for task in tasks:
        report(f"tracking: {task.name}")
        runs = task.make()
        changes = {group: dict(values) for group, values in task.changes.items()}
        methods = {name: _native(rung.params().replace(changes)) for name, rung in rungs.items()}
        methods[names[-2]], methods[names[-1]] = _paper(baseline), _linked(baseline)
        cells[task.name] = []
        for name in names:
            found = score(task, runs, methods[name])
            cells[task.name].append(found.cell())
            totals[name].right += found.right
            totals[name].switched += found.switched
            totals[name].reacquired += found.reacquired
    rows = [[task, *row] for task, row in cells.items()]
    targets = []
    for name in (FAST, EXACT):
        if name in totals:
            total = totals[name]
            targets.append(Target(f"tracking, {name}, wrong identities", 0, total.switched, "markers"))
            late = sum(1 for frames in total.reacquired if frames != 0)
            targets.append(
                Target(f"tracking, {name}, runs not complete at once after a disturbance", 0, late, "runs")
            )
    return Table("tracking", ["sequence", *names], rows), targets
