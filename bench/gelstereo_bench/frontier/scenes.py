"""The fixed simulated scenes of all measurements."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Rig, Scene, SimulatedFrame, Simulator, Template
from gelstereo.extras import needs

__all__ = [
    "BOARDS_MM",
    "CONDITIONS",
    "FORMATS",
    "LATTICES",
    "PARTS",
    "VGA",
    "Format",
    "Part",
    "board_press",
    "board_shape",
    "effects",
    "layered_scene",
    "part_press",
    "sphere_press",
]

Array = npt.NDArray[np.float64]

#: Conditions of all figures, stated on the page.
CONDITIONS = (
    "simulated; unless a table says otherwise 640x480 and 25x25 markers, image noise 2 grey levels, defocus "
    "0.8 px, paint grain, uneven light, gel shoulder and spread; fixed seeds"
)

#: Protrusions of the paper's boards (section V-A).
BOARDS_MM = (0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8)

SURFACE_MM = 28.7
_PRESS_S = 0.4
#: Half a turn about x: the object's +z faces the camera.
FACING_RAD = (float(np.pi), 0.0, 0.0)

#: Rows and columns of the lattices whose times are compared.
LATTICES = (25, 45, 71)


def effects(**changes: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """The effects of all scenes, with changes."""
    names = ("sensor_noise", "defocus", "grain", "uneven_light", "shoulder", "spread")
    return {name: dict(changes.get(name, {})) for name in (*names, *(set(changes) - set(names)))}


@dataclass(frozen=True)
class Format:
    """An image size with its cameras: the simulator's sensor presets of that name."""

    size_px: tuple[int, int]

    @property
    def name(self) -> str:
        """Width and height."""
        return f"{self.size_px[0]}x{self.size_px[1]}"

    @property
    def megapixels(self) -> float:
        """Pixels of a pair, in millions."""
        return 2e-6 * self.size_px[0] * self.size_px[1]

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Between the two cameras."""
        return (0.5 * self.rig().baseline_mm, 0.0)

    def rig(self) -> Rig:
        """Two parallel cameras."""
        return Scene.preset(f"{self.name}-{LATTICES[0]}").rig

    def scene(self, markers: int = LATTICES[0], gel: Mapping[str, Any] | None = None) -> Scene:
        """Scene with a lattice of the given rows and columns; the gel's size is about the same for all."""
        return Scene.preset(f"{self.name}-{markers}").replace({"gel": dict(gel or {}), "effects": effects()})


def layered_scene() -> Scene:
    """Scene seen through 20 mm of air, 3 mm of acrylic and 5 mm of gel (640x480, f 600 px,
    baseline 10 mm).
    """
    return Scene.preset("640x480-25-refraction").replace({"effects": effects()})


#: 640x480 is the simulator's default; 1280x720 with f 652 px and 6.5 mm is a plausible reading of the paper.
FORMATS = (Format((640, 480)), Format((1280, 720)), Format((1280, 960)))
VGA = FORMATS[0]


def press(
    scene: Scene,
    indenter: Mapping[str, Any],
    start_mm: float,
    end_mm: float,
    rotation_rad: Sequence[float] = (0.0, 0.0, 0.0),
) -> list[SimulatedFrame]:
    """Move an indenter from one depth of its origin to another; the first frame is untouched."""
    x, y = scene.to_dict()["gel"]["centre_mm"]
    keyframes = [
        {"time_s": time_s, "position_mm": [x, y, z], "rotation_rad": list(rotation_rad)}
        for time_s, z in ((0.0, start_mm), (_PRESS_S, end_mm))
    ]
    simulator = Simulator(scene.replace({"indenter": dict(indenter), "trajectory": keyframes}))
    return [simulator[index] for index in range(len(simulator))]


def sphere_press(lattice_rad: float = 0.0, seed: int = 1, scene: Scene | None = None) -> list[SimulatedFrame]:
    """Press a ball of 5 mm radius 1.2 mm deep."""
    radius_mm, depth_mm = 5.0, 1.2
    touch_mm = SURFACE_MM + radius_mm
    scene = (scene or VGA.scene()).replace({"seed": seed, "gel": {"rotation_rad": lattice_rad}})
    ball = {"kind": "sphere", "radius_mm": radius_mm}
    return press(scene, ball, touch_mm + 0.2, touch_mm - depth_mm)


def board_shape(protrusion_mm: float) -> dict[str, Any]:
    """The paper's board: a block on a plate that covers the gel."""
    return {"kind": "board", "size_mm": [40.0, 40.0], "block_mm": [9.0, 9.0], "protrusion_mm": protrusion_mm}


def board_press(protrusion_mm: float, seed: int, scene: Scene | None = None) -> list[SimulatedFrame]:
    """Press a board until its plate lies on the gel, so that the block is pressed in by its protrusion."""
    scene = (scene or VGA.scene()).replace({"seed": seed})
    surface_mm = scene.to_dict()["gel"]["surface_mm"]
    return press(scene, board_shape(protrusion_mm), surface_mm + protrusion_mm + 0.2, surface_mm, FACING_RAD)


@dataclass(frozen=True)
class Part:
    """A part to locate, and its pose on the gel."""

    name: str
    mesh: trimesh.Trimesh
    rotation_rad: tuple[float, float, float]
    depth_mm: float = 1.0

    def template(self) -> Template:
        """Template of the part: samples of its surface, and a grid of distances around it."""
        return Template.from_mesh(self.mesh, units="mm", spacing_mm=0.3).with_grid()


def part_press(part: Part, seed: int = 1) -> list[SimulatedFrame]:
    """Press a part to its indentation depth."""
    pose = trimesh.transformations.rotation_matrix(
        np.linalg.norm(part.rotation_rad) or 0.0, part.rotation_rad if any(part.rotation_rad) else (0, 0, 1)
    )
    lowest_mm = float((part.mesh.vertices @ pose[:3, :3].T)[:, 2].min())
    touch_mm = SURFACE_MM - lowest_mm
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        part.mesh.export(path)
        mesh = {"kind": "mesh", "path": str(path), "units": "mm"}
        scene = VGA.scene().replace({"seed": seed})
        return press(scene, mesh, touch_mm + 0.2, touch_mm - part.depth_mm, part.rotation_rad)


def _two_balls() -> trimesh.Trimesh:
    small, large = trimesh.creation.icosphere(4, 3.0), trimesh.creation.icosphere(4, 4.0)
    small.apply_translation([-4.5, 0.0, -0.8])  # both reach about the same depth
    large.apply_translation([4.0, 0.0, 0.0])
    return trimesh.util.concatenate([small, large])


def _ridge() -> trimesh.Trimesh:
    """A flat roof with a short, sloping ridge; its four faces leave no direction free."""
    corners = [[-9, -7, 2], [9, -7, 2], [9, 7, 2], [-9, 7, 2], [-4, 0, -1.0], [3, 0.5, -1.5]]
    with needs(__name__):
        # trimesh uses scipy for it.
        return trimesh.Trimesh(vertices=corners).convex_hull


PARTS = (
    Part("cylinder", trimesh.creation.cylinder(4.0, 14.0, sections=128), (0.0, float(np.pi) / 2.0, 0.0)),
    Part("two balls", _two_balls(), (0.0, 0.0, 0.3)),
    Part("ridge", _ridge(), (0.0, 0.0, 0.2), depth_mm=1.4),
)
