"""Judge contact on all stored contacts, without images: `python -m outside.judge_contacts [--noise-um SIGMA]`.

Markers 0.85 mm apart carry the true motion and noise along z; the two rules say which of them touch. F1 is the mean
over contacts under which four markers or more touch; `found` is the share of all contacts with a touching marker of
which at least one is found.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict

import gelstereo
import numpy as np
import numpy.typing as npt

from .fields import DATA, Field
from .judge import Flags, f1

Array = npt.NDArray[np.float64]

ROWS, PITCH_MM, SURFACE_MM = 25, 0.85, 27.0


def group(name: str, field: Field) -> str:
    """What a contact counts for: its law, or its gel."""
    return str(field.meta.get("law") or f"gel {field.meta['gel']}")


def salient(flat: Array, moved: Array, sigma_mm: float, rule: str, setting: float) -> Flags:
    """Which markers touch, by pressure with a decay length or by depth beyond a threshold, both in mm."""
    rest = gelstereo.RestSurface(flat)
    indentation = rest.indentation_mm(moved)
    if rule == "depth":
        return np.asarray(indentation > setting)
    variance = np.full(len(flat), sigma_mm**2)
    found, _ = gelstereo.pressure_saliency(
        rest, indentation, variance, rows=ROWS, cols=ROWS, decay_mm=setting
    )
    return np.asarray(found).ravel()


def main() -> int:
    """Print a table for each half."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--noise-um", type=float, default=5.0)
    sigma = parser.parse_args().noise_um / 1000
    rules = [("pressure", d) for d in (0.7, 1.0, 1.6, 2.5)] + [("depth", d) for d in (0.35, 0.1)]
    along = (np.arange(ROWS) - 0.5 * (ROWS - 1)) * PITCH_MM
    y, x = np.meshgrid(along, along, indexing="ij")
    # Off the part's middle, as parts are.
    points = np.stack((x.ravel() + 0.17, y.ravel() - 0.29), axis=1)
    flat = np.column_stack((points, np.full(len(points), SURFACE_MM)))
    scores: dict[tuple[str, str], dict[tuple[str, float], list[float]]] = defaultdict(
        lambda: defaultdict(list)
    )
    found: dict[tuple[str, str], dict[tuple[str, float], list[bool]]] = defaultdict(lambda: defaultdict(list))
    for path in sorted(DATA.glob("*.npz")):
        field = Field.load(path.stem)
        key = (str(field.meta["half"]), group(path.stem, field))
        for stage in range(len(field.stages)):
            true = field.touching(stage, points)
            noise = np.random.default_rng([len(path.stem), stage]).normal(0, sigma, len(points))
            moved = flat + field.motion(stage, points)
            moved[:, 2] += noise
            for rule in rules if true.any() else []:
                flags = salient(flat, moved, sigma, *rule)
                found[key][rule].append(bool((flags & true).any()))
                if true.sum() >= 4:
                    scores[key][rule].append(f1(flags, true))
    for half, title in (("w", "for work"), ("j", "judged")):
        names = " | ".join(f"{rule} {setting}" for rule, setting in rules)
        sys.stdout.write(f"\n{title}\n\n| law | contacts | {names} |\n" + (len(rules) + 2) * "|---" + "|\n")
        for key in sorted(k for k in found if k[0] == half):
            cells = [
                f"{np.mean(scores[key][rule]):.2f} ({100 * np.mean(found[key][rule]):.0f} %)"
                for rule in rules
            ]
            sys.stdout.write(f"| {key[1]} | {len(found[key][rules[0]])} | " + " | ".join(cells) + " |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
