"""The paper's boards (section V-A): how high a block seems that stands in the gel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Params, SimulatedFrame
from gelstereo.frontier.rungs import rungs_of
from gelstereo.frontier.runners import Runner
from gelstereo.frontier.scenes import BOARDS_MM, VGA, board_press
from gelstereo.frontier.table import Report, Table, Target

__all__ = ["measure_boards"]

Array = npt.NDArray[np.float64]

BASELINE = "OpenCV pipeline (baseline)"


def measure_boards(presses: int, report: Report) -> tuple[Table, list[Target]]:
    """Measure height errors of the markers on the block: mean (standard deviation) per protrusion and method, um."""
    methods: dict[str, tuple[Params, bool]] = {r.name: (r.params(), True) for r in rungs_of("whole")}
    methods[BASELINE] = (Params(), False)
    errors_um: dict[str, list[Array]] = {name: [] for name in methods}
    rows = []
    for protrusion_mm in BOARDS_MM:
        report(f"board of {protrusion_mm} mm")
        shots = [board_press(protrusion_mm, seed) for seed in range(1, presses + 1)]
        row = [f"{protrusion_mm:.1f}"]
        for name, (params, native) in methods.items():
            try:
                found = np.concatenate(
                    [_errors_um(Runner(VGA.rig(), params, native), shot) for shot in shots]
                )
            except (Error, ValueError) as error:
                row.append(f"refused: {error}")
                continue
            errors_um[name].append(found)
            row.append(f"{found.mean():+.1f} ({found.std():.1f})")
        rows.append(row)
    return Table("boards", ["protrusion mm", *methods], rows), _targets(errors_um)


def _errors_um(runner: Runner, press: Sequence[SimulatedFrame]) -> Array:
    """Height errors of the markers on the block, in the last frame against the first."""
    rest_mm = np.empty((0, 3))
    for frame in press:
        _, points_mm, seen = runner.process(frame)
        if frame.index == 0:
            rest_mm = points_mm
    truth_mm = press[-1].indentation_mm
    block = seen & (truth_mm > 0.95 * truth_mm.max())
    return np.asarray(1e3 * ((rest_mm - points_mm)[block, 2] - truth_mm[block]), np.float64)


def _targets(errors_um: Mapping[str, Sequence[Array]]) -> list[Target]:
    targets = []
    for name, boards in errors_um.items():
        if name != "preset exact":
            continue
        known = len(boards) == len(BOARDS_MM)
        worst = max(abs(float(board.mean())) for board in boards) if known else float("nan")
        spread = float(np.concatenate(boards).std()) if known else float("nan")
        targets.append(Target(f"boards, {name}, without refraction, largest mean error", 4.0, worst, "um"))
        targets.append(Target(f"boards, {name}, without refraction, spread", 8.0, spread, "um"))
    return targets
