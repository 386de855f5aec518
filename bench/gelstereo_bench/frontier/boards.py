"""The paper's boards (section V-A): measured height of a block pressed into the gel."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params, PitchWarning, Scene, SimulatedFrame
from gelstereo_bench.frontier.rungs import EXACT, rungs_of
from gelstereo_bench.frontier.runners import Runner
from gelstereo_bench.frontier.scenes import BOARDS_MM, VGA, board_press, layered_scene
from gelstereo_bench.frontier.table import Report, Table, Target

__all__ = ["BASELINE", "Heights", "board_scenes", "measure_boards", "measure_heights"]

Array = npt.NDArray[np.float64]

BASELINE = "OpenCV pipeline (baseline)"

#: Targets of the largest mean error and of the standard deviation, um.
_LIMITS_UM = {"boards": (4.0, 8.0), "refraction": (4.0, 10.0)}


def measure_boards(presses: int, report: Report) -> tuple[list[Table], list[Target]]:
    """Measure height errors of the markers on the block: mean (standard deviation) per protrusion and method,
    um.

    Cameras see the markers directly, or through air, acrylic and gel.
    """
    tables, targets = [], []
    for name, scene in board_scenes().items():
        table, errors_um = _measure(name, scene, presses, report)
        tables.append(table)
        targets += _targets(name, errors_um)
    return tables, targets


def board_scenes() -> dict[str, Scene]:
    """Sensors with a direct view of the markers, and through air, acrylic and gel."""
    return {"boards": VGA.scene(), "refraction": layered_scene()}


def _measure(name: str, scene: Scene, presses: int, report: Report) -> tuple[Table, dict[str, list[Array]]]:
    rungs = (*rungs_of("points"), *rungs_of("whole"))
    methods: dict[str, tuple[Params, bool]] = {rung.name: (rung.params(), True) for rung in rungs}
    methods[BASELINE] = (Params(), False)
    errors_um: dict[str, list[Array]] = {method: [] for method in methods}
    rows = []
    for protrusion_mm in BOARDS_MM:
        report(f"{name}: {protrusion_mm} mm")
        shots = [board_press(protrusion_mm, seed, scene) for seed in range(1, presses + 1)]
        row = [f"{protrusion_mm:.1f}"]
        for method, (params, native) in methods.items():
            try:
                found = np.concatenate(
                    [measure_heights(Runner(scene.rig, params, native), shot).errors_um() for shot in shots]
                )
            except (Error, ValueError) as error:
                row.append(f"refused: {error}")
                continue
            errors_um[method].append(found)
            row.append(f"{found.mean():+.1f} ({found.std():.1f})")
        rows.append(row)
    return Table(name, ["protrusion mm", *methods], rows), errors_um


@dataclass(frozen=True)
class Heights:
    """Rise of the markers from the first to the last frame of a press.

    Attributes
    ----------
    found_mm, truth_mm : (N,) float64
        As measured along z, and as simulated.
    seen : (N,) bool
    salient : (N,) bool, optional
        Contact according to the method; not available from the OpenCV pipeline.
    """

    found_mm: Array
    truth_mm: Array
    seen: npt.NDArray[np.bool_]
    salient: npt.NDArray[np.bool_] | None

    def errors_um(self) -> Array:
        """Height errors of the markers on the block."""
        block = self.seen & (self.truth_mm > 0.95 * self.truth_mm.max())
        return np.asarray(1e3 * (self.found_mm - self.truth_mm)[block], np.float64)


def measure_heights(runner: Runner, press: Sequence[SimulatedFrame]) -> Heights:
    """Measure a press."""
    rest_mm, points_mm, seen = np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.bool_)
    for frame in press:
        with warnings.catch_warnings():
            # Rungs that ignore the layers are measured too, and the pitch shows that they do.
            warnings.simplefilter("ignore", PitchWarning)
            _, points_mm, seen = runner.process(frame)
        if frame.index == 0:
            rest_mm = points_mm
    return Heights((rest_mm - points_mm)[:, 2], press[-1].indentation_mm, seen, runner.salient)


def _targets(name: str, errors_um: Mapping[str, Sequence[Array]]) -> list[Target]:
    mean_um, spread_um = _LIMITS_UM[name]
    boards = errors_um[EXACT]
    known = len(boards) == len(BOARDS_MM)
    worst = max(abs(float(board.mean())) for board in boards) if known else float("nan")
    # Each board relative to its own mean; differences between the boards' means are counted above.
    spread = (
        float(np.concatenate([board - board.mean() for board in boards]).std()) if known else float("nan")
    )
    what = f"boards{' through refraction' if name == 'refraction' else ''}, {EXACT}"
    return [
        Target(f"{what}, largest mean error", mean_um, worst, "um"),
        Target(f"{what}, spread", spread_um, spread, "um"),
    ]
