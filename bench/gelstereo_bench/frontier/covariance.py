"""Consistency of covariances: normalised estimation errors squared (NEES)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import Error, MarkerState, Params, Pipeline, SimulatedFrame
from gelstereo.extras import needs
from gelstereo_bench.frontier.centres import FRAMES_PER_SEED, Matches
from gelstereo_bench.frontier.rungs import EXACT, rungs_of
from gelstereo_bench.frontier.scenes import VGA, sphere_press
from gelstereo_bench.frontier.table import Report, Table, Target

with needs(__name__):
    from scipy.stats import chi2

__all__ = ["Calibration", "measure_covariance"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Calibration:
    """Errors squared, normalised by their covariances (NEES; Bar-Shalom, Li and Kirubarajan 2001, section
    5.4).
    """

    #: Mean over markers and degrees of freedom: 1 if the covariances are right, above 1 if they are too
    #: small.
    mean: float
    #: 95 % interval of the mean if covariances are right and errors are Gaussian and independent.
    band: tuple[float, float]
    #: Share of errors within their 95 % region.
    inside: float

    @classmethod
    def of(cls, errors: Array, covariances: Array, alike: int) -> Calibration:
        """Create from errors (N, k) and covariances (N, k, k); groups of a given size share the same paint
        grain.
        """
        count, freedom = errors.shape
        if count < alike:
            return cls(float("nan"), (float("nan"), float("nan")), float("nan"))
        squared = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0])
        independent = freedom * (count // alike)
        low, high = chi2.ppf([0.025, 0.975], independent) / independent
        inside = float((squared < chi2.ppf(0.95, freedom)).mean())
        return cls(float(squared.mean()) / freedom, (float(low), float(high)), inside)

    @property
    def cell(self) -> str:
        """Mean and share as text."""
        if not np.isfinite(self.mean):
            return "-"
        return f"{self.mean:.2f}{'' if self.calibrated else ' *'}, {100 * self.inside:.0f} %"

    @property
    def calibrated(self) -> bool:
        """Whether the mean lies in its interval."""
        return self.band[0] <= self.mean <= self.band[1]


def measure_covariance(
    centres: Mapping[str, Mapping[str, Matches]], seeds: int, report: Report
) -> tuple[Table, list[Target]]:
    """Check the covariances of centres under all conditions, and of points over presses."""
    found = {
        name: {
            condition: Calibration.of(methods[name].errors_px, methods[name].covariance_px2, FRAMES_PER_SEED)
            for condition, methods in centres.items()
        }
        for name in next(iter(centres.values()))
    }
    presses = [sphere_press(seed=seed) for seed in range(1, seeds + 1)]
    for rung in rungs_of("whole"):
        report(f"covariance of points: {rung.name}")
        found[rung.name]["points, 640x480"] = _of_points(rung.params(), presses)
    columns = [*centres, "points, 640x480"]
    rows = [[name, *(cells[c].cell if c in cells else "-" for c in columns)] for name, cells in found.items()]
    targets = [
        target
        for name, cells in found.items()
        if name == EXACT
        for condition, calibration in cells.items()
        for target in _targets(f"covariance, {name}, {condition}", calibration)
    ]
    return Table("covariance", ["method", *columns], [*rows, _bands(found, columns)]), targets


def _bands(found: Mapping[str, Mapping[str, Calibration]], columns: Sequence[str]) -> list[str]:
    """Format the widest interval of every column."""
    row = ["*95 % band*"]
    for column in columns:
        bands = [cells[column].band for cells in found.values() if column in cells]
        low, high = np.nanmin([b[0] for b in bands] + [1.0]), np.nanmax([b[1] for b in bands] + [1.0])
        row.append(f"{low:.2f} to {high:.2f}" if low < high else "-")
    return row


def _of_points(params: Params, presses: Sequence[Sequence[SimulatedFrame]]) -> Calibration:
    errors, covariances = [np.empty((0, 3))], [np.empty((0, 3, 3))]
    for press in presses:
        pipeline = Pipeline(VGA.rig(), params)
        for frame in press:
            try:
                result = pipeline.process(frame.left, frame.right)
            except Error:
                continue
            seen = result.state == MarkerState.SEEN
            errors.append((result.points_mm - frame.points_mm)[seen])
            covariances.append(result.covariance_mm2[seen])
    return Calibration.of(np.concatenate(errors), np.concatenate(covariances), len(presses[0]))


def _targets(what: str, found: Calibration) -> list[Target]:
    low, high = found.band
    name = f"{what}, mean normalised squared error"
    return [Target(name, high, found.mean, ""), Target(name, low, found.mean, "", at_most=False)]
