"""How many slips of the report `slip` could be found by a detector that knows the patch and the true motion.

Run ``python -m gelstereo_bench.reports.slip_floor`` to print the figures that docs/slip.md states.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import Stick
from gelstereo.extras import needs
from gelstereo_bench.reports.slip import SIGMA_MM, Run, runs

with needs(__name__):
    from scipy.stats import norm

__all__ = ["Floor", "floor", "main"]

Array = npt.NDArray[np.float64]

#: Stick ratio of the true contact below which a slip is found late.
_LATE = 0.7
#: Probability of a false alarm in one frame: one an hour, at 30 frames a second.
_ALARM = 1.0 / (3600.0 * 30.0)
_DRAWS = 40


@dataclass(frozen=True)
class Floor:
    """What can be found of one slip before less than 0.7 of the contact stick."""

    #: Largest slip since touch, um.
    largest_um: float
    #: Probability that one marker slips by more than the limit of the method, by the true motion.
    by_marker: float
    #: Probability with the most powerful test: that of the true slip of every marker (Neyman and Pearson).
    by_slip: float


def floor(run: Run, random: np.random.Generator) -> Floor | None:
    """None if 0.7 of the contact stick in all frames. Anchors are positions in the first frame of contact."""
    found, largest_mm, distance = np.zeros(_DRAWS, bool), 0.0, 0.0
    sigma_mm, count = SIGMA_MM[0], len(run.steps[0].points_mm)
    touched, anchors_mm, errors_mm = np.zeros(count, bool), np.zeros((count, 3)), np.zeros((_DRAWS, count, 2))
    for step in run.steps:
        touches = np.asarray(step.stick != Stick.FREE)
        pose = step.t_sensor_object
        if pose is None or not touches.any():
            continue
        if np.sum(step.stick == Stick.STUCK) < _LATE * np.sum(touches):
            powerful = float(norm.cdf(distance - norm.isf(_ALARM)))
            return Floor(1e3 * largest_mm, float(np.mean(found)), powerful)
        new, old = touches & ~touched, touches & touched
        anchors_mm[new] = (step.points_mm[new] - pose[:3, 3]) @ pose[:3, :3]
        errors_mm[:, new] = sigma_mm * random.normal(size=(_DRAWS, int(new.sum()), 2))
        touched = touches
        if old.sum() < 3:
            continue
        off_mm = (step.points_mm[old] - anchors_mm[old] @ pose[:3, :3].T - pose[:3, 3])[:, :2]
        seen_mm = off_mm + sigma_mm * random.normal(size=(_DRAWS, len(off_mm), 2)) - errors_mm[:, old]
        gate = -2.0 * np.log(_ALARM / len(off_mm))
        found |= np.any(np.sum(seen_mm**2, axis=2) > gate * 2.0 * sigma_mm**2, axis=1)
        largest_mm = max(largest_mm, float(np.max(np.linalg.norm(off_mm, axis=1))))
        distance = max(distance, float(np.sqrt(np.sum(off_mm**2) / (2.0 * sigma_mm**2))))
    return None


def main(arguments: list[str] | None = None) -> int:
    """Print how many slips can be found."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.slip_floor", description=__doc__)
    parser.add_argument("--contacts", type=int, default=180, help="number of contacts")
    parser.add_argument("--seed", type=int, default=30, help="of the contacts")
    options = parser.parse_args(arguments)
    random = np.random.default_rng(31)
    floors = [floor(run, random) for run in runs(options.contacts, options.seed)]
    slips = [each for each in floors if each is not None]
    hidden = sum(each.largest_um < 1.0 for each in slips)
    print(f"{len(slips)} slips; in {hidden} no marker slips by a micrometre while {_LATE} stick")
    print(f"found by one marker and the true motion: {sum(each.by_marker for each in slips):.1f}")
    print(f"found by the true slip of every marker: {sum(each.by_slip for each in slips):.1f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
