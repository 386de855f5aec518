"""Trials for tests of batches: of a module, so that other processes find them."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import gelstereo
from gelstereo_bench.experiments.batch import Trial, keyed_seed
from gelstereo_bench.experiments.store import Record

TRIALS = [Trial({"case": case}, keyed_seed(1, "draw", case, turn)) for case in "abc" for turn in range(5)]


def draw(configuration: Any, seed: int) -> Record:
    """Numbers of a keyed stream, in a time of its own, so that late trials overtake early ones."""
    random = np.random.default_rng(seed)
    time.sleep(0.002 * (seed % 7))
    return {"case": configuration["case"], "values": random.normal(size=3).tolist()}


def slowly(configuration: Any, seed: int) -> Record:
    """The same, a few to a task."""
    time.sleep(0.15)
    return draw(configuration, seed)


def refuses(configuration: Any, seed: int) -> Record:
    raise gelstereo.Error(f"no {configuration['case']} today")


def not_json(configuration: Any, seed: int) -> Record:
    return {"value": float("nan")}
