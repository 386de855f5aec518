"""Distance of a point to a part: samples, triangles and the grid, compared with SciPy's and trimesh's
searches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Template
from gelstereo.extras import needs
from gelstereo_bench.frontier.table import Report, Table, Target, figure
from gelstereo_bench.frontier.timing import time_side_by_side

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = [
    "EXACT",
    "GRID",
    "PARTS",
    "SAMPLES",
    "SCIPY",
    "WARM",
    "Method",
    "measure_nearest",
    "methods",
    "points_around",
]

Array = npt.NDArray[np.float64]
#: Unsigned or signed distances of (N, 3) points.
Method = Callable[[Array], Array]

EXACT, WARM = "`Template.closest`", "`Template.closest`, near the last answer"
GRID, TRIMESH = "`Template.grid_distance`", "trimesh `closest_point`"
SAMPLES = "`Template.nearest`, samples 0.25 mm apart"
SCIPY = "SciPy `cKDTree`, the same samples"

#: Test parts: a ball of 5120 triangles, and a part of few large triangles that meet in edges.
PARTS: Mapping[str, Callable[[], trimesh.Trimesh]] = {
    "ball, R 5 mm": lambda: trimesh.creation.icosphere(subdivisions=4, radius=5.0),
    "plate, 20 x 20 x 2.2 mm": lambda: trimesh.creation.box((20.0, 20.0, 2.2)),
}

#: trimesh takes milliseconds per point.
_POINTS = 500


def points_around(mesh: trimesh.Trimesh, seed: int, count: int) -> Array:
    """Points up to 1 mm from a surface, like a patch relative to a part at a guess."""
    random = np.random.default_rng(seed)
    share = mesh.area_faces / mesh.area
    corners = mesh.triangles[random.choice(len(mesh.faces), size=count, p=share)]
    on = np.einsum("ni,nij->nj", random.dirichlet([1.0, 1.0, 1.0], size=count), corners)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    out: Array = on + directions * random.uniform(0.0, 1.0, size=(count, 1))
    return out


def methods(mesh: trimesh.Trimesh) -> dict[str, Method]:
    """All methods for distances, initialised."""
    template = Template.from_triangles(mesh.vertices, mesh.faces).with_grid()
    samples, normals = template.points_mm, template.normals
    before: dict[bytes, npt.NDArray[np.int64]] = {}
    tree = cKDTree(samples)

    def plane(points: Array) -> Array:
        nearest = tree.query(points)[1]
        return np.asarray(np.abs(np.einsum("ij,ij->i", points - samples[nearest], normals[nearest])))

    def warm(points: Array) -> Array:
        # As in the iterations of a registration, initial triangles are those of slightly displaced points.
        key = points.tobytes()
        near = before.get(key)
        if near is None:
            near = before[key] = template.closest(points + 0.03).triangles
        return template.closest(points, near=near).distances_mm

    return {
        WARM: warm,
        EXACT: lambda points: template.closest(points).distances_mm,
        GRID: lambda points: template.grid_distance(points)[0],
        SAMPLES: lambda points: template.nearest(points)[1],
        SCIPY: lambda points: np.asarray(tree.query(points)[0]),
        "the same, to the sample's plane": plane,
        TRIMESH: lambda points: np.asarray(trimesh.proximity.closest_point(mesh, points)[1]),
        "trimesh `signed_distance`": lambda points: np.asarray(
            trimesh.proximity.signed_distance(mesh, points)
        ),
    }


def _exact(mesh: trimesh.Trimesh, points: Array) -> Array:
    """Minimum distance over all triangles."""
    near = trimesh.triangles.closest_point
    count = len(mesh.faces)
    every = [
        np.linalg.norm(near(mesh.triangles, np.broadcast_to(point, (count, 3))) - point, axis=1)
        for point in points
    ]
    return np.array([distances.min() for distances in every])


def _call(way: Method, points: Array) -> Callable[[int], object]:
    return lambda _: way(points)


def measure_nearest(rounds: int, report: Report) -> tuple[Table, list[Target]]:
    """Measure error and time of every method on every part."""
    rows: dict[str, list[str]] = {}
    targets: list[Target] = []
    for part, make in PARTS.items():
        report(f"nearest points: {part}")
        mesh = make()
        points = points_around(mesh, 1, _POINTS)
        exact = _exact(mesh, points)
        ways = methods(mesh)
        times = time_side_by_side({name: _call(way, points) for name, way in ways.items()}, rounds)
        for name, way in ways.items():
            error_mm = np.abs(np.abs(way(points)) - exact)
            microseconds = times[name].median_ms * 1e3 / len(points)
            rms_mm, largest_mm = float(np.sqrt(np.mean(error_mm**2))), float(error_mm.max())
            rows.setdefault(name, [name]).append(
                f"{_small(rms_mm)} / {_small(largest_mm)} mm, {figure(microseconds)} µs"
            )
            if name == WARM:
                targets.append(Target(f"nearest point, {part}, error", 1e-9, largest_mm, "mm"))
                targets.append(Target(f"nearest point, {part}, time", 0.5, microseconds, "µs"))
    return Table("nearest", ["method", *PARTS], list(rows.values())), targets


def _small(value_mm: float) -> str:
    """Format a figure; rounding errors by their power of ten."""
    return f"{value_mm:.0e}" if 0.0 < value_mm < 1e-6 else figure(value_mm)
