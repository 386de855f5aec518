"""What the shape of a print under a ball tells of its depth: `python -m outside.shape [--half w]`.

`gelstereo.setup.print_depth` finds the depth at which the skin over a print has the ball's radius. Its height
is free, as nothing tells how deep the ball is. To first order, an error e of the law at the markers gives an
error - (g e) / (g g) of the depth, where g is how far the skin moves for each millimetre of depth; what the
ball's middle can take up is taken out of both. Independent noise of a marker gives noise / sqrt(g g).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import gelstereo
from gelstereo.setup.ball import INNER, MIN_MARKERS, MIN_OF_PRESS, SHAPE_SHARE, BallPress, inner_markers

from .judge_skin import SIDE, Print, by_press, learned

Array = npt.NDArray[np.float64]

#: Noise of a marker in depth, mm, as of docs/force.md.
NOISE_MM = 0.005
STEP_MM = 0.01


@dataclass(frozen=True)
class Told:
    """What the presses of a ball tell.

    Attributes
    ----------
    markers : int
    radius_mm : float
        Of the largest contact.
    signal : float
        How far a change of the depth moves the skin from a ball, over that change, rms.
    of_offset : float
        The same of a skin that lies as far from the print everywhere, for small contacts.
    law_mm : float
        How far the skin with the true depth is from a ball, rms.
    error_mm, noise_mm : float
        Error of the depth by the law, and its standard deviation by the markers' noise.
    """

    markers: int
    radius_mm: float
    signal: float
    of_offset: float
    law_mm: float
    error_mm: float
    noise_mm: float


def told(presses: list[Print]) -> Told | None:
    """To first order about the true depth; None for too few markers."""
    moved, off, offset = [], [], []
    for each in presses:
        rest = gelstereo.RestSurface(each.rest_mm)
        inside = inner_markers(rest, BallPress(each.points_mm, each.away_mm < each.touching_mm))
        if inside.sum() < MIN_OF_PRESS:
            continue
        here, there = (
            _skin(rest, each, depth_mm)[inside] for depth_mm in (each.depth_mm, each.depth_mm + STEP_MM)
        )
        away = here - each.ball_mm
        along = away / np.linalg.norm(away, axis=1)[:, None]
        moved.append(_without_middle(np.sum((there - here) * along, axis=1) / STEP_MM, along))
        off.append(_without_middle(each.error_mm(here), along))
        offset.append((INNER * each.touching_mm) ** 2 / (2.0 * np.sqrt(12.0) * each.radius_mm**2))
    if sum(map(len, moved)) < MIN_MARKERS:
        return None
    g, e = np.concatenate(moved), np.concatenate(off)
    counts = [len(each) for each in moved]
    return Told(
        len(g),
        max(each.touching_mm for each in presses),
        float(np.sqrt(np.mean(g**2))),
        float(np.sqrt(np.average(np.square(offset), weights=counts))),
        float(np.sqrt(np.mean(e**2))),
        float(-(g @ e) / (g @ g)),
        float(NOISE_MM / np.sqrt(g @ g)),
    )


def _skin(rest: gelstereo.RestSurface, each: Print, depth_mm: float) -> Array:
    nothing = np.zeros((len(each.rest_mm), 3, 3))
    return np.asarray(gelstereo.skin_over(rest, each.points_mm, nothing, cols=SIDE, depth_mm=depth_mm)[0])


def _without_middle(values: Array, along: Array) -> Array:
    """Less what a motion of the ball's middle explains."""
    return np.asarray(values - along @ np.linalg.lstsq(along, values, rcond=None)[0])


def main() -> None:
    """Print a table by gel, depth and ball."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("w", "j"), default="w")
    print(
        "| gel, mm | depth, mm | ball, mm | contact, mm | markers | signal, um a 0.1 mm | of an offset | "
        "law, um | error of the depth, mm | found | noise, mm |"
    )
    print("|---" * 11 + "|")
    for (thickness_mm, depth_mm, radius_mm), presses in sorted(by_press(parser.parse_args().half).items()):
        it, depth = told(presses), learned(presses)
        if it is None or depth is None:
            continue
        found_mm = SHAPE_SHARE * depth.depth_mm - depth_mm
        cells = [
            f"{thickness_mm:g}",
            f"{depth_mm:g}",
            f"{radius_mm:g}",
            f"{it.radius_mm:.1f}",
            f"{it.markers}",
        ]
        cells += [f"{100 * it.signal:.1f}", f"{100 * it.of_offset:.1f}", f"{1e3 * it.law_mm:.1f}"]
        cells += [f"{it.error_mm:+.2f}", f"{found_mm:+.2f}", f"{it.noise_mm:.2f}"]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
