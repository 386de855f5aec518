"""How far the meshes of the stored contacts are from finer ones: `python -m outside.convergence`.

Balls on a disc against meshes of half and a quarter of the element size; the block's mesh against the disc's.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator, RectBivariateSpline

from . import contacts, fem
from .parts import Part

Array = npt.NDArray[np.float64]

FAR = np.linspace(0.0, 8.0, 161)


def ball(
    gel: dict[str, float], radius: float, stages: list[list[float]], fine: float
) -> tuple[Array, float, float]:
    """Motion along z at distances FAR from the axis in the last stage, the radius of contact, and the force."""
    thickness, rim = gel["thickness_mm"], float(np.sqrt(2 * radius * stages[-1][0]))
    layer = fem.disc(thickness, gel["poisson_ratio"], contacts.HALF_MM, fine * rim / 14, 1.2 * rim)
    *_, last = contacts.press(layer, Part("ball", (radius,) * 3), gel["friction"], stages)
    r = layer.places[:, 0]
    edge = float(r[last.pressures > 0].max())
    force = 2 * np.pi * float((last.pressures * layer.areas).sum())
    return PchipInterpolator(r, last.motion[layer.surface_dofs[:, 1]])(FAR), edge, force


def block(
    gel: dict[str, float], radius: float, stages: list[list[float]], fine: float
) -> tuple[Array, float, float]:
    """The same in three dimensions, along the x axis."""
    reach = float(np.sqrt(2 * radius * stages[-1][0])) + 1.0
    layer = fem.block(gel["thickness_mm"], gel["poisson_ratio"], contacts.HALF_MM, fine, (reach, reach))
    *_, last = contacts.press(layer, Part("ball", (radius,) * 3), gel["friction"], stages)
    x, y = np.unique(layer.places[:, 0]), np.unique(layer.places[:, 1])
    grid = last.motion[layer.surface_dofs[:, 2]].reshape(len(y), len(x))
    edge = float(np.hypot(*layer.places[last.pressures > 0, :2].T).max())
    along = RectBivariateSpline(y, x, grid)(np.zeros_like(FAR), FAR, grid=False)
    return along, edge, float((last.pressures * layer.areas).sum())


def main() -> int:
    """Print a row for every mesh."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--block", action="store_true", help="the block's mesh too; minutes")
    blocks = parser.parse_args().block
    table = contacts.table()
    sys.stdout.write(
        "| gel, ball, depth (mm) | mesh | height from the finest, largest / rms (um) | contact radius (mm) | force |\n"
    )
    sys.stdout.write("|---|---|---|---|---|\n")
    for key, radius, solid in (("a", 3.0, True), ("b", 1.6, False)):
        gel = table["gels"][key]
        stages = contacts.ball_stages(radius, gel["thickness_mm"], [0.5, 0.8])
        finest = ball(gel, radius, stages, 0.25)
        found = {f"disc, 1/{round(1 / fine)}": ball(gel, radius, stages, fine) for fine in (1.0, 0.5)}
        found["disc, 1/4"] = finest
        if solid and blocks:
            found[f"block, {contacts.SOLID_MM} mm"] = block(gel, radius, stages, contacts.SOLID_MM)
        for name, (height, edge, force) in found.items():
            off = 1000 * (height - finest[0])
            sys.stdout.write(
                f"| {key}, {radius}, {stages[-1][0]} | {name} "
                f"| {np.abs(off).max():.1f} / {np.sqrt((off**2).mean()):.1f} | {edge:.3f} | {force:.3f} |\n"
            )
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
