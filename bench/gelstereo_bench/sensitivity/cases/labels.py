"""What makes labels hard: distorted point sets, presses that arrive within one frame, dust, and resuming."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Error,
    MarkerState,
    Params,
    Pipeline,
    RestRecord,
    Scene,
    SimulatedFrame,
    Simulator,
    rest_lattice,
)
from gelstereo_bench.frontier.scenes import FACING_RAD, SURFACE_MM, VGA, board_shape, effects
from gelstereo_bench.frontier.sequences import Run, Shot, Task
from gelstereo_bench.frontier.tracking import Method, Named, score
from gelstereo_bench.sensitivity.figures import Case, Evaluation

__all__ = ["load"]

Array = npt.NDArray[np.float64]

_SIDE, _PITCH_PX = 15, 24.0
_SETS = 120


def _points(seed: int) -> tuple[Array, Array]:
    """Centres of a turned, sheared, bulged and jittered lattice, some missing, with strays; and all true
    ones.
    """
    random = np.random.default_rng([seed, 5])
    along = (np.arange(_SIDE) - 0.5 * (_SIDE - 1)) * _PITCH_PX
    grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    turn = random.uniform(-np.pi, np.pi)
    frame = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    frame = frame @ np.array([[1.0, random.uniform(-0.15, 0.15)], [0.0, random.uniform(0.9, 1.1)]])
    far = grid - random.uniform(-80.0, 80.0, 2)
    bulge = random.uniform(-0.4, 0.4) * far * np.exp(-(far**2).sum(axis=1) / 60.0**2)[:, None]
    true = (grid + bulge) @ frame.T + (320.0, 240.0)
    found = true + random.normal(size=true.shape) * random.uniform(0.0, 0.07) * _PITCH_PX
    kept = random.uniform(size=len(true)) >= random.uniform(0.0, 0.06)
    strays = random.uniform((100.0, 20.0), (540.0, 460.0), (random.integers(0, 5), 2))
    return random.permutation(np.concatenate([found[kept], strays])), true


def _labelled(found: Array, true: Array) -> float:
    """Share of the places that have the right marker, whichever corner the first one is."""
    if found.shape != (_SIDE, _SIDE, 2):
        return 0.0
    grid = true.reshape(_SIDE, _SIDE, 2)
    near = [np.linalg.norm(found - np.rot90(grid, quarter), axis=2) < _PITCH_PX / 3.0 for quarter in range(4)]
    return float(max(flags.mean() for flags in near))


def _lattices() -> Evaluation:
    out, shares, refused = Evaluation(), [], 0
    params = Params.preset("balanced").replace({"lattice": {"max_missing_share": 0.2}})
    for seed in range(_SETS):
        points, true = _points(seed)
        try:
            found = rest_lattice(points, params)
        except Error:
            refused += 1
            out.see([seed])
            continue
        places = np.reshape(found.positions_px, (found.rows, found.cols, 2))
        out.see(places, found.filled)
        shares.append(_labelled(places, true))
    out.figures["point sets: refused"] = refused
    out.put(
        "point sets: wholly right, %", 100.0 * float(np.mean(np.greater(shares, 0.85))) if shares else 0.0
    )
    out.put("point sets: right places, %", 100.0 * float(np.mean(shares)) if shares else 0.0)
    return out


def _pressed(
    scene: Scene, indenter: dict[str, object], rotation_rad: tuple[float, ...], depth_mm: float
) -> list[Shot]:
    """At rest, then at full depth from one frame to the next, and away again."""
    x, y = scene.to_dict()["gel"]["centre_mm"]
    top = float(indenter.get("protrusion_mm", indenter.get("radius_mm", 0.0)))  # type: ignore[arg-type]
    ways = [
        (0.0, 2.0),
        (0.1, 2.0),
        (0.2, -depth_mm),
        (0.3, -depth_mm),
        (0.4, -depth_mm),
        (0.5, 2.0),
        (0.6, 2.0),
    ]
    steps = [
        {"time_s": time_s, "position_mm": [x, y, SURFACE_MM + top + over], "rotation_rad": list(rotation_rad)}
        for time_s, over in ways
    ]
    simulator = Simulator(scene.replace({"indenter": indenter, "trajectory": steps, "frame_rate_hz": 10.0}))
    return [Shot.of(simulator[k]) for k in range(len(simulator))]


def _runs() -> Iterator[tuple[str, list[Run]]]:
    usual = VGA.scene()
    dusty = usual.replace({"effects": {**effects(), "specks": {}, "smears": {}, "wear": {}}})
    boards = [_pressed(usual, board_shape(mm), FACING_RAD, 0.0) for mm in (1.4, 1.8)]
    ball = {"kind": "sphere", "radius_mm": 4.0}
    yield "boards at once", [Run(shots, len(shots) - 1) for shots in boards]
    yield (
        "balls at once",
        [
            Run(shots, len(shots) - 1)
            for shots in (_pressed(usual, ball, (0.0, 0.0, 0.0), d) for d in (1.5, 2.5))
        ],
    )
    yield "dust", [Run(_pressed(dusty, ball, (0.0, 0.0, 0.0), 1.0), 6)]
    yield "turns and jumps", [Run(_turning(usual, pitch_mm), 5) for pitch_mm in (0.8, 0.95)]


def _turning(scene: Scene, pitch_mm: float) -> list[Shot]:
    """The whole lattice turned and moved by more than a pitch from one frame to the next."""
    x, y = scene.to_dict()["gel"]["centre_mm"]
    # The wider print is at the border of the view.
    ways = [
        (0.0, 0.0, 0.0),
        (8.0, 0.3, 0.0),
        (-8.0, -0.6, 0.7),
        (20.0, 0.0, 0.0),
        (0.0, 1.2, -1.0),
        (0.0, 0.0, 0.0),
    ]
    shots = []
    for k, (deg, right, down) in enumerate(ways):
        gel = {
            "rotation_rad": float(np.deg2rad(deg)),
            "centre_mm": [x + right, y + down],
            "pitch_mm": pitch_mm,
        }
        shots.append(Shot.of(Simulator(scene.replace({"gel": gel})).press(None, frame=k)))
    return shots


def _begin(params: Params, out: Evaluation, record: RestRecord | None = None) -> Callable[[Shot], Method]:
    def begin(_: Shot) -> Method:
        pipeline = Pipeline(VGA.rig(), params)
        if record is not None:
            pipeline.resume(record)

        def method(shot: Shot) -> Named:
            frame = pipeline.process(shot.left, shot.right)
            out.see([frame.digest])
            return Named(frame.left_px, frame.right_px, frame.state == MarkerState.SEEN, frame.cols)

        return method

    return begin


def load() -> dict[str, Case]:
    """Simulate all sequences."""
    params = Params.preset("fast")
    tasks = [Task(name, lambda runs=runs: runs) for name, runs in _runs()]  # type: ignore[misc]
    ball = {"kind": "sphere", "radius_mm": 4.0}
    simulator = Simulator(VGA.scene().replace({"indenter": ball}))
    pose = np.eye(4)
    pose[:3, 3] = (*VGA.centre_mm, SURFACE_MM)
    rest: SimulatedFrame = simulator.press(None, frame=0)
    later = [
        Shot.of(simulator.press(simulator.pressed(pose, depth), frame=k)) for k, depth in ((1, 1.5), (2, 1.0))
    ]
    moved = VGA.scene(gel={"centre_mm": [VGA.centre_mm[0] + 0.4, VGA.centre_mm[1] + 0.3]})
    shifted = [Shot.of(Simulator(moved).press(None, frame=3))] * 2
    first = Pipeline(VGA.rig(), params)
    for _ in range(3):
        first.process(rest.left, rest.right)
    record = first.rest_record()

    def follow() -> Evaluation:
        out = Evaluation()
        for task in tasks:
            _told(task, list(task.make()), _begin(params, out), out)
        resumed = Task("resumed", lambda: [Run(later, 1), Run(shifted, 1)])
        _told(resumed, list(resumed.make()), _begin(params, out, record), out)
        return out

    return {"labels": Case(follow), "point sets": Case(_lattices)}


def _told(task: Task, runs: list[Run], begin: Callable[[Shot], Method], out: Evaluation) -> None:
    found = score(task, runs, begin)
    shown = max(found.right + found.switched + found.unseen, 1)
    out.figures[f"{task.name}: labelled, %"] = 100.0 * found.right / shown
    out.figures[f"{task.name}: wrong names"] = found.switched
    out.figures[f"{task.name}: failed frames"] = found.refused
