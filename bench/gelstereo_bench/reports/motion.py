"""Motion without a model of simulated parts that are dragged, twisted, rolled and pressed.

Run ``python -m gelstereo_bench.reports.motion`` to fill the tables in docs/motion.md.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import (
    MotionKind,
    MotionStatus,
    MotionTracker,
    Params,
    PartMotion,
    RestSurface,
    Scene,
    Simulator,
    Stick,
    pressure_saliency,
)
from gelstereo.geometry import se3_exp, se3_log
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.motion_loops import loop_rows, recognition_rows
from gelstereo_bench.reports.slip import Run, Step, runs

__all__ = ["Seen", "follow", "main", "turns"]

Array = npt.NDArray[np.float64]

#: Noise of a marker, mm.
_SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
_COLS = 25
#: Frames in which a part is pressed (`runs`); errors are those of the motion since then.
_PRESSING = 5
#: True stick ratio from which a part is held, and below which it slides.
_HELD, _SLIDES = 0.5, 0.1


@dataclass(frozen=True)
class Seen:
    """A frame of a contact, beside the truth."""

    truth: float
    t_sensor_object: Array
    motion: PartMotion
    seconds: float


def follow(run: Run, random: np.random.Generator, *, patch_is_known: bool) -> list[Seen]:
    """Follow a part, from markers with noise."""
    rest_mm = run.steps[0].points_mm
    rest, count = RestSurface(rest_mm), len(rest_mm)
    tracker = MotionTracker(rest, Params(), cols=_COLS)
    covariance = np.tile(np.diag(_SIGMA_MM**2), (count, 1, 1))
    variance, decay_mm = np.full(count, _SIGMA_MM[2] ** 2), Params().to_dict()["contact"]["decay_mm"]
    seen: list[Seen] = []
    for step in run.steps:
        points = step.points_mm + _SIGMA_MM * random.normal(size=rest_mm.shape)
        patch = step.stick != Stick.FREE
        if not patch_is_known:
            heights = rest.indentation_mm(points)
            patch, _ = pressure_saliency(rest, heights, variance, rows=_COLS, cols=_COLS, decay_mm=decay_mm)
        inside = patch.tolist()
        start = time.perf_counter()
        motion = tracker.run(points, covariance, inside)
        seconds = time.perf_counter() - start
        touching = int(np.sum(step.stick != Stick.FREE))
        if motion is None or step.t_sensor_object is None:
            seen = []
            continue
        truth = int(np.sum(step.stick == Stick.STUCK)) / max(touching, 1)
        seen.append(Seen(truth, step.t_sensor_object, motion, seconds))
    return seen


def errors(first: Seen, last: Seen) -> tuple[float, float]:
    """Degrees, and micrometres at the contact's centroid, of the motion between two frames."""
    found = last.motion.pose @ np.linalg.inv(first.motion.pose)
    true = last.t_sensor_object @ np.linalg.inv(first.t_sensor_object)
    to = np.eye(4)
    to[:3, 3] = -last.motion.about_mm
    off = se3_log(to @ true @ np.linalg.inv(found) @ np.linalg.inv(to))
    return float(np.degrees(np.linalg.norm(off[:3]))), 1e3 * float(np.linalg.norm(off[3:]))


def normalized(seen: Seen, first: Seen) -> float:
    """Squared error of the motion since touch, normalised by its covariance, over its six components."""
    true = seen.t_sensor_object @ np.linalg.inv(first.t_sensor_object)
    to = np.eye(4)
    to[:3, 3] = -seen.motion.about_mm
    off = se3_log(to @ true @ np.linalg.inv(seen.motion.pose) @ np.linalg.inv(to))
    return float(off @ np.linalg.solve(seen.motion.covariance, off)) / 6.0


def _expected(run: Run, last: Seen) -> MotionKind | None:
    """How the part moves at the end; None between."""
    if run.motion == "roll":
        return MotionKind.ROLLS
    if last.truth < _SLIDES:
        return MotionKind.SLIDES
    return MotionKind.RESTS if last.truth >= _HELD else None


def _row(name: str, pairs: list[tuple[Run, list[Seen]]]) -> list[str]:
    """Errors of held contacts up to their last frame with half of the contact sticking."""
    degrees, um, squares, kinds = [], [], [], []
    for run, seen in pairs:
        expected = _expected(run, seen[-1])
        if expected is not None:
            kinds.append(seen[-1].motion.kind == expected)
        held = [s for s in seen[_PRESSING:] if s.truth >= _HELD]
        if not held:
            continue
        degree, micrometre = errors(seen[min(_PRESSING, len(seen) - 1) - 1], held[-1])
        degrees.append(degree)
        um.append(micrometre)
        squares.append(normalized(held[-1], seen[0]))
    return [
        name,
        str(len(degrees)),
        f"{np.median(degrees):.2f}",
        f"{np.percentile(degrees, 95):.2f}",
        f"{np.median(um):.0f}",
        f"{np.percentile(um, 95):.0f}",
        f"{np.median(squares):.1f}",
        f"{sum(kinds)} of {len(kinds)}",
    ]


def turns(radius_mm: float, *, seed: int, steps: int = 120) -> list[Seen]:
    """A lying cylinder that rolls once around, from markers with noise in the true contact."""
    peg = {"kind": "cylinder", "radius_mm": radius_mm, "length_mm": 30.0}
    friction = 1.5
    scene = Scene().replace(indenter=peg, effects={"elastic_layer": {"friction": friction}})
    thickness_mm = scene.to_dict()["gel"]["thickness_mm"]
    simulator = Simulator(scene)
    pose = np.eye(4)
    pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    pose[:3, 3] = 4.0 - np.pi * radius_mm, 0.0, 40.0
    pose = np.asarray(simulator.pressed(pose, 0.3 * radius_mm))
    rest = simulator.advance(None, frame=0)
    made = [Step(rest.points_mm, np.zeros(len(rest.points_mm), np.uint8), None)]
    for index in range(1, steps + 2):
        frame = simulator.advance(pose, frame=index)
        assert frame.loads is not None
        made.append(Step(frame.points_mm, frame.loads.stick, pose))
        line = np.eye(4)
        line[:3, 3] = pose[:3, 3] - [0.0, 0.0, radius_mm]
        turn = se3_exp(np.array([0.0, 2.0 * np.pi / steps, 0.0, 0.0, 0.0, 0.0]))
        pose = np.asarray(line @ turn @ np.linalg.inv(line) @ pose)
    run = Run("peg", "roll", made, friction, thickness_mm)
    return follow(run, np.random.default_rng(seed), patch_is_known=True)


def _turn_row(radius_mm: float, count: int) -> list[str]:
    found = [turns(radius_mm, seed=seed) for seed in range(count)]
    off = [errors(seen[0], seen[-1]) for seen in found]
    sigma = [np.degrees(np.sqrt(seen[-1].motion.covariance[1, 1])) for seen in found]
    partial = np.mean([s.motion.status == MotionStatus.PARTIAL for seen in found for s in seen])
    return [
        f"{radius_mm:.1f}",
        str(count),
        f"{np.median([degrees for degrees, _ in off]):.2f}",
        f"{max(degrees for degrees, _ in off):.2f}",
        f"{np.median(sigma):.2f}",
        f"{np.median([um for _, um in off]):.0f}",
        f"{np.mean([seen[-1].motion.keyframe for seen in found]):.0f}",
        f"{100 * partial:.0f}",
    ]


def main(arguments: list[str] | None = None) -> int:
    """Fill the tables in docs/motion.md."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.motion", description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    parser.add_argument("--contacts", type=int, default=180, help="number of contacts")
    parser.add_argument("--turns", type=int, default=10, help="full turns of each cylinder")
    parser.add_argument("--recognitions", type=int, default=24, help="contacts of each part that come back")
    options = parser.parse_args(arguments)
    rows, seconds = [], []
    made = list(runs(options.contacts, seed=30))
    for name, patch_is_known in (("known patch", True), ("patch from heights", False)):
        random = np.random.default_rng(31)
        pairs = [(run, follow(run, random, patch_is_known=patch_is_known)) for run in made]
        pairs = [(run, seen) for run, seen in pairs if len(seen) > _PRESSING]
        seconds += [s.seconds for _, seen in pairs for s in seen]
        for kind in ("ball", "peg", "plate"):
            rows.append(_row(f"{kind}, {name}", [pair for pair in pairs if pair[0].kind == kind]))
    head = ["contacts", "count", "rotation, median, degrees", "95 %", "shift, median, um", "95 %"]
    head += ["squared error over its covariance, median", "kind is right"]
    replace_between(options.docs / "motion.md", "motions", table(head, rows))
    head = ["radius, mm", "count", "rotation, median, degrees", "largest", "its standard deviation"]
    head += ["shift, um", "keyframes", "frames not determined, %"]
    rows = [_turn_row(radius, options.turns) for radius in (2.0, 2.5, 3.0)]
    replace_between(options.docs / "motion.md", "turns", table(head, rows))
    head = ["rod", "count", "without loops: rotation, median, degrees", "largest", "mean squared error (6)"]
    head += ["with loops: rotation, median, degrees", "largest", "mean squared error (6)", "loops", "false"]
    replace_between(options.docs / "motion.md", "loops", table(head, loop_rows(options.turns)))
    head = ["part", "contacts that came back", "found", "found at a wrong pose", "other parts found"]
    replace_between(
        options.docs / "motion.md", "recognitions", table(head, recognition_rows(options.recognitions))
    )
    median, late = 1e3 * np.percentile(seconds, [50, 99])
    print(f"{median:.2f} ms a frame in the median, {late:.2f} ms at 99 %")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
