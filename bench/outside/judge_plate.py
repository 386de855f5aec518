"""A plate over the layer below a print: `python -m outside.judge_plate [--half w]`.

`gelstereo_bench.reports.stiff_skin` puts a plate on an elastic layer to describe a real gel. Here the same is
done where the gel is known: one material, solved by finite elements under balls, with prints at several
depths. The markers in contact are prescribed and the others predicted, by a layer as thick as the gel below
the print and a plate of the gel's own modulus.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from gelstereo_bench.reports.physics import Gel, Press, off, rms
from gelstereo_bench.reports.stiff_skin import Skin, compliance, predicted

from .contacts import HALF_MM, table
from .skin import ALONG_MM, DATA, DEPTHS_MM

Array = npt.NDArray[np.float64]

PITCH_MM, SIDE = 1.0, 17
RIM_MM = HALF_MM - PITCH_MM * (SIDE // 2)
#: Thicknesses of the plate, mm; 0 is none.
PLATES_MM = (0.0, 0.2, 0.4, 0.8, 1.2, 1.6)
MIN_TOUCHING = 4


def presses(half: str) -> dict[tuple[str, float], list[Press]]:
    """The deepest stage under each ball, by gel and depth of the print."""
    along = PITCH_MM * (np.arange(SIDE) - SIDE // 2)
    x, y = np.meshgrid(along, along)
    away, found = np.hypot(x, y), defaultdict(list)
    for path in sorted(DATA.glob("*.npz")):
        with np.load(path) as file:
            meta, touching, motion = json.loads(str(file["meta"])), file["touching_mm"], file["motion_mm"]
        touches = away < touching[-1]
        if meta["half"] != half or touches.sum() < MIN_TOUCHING:
            continue
        for depth_mm, level in zip(DEPTHS_MM, motion[-1], strict=True):
            out, up = (np.interp(away, ALONG_MM, level[:, axis]) for axis in (0, 1))
            grown = out / np.maximum(away, 1e-9)
            moved = np.stack([grown * x, grown * y, -up], axis=-1)
            # Motion is stored to 9 mm.
            found[meta["gel"], depth_mm].append(Press(moved, touches, ~touches & (away < 8.5)))
    return dict(found)


def left(part: Sequence[Press], gel: Gel, plates_mm: Sequence[float] = PLATES_MM) -> list[float]:
    """Share of the free markers' motion that a layer under each plate leaves."""
    inverse = np.linalg.inv(compliance(gel, (SIDE, SIDE), PITCH_MM, RIM_MM))
    layer = 0.5 * PITCH_MM**2 * (inverse + inverse.T)
    moved = rms(off(np.zeros_like(p.motion_mm), p, slice(0, 3)) for p in part)
    found = []
    for thickness_mm in plates_mm:
        stiffness = layer + Skin(thickness_mm, 1.0).stiffness((SIDE, SIDE), PITCH_MM)
        found.append(rms(off(predicted(stiffness, p), p, slice(0, 3)) for p in part) / moved)
    return found


def main() -> None:
    """Print a table by gel and depth of the print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("w", "j"), default="w")
    heads = " | ".join(f"plate {each:g} mm, %" if each else "no plate, %" for each in PLATES_MM)
    print(f"| gel, mm | depth, mm | layer, mm | {heads} |")
    print("|---" * (3 + len(PLATES_MM)) + "|")
    for (name, depth_mm), part in presses(parser.parse_args().half).items():
        gel = table()["gels"][name]
        below = Gel(round(gel["thickness_mm"] - depth_mm, 3), gel["poisson_ratio"])
        shares = " | ".join(f"{100 * share:.0f}" for share in left(part, below))
        print(f"| {gel['thickness_mm']:g} | {depth_mm:g} | {below.thickness_mm:g} | {shares} |")


if __name__ == "__main__":
    main()
