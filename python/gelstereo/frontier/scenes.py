"""The fixed simulated scenes on which everything is measured."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Scene, SimulatedFrame, Simulator, Template

__all__ = ["BOARDS_MM", "CONDITIONS", "PARTS", "Part", "board_press", "part_press", "sphere_press"]

Array = npt.NDArray[np.float64]

#: What the page says about all figures.
CONDITIONS = (
    "simulated, 640x480, 25x25 markers; image noise 2 grey levels, defocus 0.8 px, paint grain, uneven light, gel "
    "shoulder and spread; fixed seeds"
)
_EFFECTS: dict[str, dict[str, float]] = {
    name: {} for name in ("sensor_noise", "defocus", "grain", "uneven_light", "shoulder", "spread")
}

#: Protrusions of the paper's boards (section V-A).
BOARDS_MM = (0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8)

_SURFACE_MM = 28.7
_CENTRE_MM = (4.0, 0.0)
_PRESS_S = 0.4
#: Half a turn about x: the object's +z faces the camera.
_FACING_RAD = (float(np.pi), 0.0, 0.0)


def _press(
    indenter: dict[str, Any],
    start_mm: float,
    end_mm: float,
    *,
    rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
    lattice_rad: float = 0.0,
    seed: int = 1,
) -> list[SimulatedFrame]:
    """Move an indenter from one depth of its origin to another; the first frame is untouched."""
    x, y = _CENTRE_MM
    keyframes = [
        {"time_s": time_s, "position_mm": [x, y, z], "rotation_rad": list(rotation_rad)}
        for time_s, z in ((0.0, start_mm), (_PRESS_S, end_mm))
    ]
    scene = Scene().replace(
        {
            "seed": seed,
            "gel": {"rotation_rad": lattice_rad},
            "indenter": indenter,
            "effects": _EFFECTS,
            "trajectory": keyframes,
        }
    )
    simulator = Simulator(scene)
    return [simulator[index] for index in range(len(simulator))]


def sphere_press(lattice_rad: float = 0.0, seed: int = 1) -> list[SimulatedFrame]:
    """Press a ball of 5 mm radius 1.2 mm deep."""
    radius_mm, depth_mm = 5.0, 1.2
    touch_mm = _SURFACE_MM + radius_mm
    ball = {"kind": "sphere", "radius_mm": radius_mm}
    return _press(ball, touch_mm + 0.2, touch_mm - depth_mm, lattice_rad=lattice_rad, seed=seed)


def board_press(protrusion_mm: float, seed: int) -> list[SimulatedFrame]:
    """Press a board until its plate lies on the gel: the block stands in it by its protrusion."""
    board = {
        "kind": "board",
        "size_mm": [40.0, 40.0],
        "block_mm": [9.0, 9.0],
        "protrusion_mm": protrusion_mm,
    }
    start_mm = _SURFACE_MM + protrusion_mm + 0.2
    return _press(board, start_mm, _SURFACE_MM, rotation_rad=_FACING_RAD, seed=seed)


@dataclass(frozen=True)
class Part:
    """A part to locate, and how it lies on the gel."""

    name: str
    mesh: trimesh.Trimesh
    rotation_rad: tuple[float, float, float]
    depth_mm: float = 1.0

    def template(self) -> Template:
        """Sample the part's surface."""
        return Template.from_mesh(self.mesh, units="mm", spacing_mm=0.3)


def part_press(part: Part, seed: int = 1) -> list[SimulatedFrame]:
    """Press a part as deep as it says."""
    pose = trimesh.transformations.rotation_matrix(
        np.linalg.norm(part.rotation_rad) or 0.0, part.rotation_rad if any(part.rotation_rad) else (0, 0, 1)
    )
    lowest_mm = float((part.mesh.vertices @ pose[:3, :3].T)[:, 2].min())
    touch_mm = _SURFACE_MM - lowest_mm
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        part.mesh.export(path)
        return _press(
            {"kind": "mesh", "path": str(path), "units": "mm"},
            touch_mm + 0.2,
            touch_mm - part.depth_mm,
            rotation_rad=part.rotation_rad,
            seed=seed,
        )


def _two_balls() -> trimesh.Trimesh:
    small, large = trimesh.creation.icosphere(4, 3.0), trimesh.creation.icosphere(4, 4.0)
    small.apply_translation([-4.5, 0.0, -0.8])  # both reach about as low
    large.apply_translation([4.0, 0.0, 0.0])
    return trimesh.util.concatenate([small, large])


def _ridge() -> trimesh.Trimesh:
    """Make a flat roof with a short, sloping ridge: no direction is free on its four faces."""
    corners = [[-9, -7, 2], [9, -7, 2], [9, 7, 2], [-9, 7, 2], [-4, 0, -1.0], [3, 0.5, -1.5]]
    return trimesh.Trimesh(vertices=corners).convex_hull


PARTS = (
    Part("cylinder", trimesh.creation.cylinder(4.0, 14.0, sections=128), (0.0, float(np.pi) / 2.0, 0.0)),
    Part("two balls", _two_balls(), (0.0, 0.0, 0.3)),
    Part("ridge", _ridge(), (0.0, 0.0, 0.2), depth_mm=1.4),
)
