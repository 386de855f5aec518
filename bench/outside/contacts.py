"""Solve the contacts of `contacts.toml` and store them: `python -m outside.contacts [--check] [NAME ...]`.

Contacts that are already in data/contacts are not solved again. Each file has all stages of one part on one
gel.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tomllib

from . import fem, laws
from .parts import Part, Posed, at_touch

Array = npt.NDArray[np.float64]

HERE = Path(__file__).parent
DATA = HERE / "data" / "contacts"
# The print's half side, and that of the gel.
HALF_MM = 10.9
# Size of a block's elements under the part.
SOLID_MM = 0.3
# Largest step of the part: mm, degrees.
STEP = np.array([0.1, 0.08, 0.08, 2.0])


def table() -> dict[str, Any]:
    """`contacts.toml`."""
    return tomllib.loads((HERE / "contacts.toml").read_text())


def placed(touch: Posed, stage: Array) -> Posed:
    """The part at depth, motion along x and y, and twist."""
    depth, x, y, twist = stage
    return Posed(touch.part, touch.middle_mm + np.array([x, y, -depth]), float(twist))


def along(way: Array, last: Array) -> float:
    """Ratio of a step to the previous one if their directions agree; otherwise 0."""
    size = float(np.linalg.norm(last))
    share = float(way @ last) / size**2 if size > 0 else 0.0
    return share if np.abs(way - share * last).max() < 1e-9 else 0.0


def press(
    layer: fem.Layer, part: Part, friction: float, stages: Sequence[Sequence[float]]
) -> Iterator[fem.Solved]:
    """Solve all stages in order; steps that do not converge are halved, at most four times."""
    contact = fem.Contact(layer, friction)
    motion, at = np.zeros(layer.count), np.zeros(4)
    # Motion of the gel in the last step, and of the part.
    change, last = np.zeros(layer.count), np.zeros(4)
    touch = at_touch(part, layer.thickness_mm, (0.0, 0.0))
    for stage in stages:
        share, target = 1.0, np.asarray(stage, dtype=float)
        while np.abs(target - at).max() > 1e-9:
            way = (target - at) / max(1.0, float(np.ceil(np.max(np.abs(target - at) / STEP) - 1e-9)))
            now = at + share * way
            guess = motion + change * along(now - at, last)
            try:
                solved = contact.step(motion, guess, placed(touch, now), placed(touch, at))
            except fem.NotConverged:
                share *= 0.5
                if share < 0.05:
                    raise
                continue
            change, last = solved.motion - motion, now - at
            motion, at, share = solved.motion, now, min(1.0, 2 * share)
        yield solved


def save(name: str, meta: dict[str, Any], arrays: dict[str, Array]) -> None:
    """One file; float32, compressed."""
    DATA.mkdir(parents=True, exist_ok=True)
    packed = {key: np.asarray(value, dtype=np.float32) for key, value in arrays.items()}
    np.savez_compressed(DATA / f"{name}.npz", meta=json.dumps(meta), **packed)


def store(name: str, layer: fem.Layer, solved: list[fem.Solved], meta: dict[str, Any]) -> None:
    """Surface nodes of all stages; those of a block as grids with rows along y."""
    kept = [s.motion[layer.surface_dofs] for s in solved]
    if layer.axial:
        arrays = {"r": layer.places[:, 0], "motion": np.stack(kept)}
        arrays["pressure"] = np.stack([s.pressures for s in solved])
    else:
        x, y = np.unique(layer.places[:, 0]), np.unique(layer.places[:, 1])
        shape = (len(solved), len(y), len(x))
        arrays = {"x": x, "y": y, "motion": np.stack(kept).reshape(*shape, 3)}
        arrays["pressure"] = np.stack([s.pressures for s in solved]).reshape(shape)
        arrays["share"] = np.stack([s.shares for s in solved]).reshape(shape)
        arrays["traction"] = np.stack([s.tractions for s in solved]).reshape(*shape, 3)
    save(name, meta, arrays)


def ball_stages(radius: float, thickness: float, shares: Sequence[float]) -> list[list[float]]:
    """Depths of a ball's stages."""
    last = min(thickness / 3, 0.8 * radius, 1.6)
    return [[round(share * last, 4), 0.0, 0.0, 0.0] for share in shares]


def solve_ball(
    name: str, gel: dict[str, Any], gel_name: str, radius: float, shares: Sequence[float], fine: float
) -> None:
    """A ball on the axis of a disc."""
    thickness = gel["thickness_mm"]
    stages = ball_stages(radius, thickness, shares)
    rim = float(np.sqrt(2 * radius * stages[-1][0]))
    layer = fem.disc(thickness, gel["poisson_ratio"], HALF_MM, fine * rim / 14, 1.2 * rim)
    part = {"kind": "ball", "radius_mm": radius}
    solved = list(press(layer, Part.read(part), gel["friction"], stages))
    store(name, layer, solved, {"half": gel["half"], "gel": gel_name, "part": part, "stages": stages})


def reach_of(part: Part, stages: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Largest distance from the middle at which the part may touch along x and y, plus half a millimetre."""
    along = np.linspace(-10.0, 10.0, 161)
    x, y = (a.ravel() for a in np.meshgrid(along, along))
    thickness, reach = 0.0, np.zeros(2)
    touch = at_touch(part, thickness, (0.0, 0.0))
    for stage in stages:
        on_gel = np.stack((x, y, np.full_like(x, thickness)), axis=1)
        inside = placed(touch, np.asarray(stage, dtype=float)).distance(on_gel) < 0
        reach = np.maximum(reach, np.abs(on_gel[inside, :2]).max(axis=0))
    return float(reach[0]) + 0.5, float(reach[1]) + 0.5


def solve_solid(name: str, entry: dict[str, Any], gel: dict[str, Any], fine: float) -> None:
    """A part on a block, finest under the part."""
    part, stages = Part.read(entry["part"]), entry["stages"]
    layer = fem.block(gel["thickness_mm"], gel["poisson_ratio"], HALF_MM, fine, reach_of(part, stages))
    solved = list(press(layer, part, gel["friction"], stages))
    meta = {"half": gel["half"], "gel": entry["gel"], "part": entry["part"], "stages": stages}
    store(name, layer, solved, meta)


def solve_law(name: str, entry: dict[str, Any], thickness: float = 4.0) -> None:
    """Heights by a law without thickness; the gel's thickness only defines the stored file."""
    part = Part.read(entry["part"])
    along = np.linspace(-HALF_MM, HALF_MM, 219)
    touch = at_touch(part, thickness, (0.0, 0.0))
    stages = [[depth, 0.0, 0.0, 0.0] for depth in entry["depths"]]
    motion, pressed = [], []
    for stage in stages:
        depth = laws.underside(placed(touch, np.array(stage)), along, thickness)
        height = laws.LAWS[entry["law"]](depth, along, entry.get("length_mm", 0.0))
        motion.append(np.stack((np.zeros_like(height), np.zeros_like(height), -height), axis=-1))
        pressed.append((depth > 0) & (height < depth + 1e-6))
    meta = {key: entry[key] for key in ("half", "law", "length_mm", "part") if key in entry} | {
        "stages": stages
    }
    save(name, meta, {"x": along, "y": along, "motion": np.stack(motion), "pressure": np.stack(pressed)})


def jobs(contacts: dict[str, Any]) -> dict[str, tuple[Any, ...]]:
    """All files by name, each with the function that creates it; the fastest first."""
    found: dict[str, tuple[Any, ...]] = {}
    for name, entry in contacts["laws"].items():
        found[name] = (solve_law, entry)
    gels, balls = contacts["gels"], contacts["balls"]
    for key, gel in gels.items():
        for radius in balls[gel["half"]]:
            found[f"ball_{radius}_{key}"] = (solve_ball, gel, key, radius, balls["shares"], 1.0)
    for name, entry in contacts["solids"].items():
        found[f"{name}_{entry['gel']}"] = (
            solve_solid,
            entry,
            gels[entry["gel"]],
            entry.get("fine_mm", SOLID_MM),
        )
    return found


def main() -> int:
    """Solve the missing contacts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="files to solve; all without")
    names = parser.parse_args().names
    todo = {name: job for name, job in jobs(table()).items() if not names or name in names}
    failed = 0
    for name, (make, *rest) in todo.items():
        if (DATA / f"{name}.npz").exists():
            continue
        started = time.process_time()
        try:
            make(name, *rest)
        except fem.NotConverged:
            failed += 1
            sys.stderr.write(f"{name}: not converged\n")
            continue
        sys.stderr.write(f"{name}: {time.process_time() - started:.0f} s of CPU time\n")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
