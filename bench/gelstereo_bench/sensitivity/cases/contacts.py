"""Contact by every rule, on finite-element gels and simple laws of the half for work, without images."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from gelstereo import Error
from gelstereo_bench.sensitivity.figures import Case, Evaluation
from outside.fields import DATA, Field
from outside.judge import f1
from outside.judge_contacts import PITCH_MM, ROWS, SURFACE_MM, Rule, group, salient

__all__ = ["load"]

Array = npt.NDArray[np.float64]

_SIGMA_MM = 0.005
_RULES: tuple[Rule, ...] = (("adaptive", 2.5), ("pressure", 1.0))


def _contacts() -> list[tuple[str, Array, npt.NDArray[np.bool_]]]:
    """Gel, moved markers with noise, and which of them touch."""
    along = (np.arange(ROWS) - 0.5 * (ROWS - 1)) * PITCH_MM
    y, x = np.meshgrid(along, along, indexing="ij")
    points = np.stack((x.ravel() + 0.17, y.ravel() - 0.29), axis=1)
    flat = np.column_stack((points, np.full(len(points), SURFACE_MM)))
    found = [("", flat, np.zeros(len(flat), bool))]
    for path in sorted(DATA.glob("*.npz")):
        contact = Field.load(path.stem)
        for stage in range(len(contact.stages)) if contact.meta["half"] == "w" else ():
            true = contact.touching(stage, points)
            moved = flat + contact.motion(stage, points)
            moved[:, 2] += np.random.default_rng([len(path.stem), stage]).normal(0, _SIGMA_MM, len(points))
            if true.sum() >= 4:
                found.append((group(contact), moved, true))
    return found


def load() -> dict[str, Case]:
    """Read all contacts: a case for each rule."""
    (_, flat, _), *contacts = _contacts()

    def case(rule: str, length: float) -> Case:
        def evaluate() -> Evaluation:
            out, scores = Evaluation(), defaultdict(list)
            for gel, moved, true in contacts:
                try:
                    flags = salient(flat, moved, _SIGMA_MM, rule, length)
                except Error:
                    flags = np.zeros(len(flat), bool)
                out.see(flags)
                scores[gel].append(f1(flags, true))
            for gel, each in sorted(scores.items()):
                out.put(f"{rule}, {gel}: contact F1, %", 100.0 * float(np.mean(each)))
            return out

        return Case(evaluate)

    return {f"{rule}, contacts": case(rule, length) for rule, length in _RULES}
