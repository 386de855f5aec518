"""Consistency of the poses' covariances: NEES, and coverage of 95 % regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Localization
from gelstereo.extras import needs
from gelstereo.geometry import se3_log
from gelstereo_bench.frontier.grasps import STARTS, Grasp
from gelstereo_bench.frontier.rungs import rungs_of
from gelstereo_bench.frontier.table import Table

with needs(__name__):
    from scipy.stats import chi2

__all__ = ["Nees", "nees_table"]

#: Nominal coverage of a confidence region.
_SHARE = 0.95


@dataclass
class Nees:
    """Normalised estimation error squared of several poses, over the directions that each states as
    determined.
    """

    squared: list[float] = field(default_factory=list)
    directions: list[int] = field(default_factory=list)

    def add(self, found: Localization, t_sensor_object: npt.NDArray[np.float64]) -> None:
        """Add a result with its true pose, (4, 4)."""
        count = 6 - len(found.free)
        if count > 0:
            twist = se3_log(t_sensor_object @ np.linalg.inv(found.t_sensor_object))
            self.squared.append(float(twist @ found.information @ twist))
            self.directions.append(count)

    @property
    def mean(self) -> float:
        """Mean per direction; 1 if covariances are right."""
        return float(np.sum(self.squared) / np.sum(self.directions)) if self.squared else float("nan")

    @property
    def band(self) -> tuple[float, float]:
        """95 % interval of the mean over as many directions, for normal errors."""
        count = int(np.sum(self.directions))
        low, high = chi2.ppf([0.5 - 0.5 * _SHARE, 0.5 + 0.5 * _SHARE], max(count, 1)) / max(count, 1)
        return float(low), float(high)

    @property
    def within(self) -> float:
        """Per cent of results within the 95 % region of their covariance."""
        limits = chi2.ppf(_SHARE, self.directions)
        return 100.0 * float(np.mean(np.asarray(self.squared) <= limits)) if self.squared else float("nan")


def nees_table(contacts: Mapping[str, Sequence[Grasp]]) -> Table:
    """Table for the successes of every rung from the nearest start, by noise."""
    rows = []
    for rung in rungs_of("register"):
        params = rung.params().replace({"register.advanced.search_radius_mm": 8.0})
        row = [rung.name]
        for grasped in contacts.values():
            nees = Nees()
            for seed, grasp in enumerate(grasped):
                try:
                    found = grasp.registered(grasp.guess(STARTS[0], seed), params)
                except Error:
                    continue
                if grasp.score(np.asarray(found.t_sensor_object)).success:
                    nees.add(found, grasp.t_sensor_object)
            low, high = nees.band
            row += [f"{nees.mean:.2f} ({low:.2f} to {high:.2f})", f"{nees.within:.0f}"]
        rows.append(row)
    head = ["method", *(cell for noise in contacts for cell in (f"NEES, {noise} (band)", "within, %"))]
    return Table("nees", head, rows)
