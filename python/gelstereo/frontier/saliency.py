"""Which markers are in contact: precision and recall against the true contact region."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Pipeline, SimulatedFrame
from gelstereo.frontier.rungs import EXACT, FAST, rungs_of
from gelstereo.frontier.scenes import BOARDS_MM, FACING_RAD, SURFACE_MM, VGA, board_shape, press, sphere_press
from gelstereo.frontier.table import Report, Table, Target

__all__ = ["f1", "measure_saliency"]

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


def f1(found: Flags, truth: Flags) -> float:
    """Harmonic mean of precision and recall; 1 when nothing is there and nothing was found."""
    both = int((found & truth).sum())
    return 2.0 * both / total if (total := int(found.sum() + truth.sum())) else 1.0


def measure_saliency(seeds: int, report: Report) -> tuple[Table, list[Target]]:
    """Measure F1 of the salient markers in the last frame of several presses, for every preset."""
    report("saliency")
    runs = [_presses(seed) for seed in range(1, seeds + 1)]
    scenes = list(runs[0])
    rows, targets = [], []
    for rung in (*rungs_of("contact"), *rungs_of("whole")):
        values = []
        for scene in scenes:
            found: list[Flags] = [np.zeros(0, bool)]
            truth: list[Flags] = [np.zeros(0, bool)]
            for run in runs:
                salient = _salient(Pipeline(VGA.rig(), rung.params()), run[scene])
                truth.append(run[scene][-1].in_contact)
                found.append(np.zeros(len(truth[-1]), bool) if salient is None else salient)
            values.append(f1(np.concatenate(found), np.concatenate(truth)))
        rows.append([rung.name, *(f"{value:.3f}" for value in values)])
        if rung.name in (FAST, EXACT):
            targets.append(Target(f"saliency, {rung.name}, least F1", 0.995, min(values), "", at_most=False))
    return Table("saliency", ["method", *scenes], rows), targets


def _salient(pipeline: Pipeline, frames: Sequence[SimulatedFrame]) -> Flags | None:
    try:
        for frame in frames:
            salient = pipeline.process(frame.left, frame.right).salient
    except Error:
        return None
    return salient
