"""Young's modulus of a gel from known loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import ForceEstimator, Params
from gelstereo.force.loads import Load, LoadsError
from gelstereo.force.pressed import Pressed, RestState, force_params
from gelstereo.setup.sensor import Sensor

__all__ = [
    "ForceCalibration",
    "LoadResult",
    "UnitLoad",
    "calibrate",
    "main_component",
    "percent",
    "unit_loads",
]

Floats = npt.NDArray[np.float64]

#: Poisson's ratios that are tried: from that of a compressible foam to that of an incompressible rubber.
_POISSON = (0.40, 0.43, 0.45, 0.46, 0.47, 0.475, 0.48, 0.485, 0.49, 0.493, 0.496, 0.498)
#: Thicknesses that are tried, over the given one; the least of a parabola through the best three is taken.
_THICKNESSES = (0.75, 0.9, 1.0, 1.1, 1.3)
#: Frames after which a creeping gel has settled enough to be averaged, s.
_SETTLED_S = 0.3
#: Rounds in which the modulus and the weights that depend on it are found in turn.
_ROUNDS = 20


@dataclass(frozen=True)
class LoadResult:
    """A known load beside what the calibrated sensor measures.

    Attributes
    ----------
    load : Load
    measured, sigma : (4,) float64
        As `Load.known`, and their standard deviations without that of the modulus.
    left_out : float
        Relative error of the largest known component by a calibration without this load; NaN for the only
        load.
    creep : float
        Relative change of the largest component per decade of time, at constant load.
    is_cut : bool
        Whether the contact reached the lattice's border in a frame, so that a part of the force is missing.
    frames : int
    """

    load: Load
    measured: Floats
    sigma: Floats
    left_out: float
    creep: float
    is_cut: bool
    frames: int


@dataclass(frozen=True)
class ForceCalibration:
    """What known loads tell about a gel.

    Attributes
    ----------
    young_kpa, young_sigma_kpa : float
    poisson_ratio, thickness_mm : float
    chi2 : float
        Weighted mean square of what is left: 1 where errors are as large as stated.
    poisson_chi2 : dict
        The same for each Poisson's ratio that was tried; one if it was given.
    thickness_chi2 : dict
        The same for each thickness that was tried, mm; one if it was given.
    thickness_sigma_mm : float
        Standard deviation of a thickness that was found; 0 if it was given.
    hysteresis : float
        Largest relative difference of equal loads on the way down and on the way up; NaN without such pairs.
    results : tuple of LoadResult
        In the order of time.
    """

    young_kpa: float
    young_sigma_kpa: float
    poisson_ratio: float
    thickness_mm: float
    chi2: float
    poisson_chi2: dict[float, float]
    thickness_chi2: dict[float, float]
    thickness_sigma_mm: float
    hysteresis: float
    results: tuple[LoadResult, ...]

    @property
    def left_out_rms(self) -> float:
        """Relative rms error of loads that the calibration did not see."""
        errors = np.array([result.left_out for result in self.results])
        return float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else float("nan")

    def settings(self) -> dict[str, float | str]:
        """The table ``force`` of `Params`."""
        return {
            "method": "ridge",
            "thickness_mm": round(self.thickness_mm, 4),
            "young_kpa": round(self.young_kpa, 3),
            "young_sigma_kpa": round(self.young_sigma_kpa, 3),
            "poisson_ratio": self.poisson_ratio,
        }

    def to_toml(self) -> str:
        """The settings as TOML for ``--params`` and `Params.load`."""
        rows = [f"{name} = {_value(value)}" for name, value in self.settings().items()]
        known = (
            f"# From {len(self.results)} known loads: rms error of a load that was left out "
            f"{percent(self.left_out_rms)}, hysteresis {percent(self.hysteresis)}.\n"
        )
        return known + "[force]\n" + "\n".join(rows) + "\n"


def percent(share: float) -> str:
    """A share as text; NaN is one that these loads do not tell."""
    return "not known" if np.isnan(share) else f"{100 * share:.1f} %"


def _value(value: float | str) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


@dataclass(frozen=True)
class UnitLoad:
    """What a load would be on a gel with a modulus, or a stiffness, of 1."""

    mean: Floats
    variance: Floats
    creep: float
    is_cut: bool
    frames: int


def calibrate(
    rest: RestState,
    frames: Sequence[Pressed],
    loads: Sequence[Load],
    sensor: Sensor,
    *,
    thickness_mm: float,
    poisson_ratio: float | None = 0.48,
    fits_thickness: bool = False,
) -> ForceCalibration:
    """Fit the modulus to known loads.

    Forces are proportional to the modulus, so that it is a weighted least-squares ratio. Weights are those of
    the estimator's covariances, which state what a linear layer leaves unexplained.

    Parameters
    ----------
    rest, frames
        From `pressed_frames`.
    loads
        At least one that is not zero; two or more of different size for an error that was not fitted.
    sensor
    thickness_mm
        Of the gel.
    poisson_ratio
        None finds the one that leaves the least of all components. Loads of one size and shape do not tell
        it: take parts of different widths.
    fits_thickness
        Find the thickness in the same way, between 0.75 and 1.3 times the given one.

    Raises
    ------
    LoadsError
        No load has a known force, or the loads do not tell the thickness.
    """
    if not any(np.nansum(np.abs(load.known)) > 0.0 for load in loads):
        raise LoadsError("all known loads are zero; give at least one weight")
    thickness_sigma_mm, thickness_chi2 = 0.0, {}
    ratios = _POISSON if poisson_ratio is None else (poisson_ratio,)

    def best_at(thickness_mm: float) -> _Fits:
        return _fits(rest, frames, loads, sensor, thickness_mm, ratios)

    if fits_thickness:
        tried = {share * thickness_mm: best_at(share * thickness_mm).chi2 for share in _THICKNESSES}
        thickness_mm, thickness_sigma_mm = _least(tried, sum(np.isfinite(load.known).sum() for load in loads))
        thickness_chi2 = tried
    found = best_at(thickness_mm)
    return ForceCalibration(
        young_kpa=found.young_kpa,
        young_sigma_kpa=found.sigma_kpa,
        poisson_ratio=found.poisson_ratio,
        thickness_mm=thickness_mm,
        chi2=found.chi2,
        poisson_chi2=found.by_ratio,
        thickness_chi2=thickness_chi2 or {thickness_mm: found.chi2},
        thickness_sigma_mm=thickness_sigma_mm,
        hysteresis=_hysteresis(found.units, loads),
        results=tuple(_result(k, found.units, loads, found.young_kpa) for k in range(len(loads))),
    )


@dataclass(frozen=True)
class _Fits:
    """The best of all Poisson's ratios at one thickness."""

    units: list[UnitLoad]
    poisson_ratio: float
    young_kpa: float
    sigma_kpa: float
    chi2: float
    by_ratio: dict[float, float]


def _fits(
    rest: RestState,
    frames: Sequence[Pressed],
    loads: Sequence[Load],
    sensor: Sensor,
    thickness_mm: float,
    ratios: Sequence[float],
) -> _Fits:
    found = {}
    for nu in ratios:
        units = unit_loads(rest, frames, loads, force_params(sensor, thickness_mm, nu))
        found[nu] = (units, *_modulus(units, loads))
    best = min(found, key=lambda nu: found[nu][3])
    units, young_kpa, sigma_kpa, chi2 = found[best]
    return _Fits(units, best, young_kpa, sigma_kpa, chi2, {nu: each[3] for nu, each in found.items()})


def _least(chi2: dict[float, float], known: int) -> tuple[float, float]:
    """Thickness of the least mean square, and its standard deviation, by a parabola in its logarithm."""
    values = sorted(chi2)
    best = int(np.argmin([chi2[value] for value in values]))
    bend, slope = 0.0, 0.0
    if 0 < best < len(values) - 1:
        near = values[best - 1 : best + 2]
        bend, slope, _ = np.polyfit(np.log(near), [chi2[value] for value in near], 2)
    if not bend > 0.0:
        raise LoadsError(
            f"the loads do not tell the thickness: {values[best]:.2f} mm leaves the least, of "
            f"{values[0]:.2f} to {values[-1]:.2f} mm; press parts of different widths, or give the thickness"
        )
    thickness_mm = float(np.exp(-slope / (2.0 * bend)))
    # The sum of squares rises by one, or by their mean where errors are larger than stated.
    sigma = np.sqrt(max(chi2[values[best]], 1.0) / (bend * max(known - 2, 1)))
    return thickness_mm, float(thickness_mm * sigma)


def unit_loads(
    rest: RestState, frames: Sequence[Pressed], loads: Sequence[Load], params: Params
) -> list[UnitLoad]:
    """Means of what the estimator with these settings finds under each load."""
    estimator = ForceEstimator(rest.surface, params, cols=rest.cols, covariance_mm2=rest.covariance_mm2)
    axes = rest.axes
    # Force along the axes, then the torque about the first.
    to = np.zeros((4, 6))
    to[:3, :3], to[3, 3:] = axes, axes[0]
    values: list[list[tuple[float, Floats, Floats]]] = [[] for _ in loads]
    cut = set()
    for frame in frames:
        _, wrench = estimator.run(frame.points_mm, frame.covariance_mm2, frame.patch.tolist())
        if wrench is None:
            continue
        seen = frame.points_mm[frame.patch & np.isfinite(frame.points_mm).all(axis=1)]
        about = wrench.about(seen.mean(axis=0)) if len(seen) else wrench
        if wrench.is_cut:
            cut.add(frame.load)
        both = np.concatenate([about.force_n, about.torque_nmm])
        variance = np.diag(to @ about.covariance @ to.T)
        values[frame.load].append((frame.time_s, to @ both, variance))
    for load, each in zip(loads, values, strict=True):
        if not each:
            raise LoadsError(f"the contact of the load {load} gives no force; too few markers are seen there")
    return [_unit(values[k], main_component(load), k in cut) for k, load in enumerate(loads)]


def _unit(values: Sequence[tuple[float, Floats, Floats]], main: int, is_cut: bool) -> UnitLoad:
    times = np.array([time for time, _, _ in values])
    wrenches, variances = (np.array(each) for each in zip(*[(w, v) for _, w, v in values], strict=True))
    settled = times >= min(_SETTLED_S, 0.5 * times.max())
    mean = wrenches[settled].mean(axis=0)
    creep = float("nan")
    if settled.sum() >= 10 and times[settled].max() > 2 * times[settled].min() > 0 and mean[main] != 0:
        slope = np.polyfit(np.log10(times[settled]), wrenches[settled, main], 1)[0]
        creep = float(slope / mean[main])
    # What the law leaves unexplained is common to all frames of a load: it does not average out.
    return UnitLoad(mean, variances[settled].mean(axis=0), creep, is_cut, int(settled.sum()))


def main_component(load: Load) -> int:
    """Index of the largest known force; of the torque if no force is known."""
    forces = np.abs(load.known[:3])
    return int(np.nanargmax(forces)) if np.nansum(forces) > 0 else int(np.nanargmax(np.abs(load.known)))


def _modulus(units: Sequence[UnitLoad], loads: Sequence[Load]) -> tuple[float, float, float]:
    """Modulus, standard deviation and weighted mean square of the residuals."""
    known = np.array([load.known for load in loads])
    means, variances = (np.array(each) for each in zip(*[(u.mean, u.variance) for u in units], strict=True))
    used = np.isfinite(known)
    young_kpa = float(np.sum((known * means)[used]) / np.sum((means**2)[used]))
    for _ in range(_ROUNDS):
        weights = 1.0 / (young_kpa**2 * variances)
        precision = float(np.sum((weights * means**2)[used]))
        young_kpa = float(np.sum((weights * known * means)[used]) / precision)
        if not young_kpa > 0.0:
            raise LoadsError(
                "the measured forces oppose the known ones; a pressing force is positive, x points along the "
                "rows to the right and y along the columns down, as the left camera sees them"
            )
    chi2 = float(np.sum((weights * (young_kpa * means - known) ** 2)[used]) / max(used.sum() - 1, 1))
    return young_kpa, float(np.sqrt(max(chi2, 1.0) / precision)), chi2


def _result(k: int, units: Sequence[UnitLoad], loads: Sequence[Load], young_kpa: float) -> LoadResult:
    unit, load, main = units[k], loads[k], main_component(loads[k])
    left_out = float("nan")
    others = [i for i in range(len(loads)) if i != k]
    if load.known[main] != 0 and any(np.nansum(np.abs(loads[i].known)) > 0 for i in others):
        without, _, _ = _modulus([units[i] for i in others], [loads[i] for i in others])
        left_out = float(without * unit.mean[main] / load.known[main] - 1.0)
    return LoadResult(
        load=load,
        measured=young_kpa * unit.mean,
        sigma=young_kpa * np.sqrt(unit.variance),
        left_out=left_out,
        creep=unit.creep,
        is_cut=unit.is_cut,
        frames=unit.frames,
    )


def _hysteresis(units: Sequence[UnitLoad], loads: Sequence[Load]) -> float:
    """Of pairs of equal loads with a larger one between them."""
    found = []
    for i in range(len(loads)):
        main = main_component(loads[i])
        size = abs(loads[i].known[main])
        for k in range(i + 2, len(loads)):
            between = [abs(loads[n].known[main]) for n in range(i + 1, k)]
            is_equal = np.isclose(loads[k].known[main], loads[i].known[main], rtol=0.02, atol=0.0)
            if size > 0 and is_equal and max(between) > 1.02 * size:
                up, down = abs(units[i].mean[main]), abs(units[k].mean[main])
                found.append((down - up) / (0.5 * (up + down)))
    return float(max(found, key=abs)) if found else float("nan")
