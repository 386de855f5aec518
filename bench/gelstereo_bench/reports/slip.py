"""Slip of simulated parts that are dragged, twisted, rolled and pressed, beside the true state of markers.

Run ``python -m gelstereo_bench.reports.slip`` to fill the tables in docs/slip.md, and with
``--layout hexagonal`` the one of hexagonal prints.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import (
    ForceEstimator,
    Params,
    RestSurface,
    Scene,
    Simulator,
    SlipStatus,
    SlipTracker,
    Stick,
    pressure_saliency,
)
from gelstereo.geometry import se3_exp
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = [
    "KINDS",
    "MOTIONS",
    "PATCHES",
    "SIDE",
    "SIGMA_MM",
    "Run",
    "Step",
    "alarms",
    "follow",
    "main",
    "part_shape",
    "runs",
    "touched",
]

Array = npt.NDArray[np.float64]

KINDS = ("ball", "peg", "plate")
#: From where the markers in contact are known.
PATCHES = ("known patch", "patch from heights", "patch from heights and forces")
MOTIONS = ("drag", "twist", "roll", "press")
#: Noise of a marker, mm.
SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
SIDE, _PRESSING, _MOVING = 25, 5, 28
#: Rows of a print; those of a hexagonal one, of as many columns and the same pitch, are nearer to each other.
_ROWS = {"square": SIDE, "hexagonal": 29}
#: Stick ratio of the true contact below which a slip is found late, and below which it is gross.
_LATE, _GROSS = 0.7, 0.1


#: Settings of `slip.strain_sigma_mm` and `slip.strain_share` that are compared.
STRAINS = (
    (0.0, 0.0),
    (0.004, 0.0),
    (0.01, 0.0),
    (0.03, 0.0),
    (0.0, 0.02),
    (0.0, 0.04),
    (0.0, 0.06),
    (0.004, 0.02),
)


@dataclass(frozen=True)
class Step:
    """One frame of a contact: true markers, their state, and the part's pose."""

    points_mm: Array
    stick: npt.NDArray[np.uint8]
    t_sensor_object: Array | None
    #: (N, 3) true tractions around the markers; None without contact.
    traction_kpa: Array | None = None


@dataclass(frozen=True)
class Run:
    """One part that touches, is pressed in five frames, and moves on."""

    kind: str
    motion: str
    steps: list[Step]
    friction: float
    thickness_mm: float
    layout: str = "square"


@dataclass(frozen=True)
class Seen:
    """One frame as it was found. `truth` is the true stick ratio."""

    truth: float
    status: SlipStatus
    ratio: float | None
    between: tuple[float, float]
    #: Error of the motion since the first frame with one, um; None without a motion.
    motion_um: float | None


def _about(centre: Array, turn: Array, shift: Array) -> Array:
    """Motion by a rotation vector about a point, and a shift."""
    there, back = np.eye(4), np.eye(4)
    there[:3, 3], back[:3, 3] = centre, -centre
    return np.asarray(there @ se3_exp(np.concatenate([turn, shift])) @ back)


def part_shape(kind: str, random: np.random.Generator) -> tuple[dict[str, object], float]:
    """Shape of a part, and the distance from its middle to its face."""
    if kind == "ball":
        radius = random.uniform(2.0, 8.0)
        return {"kind": "sphere", "radius_mm": radius}, radius
    if kind == "peg":
        radius = random.uniform(2.0, 6.0)
        return {"kind": "cylinder", "radius_mm": radius, "length_mm": 40.0}, radius
    return {"kind": "box", "size_mm": [*random.uniform(4.0, 10.0, 2), 6.0]}, 3.0


def _run(kind: str, motion: str, random: np.random.Generator, layout: str) -> Run:
    friction = random.uniform(0.2, 1.2) if motion in ("drag", "twist") else random.uniform(1.0, 2.0)
    indenter, reach = part_shape(kind, random)
    thickness_mm = random.uniform(3.0, 5.0)
    printed = {"layout": layout, "rows": _ROWS[layout], "cols": SIDE}
    gel = {**Scene().to_dict()["gel"], **printed, "thickness_mm": thickness_mm}
    scene = Scene().replace(indenter=indenter, gel=gel, effects={"elastic_layer": {"friction": friction}})
    simulator = Simulator(scene)
    up, none = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    lying = _about(none, np.array([np.pi / 2, 0.0, 0.0]), none) if kind == "peg" else np.eye(4)
    pose = _about(none, random.uniform(0.0, 2.0 * np.pi) * up, none) @ lying
    pose[:3, 3] = [4.0 + random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0), 40.0]
    depth = random.uniform(0.2, 0.5) if kind == "plate" else random.uniform(0.3, 0.9)
    steps: list[Step] = []

    def advance(to: Array | None) -> None:
        frame = simulator.advance(to, frame=len(steps))
        count = len(frame.points_mm)
        stick = np.zeros(count, np.uint8) if frame.loads is None else frame.loads.stick
        traction = None if frame.loads is None else frame.loads.traction_kpa
        steps.append(Step(frame.points_mm, stick, to, traction))

    advance(None)
    for share in np.linspace(0.2, 1.0, _PRESSING):
        pose = np.asarray(simulator.pressed(pose, depth * share))
        advance(pose)
    angle, speed = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.01, 0.04)
    aside = np.array([np.cos(angle), np.sin(angle), 0.0])
    spin = random.choice([-1.0, 1.0]) * random.uniform(0.01, 0.03)
    for step in range(_MOVING):
        centre = pose[:3, 3]
        if motion == "drag":
            move = _about(centre, random.uniform(-0.005, 0.005) * up, speed * aside)
        elif motion == "twist":
            move = _about(centre, spin * up, none)
        elif motion == "roll":
            axis = pose[:3, 2] if kind == "peg" else np.cross(up, aside)
            move = _about(centre - reach * up, spin * axis, none)
        else:
            move = _about(centre, none, (-0.02 if step < _MOVING // 2 else 0.02) * up)
        pose = move @ pose
        advance(pose)
    return Run(kind, motion, steps, friction, thickness_mm, layout)


def runs(count: int, seed: int, layout: str = "square") -> Iterator[Run]:
    """Contacts of each kind in turn. Drags are twice as many as each other motion; plates do not roll."""
    random = np.random.default_rng(seed)
    motions = ("drag", *MOTIONS)
    for k in range(count):
        kind, motion = KINDS[k % 3], motions[(k // 3) % len(motions)]
        yield _run(kind, "press" if (kind, motion) == ("plate", "roll") else motion, random, layout)


def touched(
    step: Step, rest: RestSurface, points_mm: Array | None, layout: str = "square"
) -> npt.NDArray[np.bool_]:
    """Markers in contact: the true ones, or those found from the heights of these points."""
    if points_mm is None:
        return np.asarray(step.stick != Stick.FREE)
    decay_mm = Params().to_dict()["contact"]["decay_mm"]
    variance = np.full(len(points_mm), SIGMA_MM[2] ** 2)
    heights = rest.indentation_mm(points_mm)
    shape: dict[str, Any] = {"rows": _ROWS[layout], "cols": SIDE, "layout": layout}
    patch, _ = pressure_saliency(rest, heights, variance, **shape, decay_mm=decay_mm)
    return patch


def follow(
    run: Run,
    random: np.random.Generator,
    *,
    patch_is_known: bool,
    with_forces: bool = False,
    strain: tuple[float, float] = (0.0, 0.0),
) -> list[Seen]:
    """Find the slip of every frame with contact, from markers with noise. `strain` is one of `STRAINS`."""
    rest_mm = run.steps[0].points_mm
    rest, count = RestSurface(rest_mm), len(rest_mm)
    params = Params().replace(
        label={"method": "lattice"},
        lattice={"layout": run.layout},
        slip={"method": "rigid", "strain_sigma_mm": strain[0], "strain_share": strain[1]},
        force={"method": "ridge", "thickness_mm": run.thickness_mm, "young_kpa": 100.0},
    )
    tracker = SlipTracker(rest, params, cols=SIDE)
    covariance = np.tile(np.diag(SIGMA_MM**2), (count, 1, 1))
    # The rest positions are the mean of many frames.
    force = ForceEstimator(rest, params, cols=SIDE, covariance_mm2=1e-6 * covariance)
    seen, first = [], None
    for step in run.steps:
        points = step.points_mm + SIGMA_MM * random.normal(size=rest_mm.shape)
        patch = touched(step, rest, None if patch_is_known else points, run.layout)
        if with_forces:
            traction_kpa, _ = force.run(points, covariance, patch.tolist())
            patch = force.touching(traction_kpa, patch.tolist())
        _, slip = tracker.run(points, covariance, patch.tolist())
        touching = int(np.sum(step.stick != Stick.FREE))
        if slip is None or not touching or step.t_sensor_object is None:
            continue
        error_um = None
        if slip.motion is not None and slip.about_mm is not None:
            first = (slip.motion, step.t_sensor_object) if first is None else first
            at = np.array([*slip.about_mm, 1.0])
            found, true = (
                slip.motion @ np.linalg.inv(first[0]),
                step.t_sensor_object @ np.linalg.inv(first[1]),
            )
            error_um = 1e3 * float(np.linalg.norm((found @ at - true @ at)[:3]))
        truth = int(np.sum(step.stick == Stick.STUCK)) / touching
        seen.append(Seen(truth, SlipStatus(slip.status), slip.stick_ratio, slip.stick_range, error_um))
    return seen


def _ratios(name: str, seen: list[list[Seen]]) -> list[str]:
    known = [s for run in seen for s in run if s.ratio is not None and s.status != SlipStatus.GROSS]
    off = np.array([s.truth - s.ratio for s in known if s.ratio is not None])
    within = np.mean([s.between[0] - 1e-9 <= s.truth <= s.between[1] + 1e-9 for s in known])
    moved = [s.motion_um for s in known if s.motion_um is not None and s.truth > 0.5]
    return [
        name,
        str(len(seen)),
        f"{np.sqrt(np.mean(off**2)):.3f}",
        f"{np.mean(off):+.3f}",
        f"{100 * within:.0f}",
        f"{np.median(moved):.1f}",
    ]


def _first(seen: list[Seen], when: SlipStatus) -> int | None:
    return next((k for k, s in enumerate(seen) if s.status >= when), None)


def alarms(name: str, seen: list[list[Seen]]) -> list[str]:
    """When slip was found: while how much still stuck; and gross slip."""
    slipping = [run for run in seen if any(s.truth < _LATE for s in run)]
    found = [_first(run, SlipStatus.INCIPIENT) for run in slipping]
    in_time = sum(k is not None and run[k].truth >= _LATE for k, run in zip(found, slipping, strict=True))
    steady = [run for run in seen if all(s.truth >= 0.999 for s in run)]
    false = sum(_first(run, SlipStatus.INCIPIENT) is not None for run in steady)
    gross = [run for run in seen if any(s.truth < _GROSS for s in run)]
    late = 0
    for run in gross:
        k, true = _first(run, SlipStatus.GROSS), next(k for k, s in enumerate(run) if s.truth < _GROSS)
        late += k is None or k > true + 1
    held = [run for run in seen if all(s.truth >= _GROSS for s in run)]
    early = sum(_first(run, SlipStatus.GROSS) is not None for run in held)
    return [
        name,
        f"{in_time} of {len(slipping)}",
        f"{false} of {len(steady)}",
        f"{len(gross) - late} of {len(gross)}",
        f"{early} of {len(held)}",
    ]


def main(arguments: list[str] | None = None) -> int:
    """Fill the tables in docs/slip.md."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.slip", description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    parser.add_argument("--contacts", type=int, default=180, help="number of contacts")
    parser.add_argument("--layout", choices=sorted(_ROWS), default="square", help="of the print")
    options = parser.parse_args(arguments)
    head = ["patch", "slip found while 0.7 stick", "false alarms", "gross slip at most one frame late"]
    head.append("gross slip without one")
    if options.layout != "square":
        lines = []
        for layout in _ROWS:
            made = list(runs(options.contacts, seed=30, layout=layout))
            lines += [[layout, *alarms(name, _followed(name, made))] for name in PATCHES]
        replace_between(options.docs / "slip.md", options.layout, table(["print", *head], lines))
        return 0
    made = list(runs(options.contacts, seed=30))
    by_patch = {name: _followed(name, made) for name in PATCHES}
    lines = [alarms(name, seen) for name, seen in by_patch.items()]
    replace_between(options.docs / "slip.md", "alarms", table(head, lines))
    by_kind = []
    for name, seen in by_patch.items():
        for kind in KINDS:
            of_kind = [s for s, run in zip(seen, made, strict=True) if run.kind == kind]
            by_kind.append(_ratios(f"{kind}, {name}", of_kind))
    columns = ["contacts", "count", "rms error of the stick ratio", "mean", "true ratio in the range, %"]
    replace_between(
        options.docs / "slip.md", "ratios", table([*columns, "motion, median error, um"], by_kind)
    )
    head[:1] = ["`slip.strain_sigma_mm`", "`slip.strain_share`"]
    strains = [_strained(strain, made) for strain in STRAINS]
    replace_between(options.docs / "slip.md", "strains", table(head, strains))
    return 0


def _followed(patch: str, made: list[Run]) -> list[list[Seen]]:
    """What is seen of every contact with this patch."""
    random = np.random.default_rng(31)
    known, forces = patch == "known patch", patch.endswith("forces")
    return [follow(run, random, patch_is_known=known, with_forces=forces) for run in made]


def _strained(strain: tuple[float, float], made: list[Run]) -> list[str]:
    random = np.random.default_rng(31)
    seen = [follow(run, random, patch_is_known=False, strain=strain) for run in made]
    return [f"{strain[0]:g}", *alarms(f"{strain[1]:g}", seen)]


if __name__ == "__main__":
    raise SystemExit(main())
