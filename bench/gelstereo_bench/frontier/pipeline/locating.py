"""Pose error and time of every registration method behind every way to sense, in one scene and seed."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from gelstereo_bench.frontier.pipeline.cases import Shot, Take
from gelstereo_bench.frontier.pipeline.locators import Combination, Sensed
from gelstereo_bench.frontier.pipeline.sensing import REFUSALS, Record
from gelstereo_bench.frontier.pipeline.sensors import Sensing

__all__ = ["measure_locating"]

Array = npt.NDArray[np.float64]

#: Fewer points than unknowns of a pose determine none.
_MIN_POINTS = 6


def measure_locating(
    take: Take, combinations: Sequence[Combination], seed: int, starts: int
) -> dict[str, Record]:
    """Locate the part in the take's judged frames, from several guesses that are off by 5 degrees and 1 mm.

    Every guess is used by all combinations in turn. Libraries prepare a part when they see it first; the
    median over calls is not affected.

    Returns
    -------
    dict of str to Record
        By combination: ``error_mm`` of every judged frame and guess, None for a refusal; and ``ms``.
    """
    records: dict[str, Record] = {each.name: {"error_mm": [], "ms": []} for each in combinations}
    sensing = {each.sensing.name: each.sensing for each in combinations}
    sensed = {name: _sensed(method, take) for name, method in sensing.items()}
    turned = [combinations[(k + seed) % len(combinations)] for k in range(len(combinations))]
    for index in take.judged:
        shot = take.shots[index]
        assert shot.patch is not None
        for turn in range(starts):
            guess = shot.patch.start(1000 * seed + turn)
            for each in turned:
                result = sensed[each.sensing.name].get(index)
                _locate(each, result, shot, guess, records[each.name])
    return records


def _sensed(method: Sensing, take: Take) -> dict[int, Sensed]:
    """Results in the judged frames; none after a refusal."""
    found: dict[int, Sensed] = {}
    try:
        sensor = method.open(take)
        correction_mm = method.correction_mm(take, sensor.start(take.shots[0]))
        for index, shot in enumerate(take.shots[1:], start=1):
            result = sensor.process(shot)
            if index in take.judged:
                found[index] = Sensed(result, np.asarray(result.points_mm + correction_mm))
    except REFUSALS:
        # What was sensed before is used; later frames count as failures.
        return found
    return found


def _locate(each: Combination, sensed: Sensed | None, shot: Shot, guess: Array, record: Record) -> None:
    assert shot.body is not None
    if sensed is None or np.count_nonzero(sensed.found.salient) < _MIN_POINTS:
        record["error_mm"].append(None)
        return
    try:
        begin = time.perf_counter_ns()
        pose = each.locate(sensed, shot.body, guess)
        record["ms"].append(1e-6 * (time.perf_counter_ns() - begin))
    except REFUSALS:
        record["error_mm"].append(None)
        return
    known = np.all(np.isfinite(pose))
    record["error_mm"].append(shot.pose_error_mm(pose) if known else None)
