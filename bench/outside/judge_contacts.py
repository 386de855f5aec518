"""Evaluate contact detection on all stored contacts, without images: `python -m outside.judge_contacts
[--half w|j] [--noise-um SIGMA] [--layout square|hexagonal]`.

Markers 0.85 mm apart have the true displacement and noise along z, and the rules classify them. F1 is the
mean over contacts with at least four markers in contact. `found` is the share of contacts, among those with a
marker in contact, in which at least one is found. The last column is a reference that is given the gel's
thickness and Poisson's ratio (`layer_contact`); it states what the pitch of the markers allows. It works on
square prints only.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

import gelstereo

from . import layer_contact
from .contacts import table
from .fields import DATA, Field
from .judge import Flags, f1

Array = npt.NDArray[np.float64]

Rule = tuple[str, float]

ROWS, PITCH_MM, SURFACE_MM = 25, 0.85, 27.0
#: Rows of a print; those of a hexagonal one are nearer to each other.
ROWS_OF = {"square": ROWS, "hexagonal": 29}
RULES: list[Rule] = [
    ("adaptive", 2.5),
    *(("pressure", decay_mm) for decay_mm in (0.7, 1.0, 1.6, 2.5)),
    *(("depth", threshold_mm) for threshold_mm in (0.35, 0.1)),
]
#: Needs a gel that is a layer.
REFERENCE: Rule = ("layer, gel known", layer_contact.SHARE)


@dataclass
class Scores:
    """Scores of one rule: F1 of contacts with at least four markers in contact; whether at least one is
    found.
    """

    f1: list[float] = field(default_factory=list)
    found: list[bool] = field(default_factory=list)

    def add(self, flags: Flags, true: Flags) -> None:
        """Add a contact with at least one marker in contact."""
        self.found.append(bool((flags & true).any()))
        if true.sum() >= 4:
            self.f1.append(f1(flags, true))

    def cell(self) -> str:
        """Mean F1, and the share of contacts that were found."""
        return f"{np.mean(self.f1):.2f} ({100 * np.mean(self.found):.0f} %)" if self.f1 else ""


def group(contact: Field) -> str:
    """Group of a contact: its law, or its gel."""
    return str(contact.meta.get("law") or f"gel {contact.meta['gel']}")


def print_mm(layout: str) -> Array:
    """(N, 2) places of a print's markers, row by row, about its middle."""
    row, col = (grid.ravel().astype(float) for grid in np.mgrid[: ROWS_OF[layout], :ROWS])
    if layout == "hexagonal":
        row, col = np.sqrt(0.75) * row, col + 0.5 * (row % 2)
    places = PITCH_MM * np.stack([col, row], axis=1)
    return np.asarray(places - 0.5 * (places.min(axis=0) + places.max(axis=0)))


def salient(
    flat: Array, moved: Array, sigma_mm: float, rule: str, setting: float, layout: str = "square"
) -> Flags:
    """Markers in contact by a rule and its parameter in mm, a threshold or a decay length."""
    rest = gelstereo.RestSurface(flat)
    indentation = rest.indentation_mm(moved)
    if rule == "depth":
        return np.asarray(indentation > setting)
    variance = np.full(len(flat), sigma_mm**2)
    shape = {"rows": ROWS_OF[layout], "cols": ROWS, "layout": layout}
    if rule == "adaptive":
        found, _ = gelstereo.adaptive_saliency(rest, indentation, variance, **shape, max_decay_mm=setting)
        return np.asarray(found).ravel()
    found, _ = gelstereo.pressure_saliency(rest, indentation, variance, **shape, decay_mm=setting)
    return np.asarray(found).ravel()


def judge(
    sigma_mm: float, half: str, rules: list[Rule], layout: str = "square"
) -> dict[str, dict[Rule, Scores]]:
    """Scores of every rule on the contacts of a half, by law or gel."""
    # Lattice offset from the part's middle, as in practice.
    points = print_mm(layout) + [0.17, -0.29]
    flat = np.column_stack((points, np.full(len(points), SURFACE_MM)))
    gels = table()["gels"]
    scores: dict[str, dict[Rule, Scores]] = defaultdict(lambda: defaultdict(Scores))
    for path in sorted(DATA.glob("*.npz")):
        contact = Field.load(path.stem)
        if contact.meta["half"] != half:
            continue
        for stage in range(len(contact.stages)):
            true = contact.touching(stage, points)
            noise = np.random.default_rng([len(path.stem), stage]).normal(0, sigma_mm, len(points))
            moved = flat + contact.motion(stage, points)
            moved[:, 2] += noise
            for rule in rules if true.any() else []:
                flags = salient(flat, moved, sigma_mm, *rule, layout)
                scores[group(contact)][rule].add(flags, true)
            gel = gels.get(contact.meta.get("gel"))
            if gel is not None and true.any() and layout == "square":
                flags = layer_contact.touching(
                    flat[:, 2] - moved[:, 2], ROWS, PITCH_MM, gel["thickness_mm"], gel["poisson_ratio"]
                )
                scores[group(contact)][REFERENCE].add(flags, true)
    return scores


def main() -> int:
    """Print a table for each half, or for one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--noise-um", type=float, default=5.0)
    parser.add_argument("--half", choices=["w", "j"], help="both without")
    parser.add_argument("--layout", choices=sorted(ROWS_OF), default="square", help="of the print")
    arguments = parser.parse_args()
    sigma_mm, titles = arguments.noise_um / 1000, {"w": "for work", "j": "judged"}
    for half in arguments.half or titles:
        title = titles[half]
        scores = judge(sigma_mm, half, RULES, arguments.layout)
        names = " | ".join(f"{rule} {setting}" for rule, setting in [*RULES, REFERENCE])
        sys.stdout.write(f"\n{title}\n\n| law | contacts | {names} |\n" + (len(RULES) + 3) * "|---" + "|\n")
        for law, by_rule in sorted(scores.items()):
            cells = [by_rule[rule].cell() for rule in [*RULES, REFERENCE]]
            count = len(by_rule[RULES[0]].found)
            sys.stdout.write(f"| {law} | {count} | " + " | ".join(cells) + " |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
