"""Evaluate contact detection on all stored contacts, without images: `python -m outside.judge_contacts
[--half w|j] [--noise-um SIGMA]`.

Markers 0.85 mm apart have the true displacement and noise along z, and the rules classify them. F1 is the
mean over contacts with at least four markers in contact. `found` is the share of contacts, among those with a
marker in contact, in which at least one is found. The last column is a reference that is given the gel's
thickness and Poisson's ratio (`layer_contact`); it states what the pitch of the markers allows.
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


def salient(flat: Array, moved: Array, sigma_mm: float, rule: str, setting: float) -> Flags:
    """Markers in contact by a rule and its parameter in mm, a threshold or a decay length."""
    rest = gelstereo.RestSurface(flat)
    indentation = rest.indentation_mm(moved)
    if rule == "depth":
        return np.asarray(indentation > setting)
    variance = np.full(len(flat), sigma_mm**2)
    if rule == "adaptive":
        found, _ = gelstereo.adaptive_saliency(
            rest, indentation, variance, rows=ROWS, cols=ROWS, max_decay_mm=setting
        )
        return np.asarray(found).ravel()
    found, _ = gelstereo.pressure_saliency(
        rest, indentation, variance, rows=ROWS, cols=ROWS, decay_mm=setting
    )
    return np.asarray(found).ravel()


def judge(sigma_mm: float, half: str, rules: list[Rule]) -> dict[str, dict[Rule, Scores]]:
    """Scores of every rule on the contacts of a half, by law or gel."""
    along = (np.arange(ROWS) - 0.5 * (ROWS - 1)) * PITCH_MM
    y, x = np.meshgrid(along, along, indexing="ij")
    # Lattice offset from the part's middle, as in practice.
    points = np.stack((x.ravel() + 0.17, y.ravel() - 0.29), axis=1)
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
                flags = salient(flat, moved, sigma_mm, *rule)
                scores[group(contact)][rule].add(flags, true)
            gel = gels.get(contact.meta.get("gel"))
            if gel is not None and true.any():
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
    arguments = parser.parse_args()
    sigma_mm, titles = arguments.noise_um / 1000, {"w": "for work", "j": "judged"}
    for half in arguments.half or titles:
        title = titles[half]
        scores = judge(sigma_mm, half, RULES)
        names = " | ".join(f"{rule} {setting}" for rule, setting in [*RULES, REFERENCE])
        sys.stdout.write(f"\n{title}\n\n| law | contacts | {names} |\n" + (len(RULES) + 3) * "|---" + "|\n")
        for law, by_rule in sorted(scores.items()):
            cells = [by_rule[rule].cell() for rule in [*RULES, REFERENCE]]
            count = len(by_rule[RULES[0]].found)
            sys.stdout.write(f"| {law} | {count} | " + " | ".join(cells) + " |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
