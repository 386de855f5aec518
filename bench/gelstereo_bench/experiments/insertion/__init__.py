"""Grasp, localize, align, insert (section V-A of the paper): Tables II and III, Fig. 15."""

from __future__ import annotations

from collections.abc import Sequence

from gelstereo_bench.experiments.batch import Trial, keyed_seed
from gelstereo_bench.experiments.experiment import Experiment
from gelstereo_bench.experiments.insertion.grasp import GRASPED
from gelstereo_bench.experiments.insertion.report import insertion_report
from gelstereo_bench.experiments.insertion.sense import METHODS
from gelstereo_bench.experiments.insertion.trial import run
from gelstereo_bench.experiments.insertion.workplace import sensor_scene

__all__ = ["EXPERIMENT"]

#: Grasps per peg in the paper; the plug is grasped proportionally less often.
_REPEATS = 36


def inputs() -> dict[str, str]:
    """The sensor's scene, and the settings of all methods."""
    settings = {f"settings {method.name}": method.params().to_toml() for method in METHODS}
    return {"scene": sensor_scene().to_toml(), **settings}


def trials(repeats: int, seed: int) -> Sequence[Trial]:
    """All grasps of all parts."""
    return [
        Trial({"part": letter, "grasp": grasp}, keyed_seed(seed, "insertion", letter, grasp))
        for letter, part in GRASPED.items()
        for grasp in range(1, -(-repeats * part.trials // _REPEATS) + 1)
    ]


EXPERIMENT = Experiment(
    name="insertion",
    repeats=_REPEATS,
    inputs=inputs,
    trials=trials,
    run=run,
    report=lambda t, r: insertion_report(t, r, inputs()),
)
