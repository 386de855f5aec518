"""Meshes from other projects, pressed into the simulated gel and localized.

Run ``python -m gelstereo_bench.reports.meshes --meshes FOLDER`` to fill the table in docs/real-recordings.md.
In the folder are ``factory_meshes`` (pegs and a bolt of isaac-sim/IsaacGymEnvs) and ``meshes_realsense`` (a
USB plug of realsense-ros), both in metres.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from gelstereo import RegisterError
from gelstereo.templates import load_mesh
from gelstereo_bench.frontier.grasps import NOISES, STARTS, Press, Score, Start, grasps
from gelstereo_bench.frontier.rungs import Rung, rungs_of
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = ["PARTS", "MeshPart", "main", "measure"]


@dataclass(frozen=True)
class MeshPart:
    """One mesh, and its pose on the gel."""

    name: str
    path: str
    #: Range of the distance from the tip to where the part is held, mm.
    held_mm: tuple[float, float]
    #: Whether it lies on a wide face, normal along its y axis.
    flat: bool = False
    #: Axis of the mesh that points to the tip.
    along: int = 2

    def mesh(self, folder: Path) -> trimesh.Trimesh:
        """Read the mesh in mm, its axis along z."""
        vertices, triangles = load_mesh(folder / self.path, "m")
        # A cyclic permutation of the axes preserves the triangles' orientation; y stays the wide face's
        # normal if x becomes z.
        if self.along == 0:
            vertices = np.column_stack([-vertices[:, 2], vertices[:, 1], vertices[:, 0]])
        return trimesh.Trimesh(vertices, triangles, process=True)

    def press(self, folder: Path) -> Press:
        """The press of this mesh."""
        return Press(self.name, lambda: self.mesh(folder), self.held_mm, self.flat)


_FACTORY = "factory_meshes/factory_"
PARTS = (
    MeshPart("round peg, 8 mm", f"{_FACTORY}round_peg_8mm_loose.obj", (0.0, 8.0)),
    MeshPart("round peg, 16 mm", f"{_FACTORY}round_peg_16mm_loose.obj", (0.0, 8.0)),
    MeshPart("rectangular peg, 8 mm", f"{_FACTORY}rectangular_peg_8mm_loose_subdiv_3x.obj", (0.0, 8.0)),
    MeshPart("rectangular peg, 16 mm", f"{_FACTORY}rectangular_peg_16mm_loose_subdiv_3x.obj", (0.0, 8.0)),
    MeshPart("M12 bolt", f"{_FACTORY}bolt_m12_loose.obj", (0.0, 10.0)),
    MeshPart("USB plug", "meshes_realsense/plug.stl", (0.0, 20.0), flat=True, along=0),
)


def measure(part: MeshPart, folder: Path, rung: Rung, start: Start, seeds: range) -> list[Score]:
    """Localize a part in one contact per seed, with the first noise; errors are over observable directions.

    If a rung raises an error, the guess is used.
    """
    params = rung.params()
    scores = []
    for seed, grasp in enumerate(grasps(part.press(folder), NOISES[0], seeds)):
        guess = grasp.guess(start, seed)
        try:
            found = grasp.localized(guess, params)
        except RegisterError:
            found = guess
        scores.append(grasp.score(found))
    return scores


def main(arguments: list[str] | None = None) -> int:
    """Fill the table of meshes in docs/real-recordings.md."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.meshes", description=__doc__)
    parser.add_argument(
        "--meshes", type=Path, required=True, help="folder of factory_meshes and meshes_realsense"
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    parser.add_argument("--contacts", type=int, default=10, help="contacts of every part")
    options = parser.parse_args(arguments)
    rungs = list(rungs_of("register"))
    rows = []
    for part in PARTS:
        print(part.name)
        cells = []
        for rung in rungs:
            scores = measure(part, options.meshes, rung, STARTS[0], range(options.contacts))
            angle, shift = (
                np.median([getattr(s, name) for s in scores]) for name in ("angle_deg", "shift_mm")
            )
            cells.append(f"{sum(s.success for s in scores)}: {angle:.2f} / {1e3 * shift:.0f}")
        rows.append([part.name, *cells])
    head = ["part", *(rung.name for rung in rungs)]
    replace_between(options.docs / "real-recordings.md", "meshes", table(head, rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
