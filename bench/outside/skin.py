"""Motion inside gels under balls, below the skin: `python -m outside.skin [--check] [--further FOLDER]`.

Each file of data/skin has the stages of one ball on one gel: the motion of the skin and of layers below it,
by the distance from the axis. `python -m outside.judge_skin` takes these layers for prints. `--further`
solves more gels for development, into another folder.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import contacts, fem
from .parts import Part

Array = npt.NDArray[np.float64]

DATA = Path(__file__).parent / "data" / "skin"
#: Depths of the layers below the skin; 0 is the skin.
DEPTHS_MM = (0.0, 0.2, 0.4, 0.8)
#: Radii of the balls of each half; no radius is in both.
RADII_MM = {"w": (2.0, 3.0, 4.5, 7.0), "j": (2.5, 3.5, 5.5, 8.0)}
#: Gels for development that are as compressible as those of half j, and their balls; they are not stored.
FURTHER = {
    "e": {"half": "further", "thickness_mm": 3.5, "poisson_ratio": 0.45, "friction": 0.5},
    "f": {"half": "further", "thickness_mm": 2.5, "poisson_ratio": 0.46, "friction": 0.5},
    "g": {"half": "further", "thickness_mm": 4.5, "poisson_ratio": 0.46, "friction": 0.4},
}
FURTHER_RADII_MM = (2.2, 4.0, 6.0)
#: Shares of a ball's last depth.
SHARES = (0.25, 0.65, 1.0)
#: Where motion is stored.
ALONG_MM = np.linspace(0.0, 9.0, 181)


def layer_motion(layer: fem.Layer, motion: Array, depth_mm: float) -> Array:
    """(R, 2) motion along r and z at `ALONG_MM`, bilinear between the mesh's nodes as its elements are."""
    r, z = (np.unique(axis.round(9)) for axis in layer.mesh.p)
    order = np.lexsort((layer.mesh.p[1], layer.mesh.p[0]))
    grid = motion[layer.nodal][order].reshape(len(r), len(z), 2)
    at = layer.thickness_mm - depth_mm
    row = min(int(np.searchsorted(z, at, side="right")) - 1, len(z) - 2)
    share = (at - z[row]) / (z[row + 1] - z[row])
    level = (1.0 - share) * grid[:, row] + share * grid[:, row + 1]
    return np.column_stack([np.interp(ALONG_MM, r, level[:, axis]) for axis in (0, 1)])


def solve(gel: dict[str, Any], radius_mm: float) -> tuple[list[float], Array, Array]:
    """Depths of the stages, contact radii, and (stages, layers, R, 2) motion."""
    thickness_mm = gel["thickness_mm"]
    stages = contacts.ball_stages(radius_mm, thickness_mm, SHARES)
    rim_mm = float(np.sqrt(2 * radius_mm * stages[-1][0]))
    layer = fem.disc(thickness_mm, gel["poisson_ratio"], contacts.HALF_MM, rim_mm / 14, 1.2 * rim_mm)
    part = Part.read({"kind": "ball", "radius_mm": radius_mm})
    solved = list(contacts.press(layer, part, gel["friction"], stages))
    touching = [float(layer.places[stage.pressures > 0, 0].max()) for stage in solved]
    motion = [[layer_motion(layer, stage.motion, depth) for depth in DEPTHS_MM] for stage in solved]
    return [stage[0] for stage in stages], np.array(touching), np.array(motion)


def main() -> None:
    """Solve what data/skin does not have yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only list what is missing")
    parser.add_argument("--further", type=Path, help="solve more gels, into this folder")
    arguments = parser.parse_args()
    folder = arguments.further or DATA
    for name, gel in (FURTHER if arguments.further else contacts.table()["gels"]).items():
        for radius_mm in RADII_MM.get(gel["half"], FURTHER_RADII_MM):
            path = folder / f"{name}_{radius_mm}.npz"
            if path.exists():
                continue
            if arguments.check:
                print(f"missing: {path.name}")
                continue
            depths_mm, touching_mm, motion_mm = solve(gel, radius_mm)
            meta = {"half": gel["half"], "gel": name, "radius_mm": radius_mm, "depths_mm": depths_mm}
            meta["thickness_mm"] = gel["thickness_mm"]
            folder.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(
                path,
                meta=json.dumps(meta),
                touching_mm=touching_mm.astype(np.float32),
                motion_mm=motion_mm.astype(np.float32),
            )
            print(f"{path.name}: {len(depths_mm)} stages")


if __name__ == "__main__":
    main()
