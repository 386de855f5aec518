"""Contact detection: precision and recall against the true contact region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Pipeline, SimulatedFrame
from gelstereo_bench.frontier.rungs import EXACT, FAST, rungs_of
from gelstereo_bench.frontier.scenes import (
    BOARDS_MM,
    FACING_RAD,
    SURFACE_MM,
    VGA,
    board_shape,
    press,
    sphere_press,
)
from gelstereo_bench.frontier.table import Report, Table, Target

__all__ = ["Score", "measure_saliency"]

Flags = npt.NDArray[np.bool_]


def _presses(seed: int) -> dict[str, list[SimulatedFrame]]:
    """Contacts of several shapes; of the boards only the block touches."""
    scene = VGA.scene().replace({"seed": seed})
    lying: dict[str, Any] = {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 12.0}
    touch_mm = SURFACE_MM + 4.0
    scenes = {"ball, 1.2 mm": sphere_press(seed=seed)}
    scenes["cylinder, 1.2 mm"] = press(
        scene, lying, touch_mm + 0.2, touch_mm - 1.2, (float(np.pi) / 2.0, 0.0, 0.0)
    )
    for protrusion_mm in (BOARDS_MM[2], BOARDS_MM[-1]):
        start_mm = SURFACE_MM + protrusion_mm + 0.2
        # The plate stays clear of the gel.
        scenes[f"block, {protrusion_mm} mm"] = press(
            scene, board_shape(protrusion_mm + 1.0), start_mm + 1.0, SURFACE_MM + 1.0, FACING_RAD
        )
    return scenes


@dataclass
class Score:
    """Markers found in contact, truly in contact, and both, over several frames."""

    both: int = 0
    found: int = 0
    truth: int = 0

    def add(self, found: Flags, truth: Flags) -> None:
        """Count another frame."""
        self.both += int((found & truth).sum())
        self.found += int(found.sum())
        self.truth += int(truth.sum())

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 1 when nothing is there and nothing was found."""
        return 2.0 * self.both / total if (total := self.found + self.truth) else 1.0


def measure_saliency(seeds: int, report: Report) -> tuple[Table, list[Target]]:
    """Measure F1 of the salient markers in the last frame of several presses, for every preset.

    F1 is computed over all seeds together. A ball touches some twenty markers, so one wrong marker in one
    seed would cost 0.02.
    """
    rungs = (*rungs_of("contact"), *rungs_of("whole"))
    scores: dict[str, dict[str, Score]] = {rung.name: {} for rung in rungs}
    for seed in range(1, seeds + 1):
        report(f"saliency, {seed} of {seeds}")
        for scene, frames in _presses(seed).items():
            truth = frames[-1].in_contact
            for rung in rungs:
                salient = _salient(Pipeline(VGA.rig(), rung.params()), frames)
                found = np.zeros(len(truth), bool) if salient is None else salient
                scores[rung.name].setdefault(scene, Score()).add(found, truth)
    targets = [
        Target(
            f"saliency, {name}, least F1", 0.995, min(score.f1 for score in of.values()), "", at_most=False
        )
        for name, of in scores.items()
        if name in (FAST, EXACT)
    ]
    scenes = list(scores[FAST])
    rows = [[name, *(f"{of[scene].f1:.4f}" for scene in scenes)] for name, of in scores.items()]
    return Table("saliency", ["method", *scenes], rows), targets


def _salient(pipeline: Pipeline, frames: Sequence[SimulatedFrame]) -> Flags | None:
    try:
        for frame in frames:
            salient = pipeline.process(frame.left, frame.right).salient
    except Error:
        return None
    return salient
