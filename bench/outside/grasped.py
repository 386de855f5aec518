"""The experiment's parts in gels with other laws than the simulator's: `python -m outside.grasped [NAME
...]`.

A file of `data/grasped` has the contacts of one part under one law: the part's poses, the displaced markers,
and which of them touch. Stored contacts are not computed again. Frames are those of
`gelstereo_bench.frontier.grasps`: the sensor's, in which the part presses towards -z.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tomllib
import trimesh
from scipy.interpolate import RectBivariateSpline

from gelstereo import parts
from gelstereo_bench.frontier.grasps import GRASPED, SIDE, Press, place
from gelstereo_bench.frontier.scenes import SURFACE_MM, VGA

from . import bonded, laws

Array = npt.NDArray[np.float64]

HERE = Path(__file__).parent
DATA = HERE / "data" / "grasped"
PITCH_MM = 0.9
# Grids reach two millimetres beyond the markers.
ALONG_MM = np.linspace(-13.0, 13.0, 209)
# Poses are drawn until the part covers this many markers and this many touch; a soft gel touches only a few
# crests.
MIN_COVERED, MIN_TOUCHING, DRAWS = 20, 6, 40
#: Parts beside those of the experiment's insertions: a plate wider than the gel, ribs, no symmetry, and
#: grooves at equal distances.
FURTHER = (
    Press("card reader", parts.sd_reader, (2.0, 30.0), flat=True),
    Press("flash drive", parts.usb_drive, (0.0, 30.0), flat=True),
    Press("irregular part", parts.irregular_part, (2.0, 22.0)),
    Press("jack plug", parts.connector_3_5mm, (10.0, 24.0)),
)
PARTS = (*GRASPED, *FURTHER)
# Height where there is no part: far below every surface.
NOWHERE_MM = -5.0
# A marker touches if the gel is at most this much above the part, mm.
TOUCH_MM = 1e-3


def table() -> dict[str, Any]:
    """`grasped.toml`."""
    return tomllib.loads((HERE / "grasped.toml").read_text())


def lattice() -> Array:
    """Markers at rest, from the middle of the gel (n x 2)."""
    along = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * PITCH_MM
    y, x = np.meshgrid(along, along, indexing="ij")
    return np.stack((x.ravel(), y.ravel()), axis=1)


class Underside:
    """Depth of a part below the free surface, from the triangles below it."""

    def __init__(self, mesh: trimesh.Trimesh, pose: Array) -> None:
        """At a pose in the sensor frame."""
        corners = np.asarray(mesh.triangles) @ pose[:3, :3].T + pose[:3, 3]
        corners -= [*VGA.centre_mm, SURFACE_MM]
        low, high = corners.min(axis=1), corners.max(axis=1)
        reach = ALONG_MM[-1]
        near = (low[:, 2] < 0) & (low[:, :2] < reach).all(axis=1) & (high[:, :2] > -reach).all(axis=1)
        a, b, c = corners[near].transpose(1, 0, 2)
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        # Vertical triangles are skipped; their neighbours cover their borders.
        flat = np.abs(area) > 1e-9
        self.a, self.b, self.c, self.area = a[flat], b[flat], c[flat], area[flat]
        self.low, self.high = low[near][flat], high[near][flat]

    def _depth(self, k: Any, x: Array, y: Array) -> Array:
        a, b, c, area = self.a[k], self.b[k], self.c[k], self.area[k]
        s = ((x - a[..., 0]) * (c[..., 1] - a[..., 1]) - (y - a[..., 1]) * (c[..., 0] - a[..., 0])) / area
        t = ((b[..., 0] - a[..., 0]) * (y - a[..., 1]) - (b[..., 1] - a[..., 1]) * (x - a[..., 0])) / area
        inside = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9)
        z = a[..., 2] + s * (b[..., 2] - a[..., 2]) + t * (c[..., 2] - a[..., 2])
        return np.where(inside, -z, NOWHERE_MM)

    def on_grid(self) -> Array:
        """At `ALONG_MM` squared, rows along y."""
        depth = np.full((len(ALONG_MM), len(ALONG_MM)), NOWHERE_MM)
        first, last = (np.searchsorted(ALONG_MM, ends[:, :2]) for ends in (self.low, self.high))
        for k, ((x0, y0), (x1, y1)) in enumerate(zip(first, last, strict=True)):
            if x1 > x0 and y1 > y0:
                found = self._depth(k, ALONG_MM[None, x0:x1], ALONG_MM[y0:y1, None])
                np.maximum(depth[y0:y1, x0:x1], found, out=depth[y0:y1, x0:x1])
        return depth

    def at(self, points: Array) -> Array:
        """At any points (n x 2)."""
        every = np.arange(len(self.area))
        found = [
            self._depth(every, *p).max(initial=NOWHERE_MM) if len(every) else NOWHERE_MM
            for p in points[:, :, None]
        ]
        return np.asarray(found)


def _none(_: Array, points: Array, __: dict[str, float]) -> tuple[Array, Array]:
    return np.zeros_like(points), np.zeros(len(points))


def _exponential(depth: Array, points: Array, entry: dict[str, float]) -> tuple[Array, Array]:
    y, x = np.nonzero(depth > 0)
    sources, levels = np.stack((ALONG_MM[x], ALONG_MM[y]), axis=1), depth[y, x]
    far = [np.hypot(*(sources - p).T) for p in points]
    height = [(levels * np.exp(-d / entry["length_mm"])).max(initial=0.0) for d in far]
    return np.zeros_like(points), np.asarray(height)


def _membrane(depth: Array, points: Array, entry: dict[str, float]) -> tuple[Array, Array]:
    height = laws.membrane(depth, ALONG_MM, entry["length_mm"])
    return np.zeros_like(points), _read(height, points)


def _layer(depth: Array, points: Array, entry: dict[str, float]) -> tuple[Array, Array]:
    layer = bonded.Layer(entry["thickness_mm"], entry["poisson_ratio"])
    height, right, down = bonded.pressed(layer, depth, ALONG_MM)
    return np.stack((_read(right, points), _read(down, points)), axis=1), _read(height, points)


def _read(grid: Array, points: Array) -> Array:
    spline = RectBivariateSpline(ALONG_MM, ALONG_MM, grid, kx=1, ky=1)
    return np.asarray(spline(points[:, 1], points[:, 0], grid=False))


Law = Callable[[Array, Array, dict[str, float]], tuple[Array, Array]]
LAWS: dict[str, Law] = {"none": _none, "exponential": _exponential, "membrane": _membrane, "layer": _layer}


def press(
    entry: dict[str, Any], part: Underside, points: Array
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Lateral positions of the displaced markers (n x 2), their heights, and whether they touch."""
    sideways, height = LAWS[entry["law"]](part.on_grid(), points, entry)
    moved = points + sideways
    # Between the grid's nodes, the exact height of the part.
    depth = part.at(moved)
    height = np.maximum(height, depth)
    return moved, height, (depth > 0) & (height <= depth + TOUCH_MM)


def make(entry: dict[str, Any], part: Press, seeds: range) -> dict[str, Array]:
    """One contact for each seed."""
    mesh, points = part.make(), lattice()
    poses, places, touching = [], [], []
    for seed in seeds:
        random = np.random.default_rng([seed, 71])
        for _ in range(DRAWS):
            pose = place(part, mesh, random)
            under = Underside(mesh, pose)
            if (under.at(points) > 0).sum() < MIN_COVERED:
                continue
            moved, height, touches = press(entry, under, points)
            if touches.sum() >= MIN_TOUCHING:
                break
        else:
            raise RuntimeError(f"{part.name}, seed {seed}: no pose of which {MIN_TOUCHING} markers touch")
        poses.append(pose)
        places.append(np.column_stack((moved + VGA.centre_mm, SURFACE_MM - height)))
        touching.append(touches)
    return {"poses": np.stack(poses), "points_mm": np.stack(places), "touching": np.stack(touching)}


def jobs() -> dict[str, tuple[dict[str, Any], Press, range]]:
    """All files by name, each with the function that creates it."""
    entries, found = table(), {}
    for press_of in PARTS:
        half = next(half for half, names in entries["parts"].items() if press_of.name in names)
        for name, entry in entries["laws"].items():
            if entry["half"] == ("w" if half == "further" else half):
                first, count = entries["seeds"][half], entries["seeds"]["count"][half]
                found[f"{name}_{press_of.name.replace(' ', '_')}"] = (
                    {"part": press_of.name} | entry | {"half": half},
                    press_of,
                    range(first, first + count),
                )
    return found


def main() -> int:
    """Create the missing contacts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="files to make; all without")
    names = parser.parse_args().names
    DATA.mkdir(parents=True, exist_ok=True)
    for name, (entry, part, seeds) in jobs().items():
        path = DATA / f"{name}.npz"
        if path.exists() or (names and name not in names):
            continue
        started = time.process_time()
        made = make(entry, part, seeds)
        packed = {
            "poses": made["poses"],
            "points_mm": made["points_mm"].astype(np.float32),
            "touching": np.packbits(made["touching"], axis=1),
        }
        np.savez_compressed(path, meta=json.dumps(entry), **packed)
        sys.stderr.write(f"{name}: {time.process_time() - started:.0f} s of CPU time\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
