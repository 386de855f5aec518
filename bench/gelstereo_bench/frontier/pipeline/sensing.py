"""Depth error, contact and time of every way to sense, in one scene and seed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from gelstereo import Error
from gelstereo_bench.frontier.pipeline.cases import Take
from gelstereo_bench.frontier.pipeline.sensors import Sensing, seen_of

__all__ = ["REFUSALS", "Record", "is_lost", "measure_sensing"]

#: JSON-compatible results of one method.
Record = dict[str, Any]

#: What a pipeline raises for input that it cannot use: gelstereo, OpenCV and NumPy.
REFUSALS = (Error, RuntimeError, ValueError, np.linalg.LinAlgError)
#: A run that sees fewer of the markers than this does not measure the gel, as in the table of speed.
_MIN_SEEN = 0.9


def measure_sensing(take: Take, methods: Sequence[Sensing], seed: int) -> dict[str, Record]:
    """Run all methods on one take.

    Methods take turns: each follows the whole take, like consecutive frames of a camera, and another one
    begins with every seed.

    Returns
    -------
    dict of str to Record
        By method: ``ms`` of every tracked frame; the sum ``squared_um2`` of squared depth errors over
        ``markers`` seen ones, of ``counted``; ``contact``, the numbers of markers that are salient and touch,
        that are salient, and that touch; and why a frame was ``refused``, or an empty text.
    """
    turned = [methods[(k + seed) % len(methods)] for k in range(len(methods))]
    found = {method.name: _follow(method, take) for method in turned}
    return {method.name: found[method.name] for method in methods}


def _follow(method: Sensing, take: Take) -> Record:
    ms, squared, markers, counted, contact = [], 0.0, 0, 0, np.zeros(3, int)
    refused = ""
    try:
        sensor = method.open(take)
        correction_mm = method.correction_mm(take, sensor.start(take.shots[0]))
        for shot in take.shots[1:]:
            begin = time.perf_counter_ns()
            found = sensor.process(shot)
            ms.append(1e-6 * (time.perf_counter_ns() - begin))
            seen = seen_of(found) & shot.counted
            errors_mm = found.points_mm + correction_mm - shot.points_mm
            squared += float(np.sum((1e3 * errors_mm[seen, 2]) ** 2))
            markers += int(seen.sum())
            counted += int(shot.counted.sum())
            salient, touching = found.salient[shot.counted], shot.touching[shot.counted]
            contact += [(salient & touching).sum(), salient.sum(), touching.sum()]
    except REFUSALS as error:
        refused = str(error) or type(error).__name__
    return {
        "ms": ms,
        "squared_um2": squared,
        "markers": markers,
        "counted": counted,
        "contact": contact.tolist(),
        "refused": refused,
    }


def is_lost(record: Record) -> bool:
    """Whether a method refused a frame, or lost so many markers that its error says nothing about the gel."""
    counted = record["counted"]
    return bool(record["refused"]) or counted == 0 or record["markers"] < _MIN_SEEN * counted
