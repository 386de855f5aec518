"""Mesh convergence of the stored contacts: `python -m outside.convergence [--blocks]`.

Balls on a disc against meshes of half and a quarter of the element size. With `--blocks`, three dimensions: a
ball on blocks against the finest disc, and a solid of `contacts.toml` against a finer block.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator, RectBivariateSpline

from . import contacts, fem
from .parts import Part

Array = npt.NDArray[np.float64]

FAR = np.linspace(0.0, 8.0, 161)
# Points for the comparison of solids: all around, to 8 mm from the middle.
ROUND = np.linspace(-8.0, 8.0, 65)
BALL_BLOCKS_MM = (0.5, contacts.SOLID_MM)
SOLID, SOLID_STAGES, SOLID_BLOCKS_MM = "cylinder_2", 3, (0.6, 0.42, contacts.SOLID_MM, 0.21)


@dataclass(frozen=True)
class Last:
    """The last stage: displacement at the compared points, a measure of the contact's size, and the force."""

    motion: Array
    contact: float
    force: float

    def row(self, finest: Last) -> str:
        """Table cells: deviation from the finest mesh per component of displacement, contact and force."""
        off = 1000 * (self.motion - finest.motion)
        cells = [f"{np.abs(o).max():.1f} / {np.sqrt((o**2).mean()):.1f}" for o in off]
        return " | ".join([*cells, f"{self.contact:.3f}", f"{self.force:.2f}"])


def ball(gel: dict[str, float], radius: float, stages: list[list[float]], fine: float) -> Last:
    """Heights at distances FAR from the axis, the radius of contact, and the force."""
    thickness, rim = gel["thickness_mm"], float(np.sqrt(2 * radius * stages[-1][0]))
    layer = fem.disc(thickness, gel["poisson_ratio"], contacts.HALF_MM, fine * rim / 14, 1.2 * rim)
    *_, last = contacts.press(layer, Part("ball", (radius,) * 3), gel["friction"], stages)
    r = layer.places[:, 0]
    edge = float(r[last.pressures > 0].max())
    force = 2 * np.pi * float((last.pressures * layer.areas).sum())
    return Last(PchipInterpolator(r, last.motion[layer.surface_dofs[:, 1]])(FAR)[None], edge, force)


def pressed_block(
    gel: dict[str, float], part: Part, stages: list[list[float]], fine: float
) -> tuple[list[RectBivariateSpline], float, float]:
    """Displacement along the axes over y and x, the area of contact, and the force."""
    reach = contacts.reach_of(part, stages)
    layer = fem.block(gel["thickness_mm"], gel["poisson_ratio"], contacts.HALF_MM, fine, reach)
    *_, last = contacts.press(layer, part, gel["friction"], stages)
    x, y = np.unique(layer.places[:, 0]), np.unique(layer.places[:, 1])
    grids = last.motion[layer.surface_dofs].reshape(len(y), len(x), 3)
    splines = [RectBivariateSpline(y, x, grids[..., k]) for k in range(3)]
    return splines, float((last.shares * layer.areas).sum()), float((last.pressures * layer.areas).sum())


def ball_on_block(gel: dict[str, float], radius: float, stages: list[list[float]], fine: float) -> Last:
    """As `ball`, along the x axis of a block."""
    splines, area, force = pressed_block(gel, Part("ball", (radius,) * 3), stages, fine)
    return Last(splines[2](0.0, FAR), float(np.sqrt(area / np.pi)), force)


def solid(name: str, fine: float) -> Last:
    """Displacement of the gel under a solid along x, y and z, the area of contact, and the force."""
    table = contacts.table()
    entry = table["solids"][name]
    gel, stages = table["gels"][entry["gel"]], entry["stages"][:SOLID_STAGES]
    splines, area, force = pressed_block(gel, Part.read(entry["part"]), stages, fine)
    return Last(np.stack([s(ROUND, ROUND) for s in splines]), area, force)


def write(*cells: str) -> None:
    """Print a row of a table immediately."""
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


def balls(blocks: bool) -> None:
    """A row for every mesh under two balls; for the first ball, also blocks."""
    table = contacts.table()
    write("gel, ball, depth (mm)", "mesh", "height, largest / rms (um)", "contact radius (mm)", "force")
    write(*["---"] * 5)
    for key, radius in (("a", 3.0), ("b", 1.6)):
        gel = table["gels"][key]
        stages = contacts.ball_stages(radius, gel["thickness_mm"], [0.5, 0.8])
        finest = ball(gel, radius, stages, 0.25)
        found = {f"1/{round(1 / fine)}": ball(gel, radius, stages, fine) for fine in (1.0, 0.5)}
        found["1/4"] = finest
        for fine in BALL_BLOCKS_MM if blocks and key == "a" else ():
            found[f"block, {fine} mm"] = ball_on_block(gel, radius, stages, fine)
        for name, last in found.items():
            write(f"{key}, {radius}, {stages[-1][0]}", name, last.row(finest))


def solids() -> None:
    """A row for every mesh under a solid."""
    sizes = sorted(SOLID_BLOCKS_MM)
    finest = solid(SOLID, sizes[0])
    names = [f"motion along {axis}, largest / rms (um)" for axis in "xyz"]
    write("elements (mm)", *names, "contact area (mm2)", "force")
    write(*["---"] * 6)
    for fine in sizes:
        write(str(fine), (finest if fine == sizes[0] else solid(SOLID, fine)).row(finest))


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blocks", action="store_true", help="three dimensions too: half an hour")
    blocks = parser.parse_args().blocks
    balls(blocks)
    if blocks:
        sys.stdout.write("\n")
        solids()
    return 0


if __name__ == "__main__":
    sys.exit(main())
