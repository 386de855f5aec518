"""The skin over prints that lie below it: `python -m outside.judge_skin [--half w] [--learn]`.

Layers inside gels that were solved by finite elements are taken for prints. `gelstereo.skin_over` gives the
skin over their markers, and `gelstereo.force.PressedSkin` the skin that allows for the contact's pressure;
its distance from the ball is the error. Beside them stand the skin at constant thickness and the markers
themselves. With `--learn`, the depth of the print is learned under the largest ball
of a gel, and the skin is judged under the others.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import gelstereo
from gelstereo.force import PressedSkin
from gelstereo.setup.ball import BallPress, PrintDepth, print_depth

from .contacts import table
from .skin import ALONG_MM, DATA, DEPTHS_MM, FURTHER

Array = npt.NDArray[np.float64]

#: Pitch of the prints, and where their lattices stand to the ball, mm.
PITCH_MM = 0.85
OFFSETS_MM = ((0.0, 0.0), (0.21, -0.13), (0.4, 0.3))
SIDE = 15
#: Standard deviations that the estimate of forces takes for the markers, as of docs/force.md.
NOISE_MM = (0.0015, 0.0015, 0.005)
#: Rings of a contact, in shares of its radius.
RINGS = {"inner": (0.0, 0.7), "edge": (0.7, 0.95)}


@dataclass(frozen=True)
class Print:
    """A print under a ball. Positions are from the axis, z away from the gel's back."""

    rest_mm: Array
    points_mm: Array
    depth_mm: float
    ball_mm: Array
    radius_mm: float
    touching_mm: float
    gel: str

    @property
    def away_mm(self) -> Array:
        """Distance of each marker from the axis, at rest."""
        return np.asarray(np.hypot(self.rest_mm[:, 0], self.rest_mm[:, 1]))

    def error_mm(self, points_mm: Array) -> Array:
        """Signed distance from the ball."""
        return np.asarray(np.linalg.norm(points_mm - self.ball_mm, axis=1) - self.radius_mm)


def prints(half: str | None = None, folder: Path = DATA) -> Iterator[Print]:
    """All prints of a half, or of both; or of further gels in another folder."""
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as file:
            meta, touching, motion = json.loads(str(file["meta"])), file["touching_mm"], file["motion_mm"]
        if half not in (None, meta["half"]):
            continue
        for stage, pressed_mm in enumerate(meta["depths_mm"]):
            ball_mm = np.array([0.0, 0.0, meta["thickness_mm"] - pressed_mm + meta["radius_mm"]])
            for level, depth_mm in enumerate(DEPTHS_MM[1:], start=1):
                for offset in OFFSETS_MM:
                    rest, points = _moved(motion[stage, level], offset, meta["thickness_mm"] - depth_mm)
                    yield Print(
                        rest,
                        points,
                        depth_mm,
                        ball_mm,
                        meta["radius_mm"],
                        float(touching[stage]),
                        meta["gel"],
                    )


def _moved(motion_mm: Array, offset: tuple[float, float], z_mm: float) -> tuple[Array, Array]:
    along = PITCH_MM * (np.arange(SIDE) - SIDE // 2)
    x, y = (axis.ravel() for axis in np.meshgrid(along + offset[0], along + offset[1]))
    r = np.hypot(x, y)
    out, up = (np.interp(r, ALONG_MM, motion_mm[:, axis]) for axis in (0, 1))
    grown = 1.0 + out / np.maximum(r, 1e-9)
    rest = np.column_stack([x, y, np.full(len(r), z_mm)])
    return rest, np.column_stack([grown * x, grown * y, z_mm + up])


def skins(each: Print) -> dict[str, Array]:
    """Estimates of the skin. The cameras look along z, so that the part lies behind the gel."""
    rest = gelstereo.RestSurface(each.rest_mm)
    nothing = np.zeros((len(each.rest_mm), 3, 3))
    skin, _ = gelstereo.skin_over(rest, each.points_mm, nothing, cols=SIDE, depth_mm=each.depth_mm)
    toward = (skin - each.points_mm) / np.linalg.norm(skin - each.points_mm, axis=1)[:, None]
    return {
        "skin": skin,
        "constant thickness": each.points_mm + each.depth_mm * toward,
        "markers": each.points_mm,
    }


@cache
def gels() -> dict[str, Any]:
    """Thickness and Poisson's ratio of the gels."""
    return {**table()["gels"], **FURTHER}


def under_pressure(each: Print) -> Array:
    """The skin that allows for the pressure; the gel's thickness and Poisson's ratio are known."""
    gel = gels()[each.gel]
    force = {
        "method": "bounded",
        "thickness_mm": gel["thickness_mm"],
        "poisson_ratio": gel["poisson_ratio"],
        # Pressures over it do not depend on it.
        "young_kpa": 1.0,
    }
    params = gelstereo.Params().replace({"lattice.depth_mm": each.depth_mm}, force=force)
    noise = np.tile(np.diag(np.square(NOISE_MM)), (len(each.rest_mm), 1, 1))
    rest = gelstereo.RestSurface(each.rest_mm)
    estimator = PressedSkin(rest, params, cols=SIDE, covariance_mm2=noise)
    return estimator.run(each.points_mm, noise, each.away_mm < each.touching_mm)[0]


def by_press(half: str | None = None) -> dict[tuple[float, float, float], list[Print]]:
    """Prints at the first offset, by thickness of the gel, depth of the print and radius of the ball."""
    found = defaultdict(list)
    for number, each in enumerate(prints(half)):
        if number % len(OFFSETS_MM) == 0:
            thickness_mm = round(float(each.rest_mm[0, 2]) + each.depth_mm, 3)
            found[thickness_mm, each.depth_mm, each.radius_mm].append(each)
    return dict(found)


def learned(presses: list[Print]) -> PrintDepth | None:
    """The depth of a print from presses of one ball."""
    frames = [BallPress(each.points_mm, each.away_mm < each.touching_mm) for each in presses]
    rest = gelstereo.RestSurface(presses[0].rest_mm)
    return print_depth(rest, frames, cols=SIDE, radius_mm=presses[0].radius_mm)


def skin_rms_mm(presses: list[Print], depth_mm: float) -> float:
    """rms distance of the skin from the ball in the inner ring, for a depth of the print."""
    off = []
    for each in presses:
        nothing = np.zeros((len(each.rest_mm), 3, 3))
        rest = gelstereo.RestSurface(each.rest_mm)
        skin, _ = gelstereo.skin_over(rest, each.points_mm, nothing, cols=SIDE, depth_mm=depth_mm)
        off.append(each.error_mm(np.asarray(skin))[each.away_mm < RINGS["inner"][1] * each.touching_mm])
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def print_learned(half: str | None) -> None:
    """Print a table of learned depths, and of the skins that follow."""
    presses = by_press(half)
    print("| gel, mm | depth, mm | learned, mm | skin with it, rms um | with the true depth | the markers |")
    print("|---|---|---|---|---|---|")
    for thickness_mm, depth_mm in sorted({key[:2] for key in presses}):
        balls = sorted(key[2] for key in presses if key[:2] == (thickness_mm, depth_mm))
        found = learned(presses[thickness_mm, depth_mm, balls[-1]])
        others = [each for ball in balls[:-1] for each in presses[thickness_mm, depth_mm, ball]]
        if found is None:
            continue
        rms = [1e3 * skin_rms_mm(others, depth) for depth in (found.depth_mm, depth_mm, 0.0)]
        cells = " | ".join(f"{each:.0f}" for each in rms)
        print(f"| {thickness_mm:g} | {depth_mm} | {found.depth_mm:.2f} ± {found.sigma_mm:.2f} | {cells} |")


def main() -> None:
    """Print a table: depth of the print, ring, and errors in um."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("w", "j"))
    parser.add_argument("--learn", action="store_true", help="learn the depth of the print from a ball")
    parser.add_argument("--folder", type=Path, default=DATA, help="of `outside.skin --further`")
    arguments = parser.parse_args()
    if arguments.learn:
        print_learned(arguments.half)
        return
    errors: dict[tuple[float, str, str], list[Array]] = defaultdict(list)
    for each in prints(arguments.half, arguments.folder):
        for name, points_mm in {**skins(each), "under pressure": under_pressure(each)}.items():
            off_um = 1e3 * each.error_mm(points_mm)
            for ring, (low, high) in RINGS.items():
                inside = (low * each.touching_mm <= each.away_mm) & (each.away_mm < high * each.touching_mm)
                errors[each.depth_mm, ring, name].append(off_um[inside])
    print(
        "| depth, mm | ring | markers | skin, mean / rms, um | under pressure | constant thickness | the "
        "markers themselves |"
    )
    print("|---|---|---|---|---|---|---|")
    for depth_mm in DEPTHS_MM[1:]:
        for ring in RINGS:
            found = {
                name: np.concatenate(errors[depth_mm, ring, name])
                for name in ("skin", "under pressure", "constant thickness", "markers")
            }
            cells = [f"{off.mean():.1f} / {np.sqrt(np.mean(off**2)):.1f}" for off in found.values()]
            print(f"| {depth_mm} | {ring} | {len(found['skin'])} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
