"""The paper's calibration boards (section V-A; Table I, Fig. 13 and 14).

Boards with a block of known height are pressed until the plate around the block lies on the gel. The rise of
the markers on the block is compared with the truth. Methods are every rung that affects heights, every
preset, and the paper's pipeline in OpenCV. Cameras see the markers directly, or through air, acrylic and gel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from gelstereo import Error, Params
from gelstereo_bench.experiments.batch import Configuration, Trial, keyed_seed
from gelstereo_bench.experiments.boards_report import boards_report
from gelstereo_bench.experiments.experiment import Experiment
from gelstereo_bench.frontier.boards import BASELINE, board_scenes, measure_heights
from gelstereo_bench.frontier.rungs import RUNGS
from gelstereo_bench.frontier.runners import Runner
from gelstereo_bench.frontier.scenes import BOARDS_MM, board_press

__all__ = ["EXPERIMENT"]

#: Stages that a height depends on.
_STAGES = ("whole", "detect", "label", "points")


def methods() -> dict[str, tuple[Params, bool]]:
    """Settings of every method, and whether the native pipeline runs it; presets and the baseline first."""
    found = {
        (rung.name if rung.stage == "whole" else f"{rung.stage}: {rung.name}"): (rung.params(), True)
        for stage in _STAGES
        for rung in RUNGS
        if rung.stage == stage
    }
    presets = {name: found.pop(name) for name in list(found) if ":" not in name}
    return {**presets, BASELINE: (Params(), False), **found}


def inputs() -> dict[str, str]:
    """Scenes and settings."""
    scenes = {f"scene {name}": scene.to_toml() for name, scene in board_scenes().items()}
    return scenes | {f"settings {name}": params.to_toml() for name, (params, _) in methods().items()}


def trials(repeats: int, seed: int) -> list[Trial]:
    """Every board through every sensor, `repeats` times."""
    return [
        Trial(
            {"sensor": sensor, "protrusion_mm": protrusion_mm, "press": press},
            keyed_seed(seed, "boards", sensor, protrusion_mm, press),
        )
        for sensor in board_scenes()
        for protrusion_mm in BOARDS_MM
        for press in range(1, repeats + 1)
    ]


def run(configuration: Configuration, seed: int) -> dict[str, Any]:
    """Press a board once; all methods, or those in the configuration's ``methods``, measure the same images.

    For each method the record has ``errors_um`` of the markers on the block and ``salient_mm``, the mean
    height of the markers classified as contact (the paper's measure); or ``refused``, the reason for no
    result.
    """
    cv2.setNumThreads(1)
    scene = board_scenes()[configuration["sensor"]]
    press = board_press(configuration["protrusion_mm"], seed, scene)
    found: dict[str, Mapping[str, Any]] = {}
    chosen = configuration.get("methods")
    for name, (params, native) in methods().items():
        if chosen is not None and name not in chosen:
            continue
        try:
            heights = measure_heights(Runner(scene.rig, params, native), press)
        except (Error, ValueError) as error:
            found[name] = {"refused": str(error)}
            continue
        found[name] = {"errors_um": _rounded(heights.errors_um()), "salient_mm": None}
        if heights.salient is not None and np.any(heights.salient & heights.seen):
            salient_mm = float(heights.found_mm[heights.salient & heights.seen].mean())
            found[name] = {**found[name], "salient_mm": round(salient_mm, 6)}
    return {"methods": found}


def _rounded(values: Sequence[float] | np.ndarray[Any, Any]) -> list[float]:
    """Round to a nanometre."""
    return [round(float(value), 3) for value in values]


EXPERIMENT = Experiment(
    name="boards",
    repeats=5,
    inputs=inputs,
    trials=trials,
    run=run,
    report=lambda t, r: boards_report(t, r, inputs()),
)
