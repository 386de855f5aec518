"""Stiffness of a gel from known loads, without a model of its layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo.force.fit import main_component, percent, unit_loads
from gelstereo.force.loads import Load, LoadsError
from gelstereo.force.pressed import Pressed, RestState
from gelstereo.setup.sensor import Sensor

__all__ = ["NAMES", "ResultantCalibration", "calibrate_resultant", "fit_stiffness"]

Floats = npt.NDArray[np.float64]

#: Least ratio of singular values at which both stiffnesses of heights are determined: known loads with errors
#: of 3 % then leave them uncertain by their own size.
_SEPARATE = 0.03
#: Share of a load along the gel below which it tells nothing about the stiffness there.
_SMALL = 0.02
#: Settings of `resultant`.
NAMES = ("patch_n_per_mm3", "around_n_per_mm3", "shear_n_per_mm3")


@dataclass(frozen=True)
class ResultantCalibration:
    """What known loads tell about the sums of a gel's motion.

    Attributes
    ----------
    patch_n_per_mm3, around_n_per_mm3, shear_n_per_mm3 : float
        As the settings of the same names.
    thickness_mm : float
        How far around the contact markers are used.
    left_out : (L,) float64
        Relative error of the largest known component of each load, by a calibration without it; NaN where the
        others do not tell.
    is_cut : tuple of bool
        Whether the contact of each load reached the lattice's border.
    """

    patch_n_per_mm3: float
    around_n_per_mm3: float
    shear_n_per_mm3: float
    thickness_mm: float
    left_out: Floats
    is_cut: tuple[bool, ...]

    @property
    def left_out_rms(self) -> float:
        """Relative rms error of loads that the calibration did not see."""
        known = self.left_out[np.isfinite(self.left_out)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")

    def settings(self) -> dict[str, float | str]:
        """The table ``force`` of `Params`."""
        sigma = self.left_out_rms
        return {
            "method": "resultant",
            "thickness_mm": self.thickness_mm,
            **{name: float(f"{getattr(self, name):.6g}") for name in NAMES},
            **({"resultant_sigma": round(sigma, 4)} if np.isfinite(sigma) else {}),
        }

    def to_toml(self) -> str:
        """The settings as TOML for ``--params`` and `Params.load`."""
        rows = [
            f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value:g}"
            for name, value in self.settings().items()
        ]
        known = f"# rms error of a load that was left out: {percent(self.left_out_rms)}\n"
        return f"# From {len(self.left_out)} known loads.\n{known}[force]\n" + "\n".join(rows) + "\n"


def calibrate_resultant(
    rest: RestState, frames: Sequence[Pressed], loads: Sequence[Load], sensor: Sensor, *, thickness_mm: float
) -> ResultantCalibration:
    """Fit the stiffnesses of `resultant` to known loads, each weighted by its size.

    Parameters
    ----------
    rest, frames
        From `pressed_frames`.
    loads
        At least one that presses, and one that pulls along the gel or twists.
    sensor
    thickness_mm
        Of the gel.

    Raises
    ------
    LoadsError
        If no load presses, or none pulls along the gel or twists.
    """
    units, cut = [], np.zeros(len(loads), dtype=bool)
    for name in NAMES:
        stiffness = {each: float(each == name) for each in NAMES}
        force = {"method": "resultant", "thickness_mm": thickness_mm, **stiffness}
        found = unit_loads(rest, frames, loads, sensor.params.replace(force=force))
        units.append([each.mean for each in found])
        cut |= [each.is_cut for each in found]
    # (3, L, 4): loads of a stiffness of 1 each.
    unit, known = np.array(units), np.array([load.known for load in loads])
    stiffness_found = fit_stiffness(unit, known)
    if stiffness_found is None:
        raise LoadsError(
            "the known loads do not tell the stiffness along the gel and into it; give at least one weight, "
            "and one with tilt_deg, x_n, y_n or twist_nmm"
        )
    left_out = np.full(len(loads), np.nan)
    for k, load in enumerate(loads):
        others = np.arange(len(loads)) != k
        without = fit_stiffness(unit[:, others], known[others])
        main = main_component(load)
        if without is not None and load.known[main] != 0.0:
            left_out[k] = without @ unit[:, k, main] / load.known[main] - 1.0
    patch, around, shear = map(float, stiffness_found)
    return ResultantCalibration(patch, around, shear, thickness_mm, left_out, tuple(cut.tolist()))


def fit_stiffness(unit: Floats, known: Floats) -> Floats | None:
    """The three stiffnesses of `NAMES`; None unless loads of both kinds are known.

    Parameters
    ----------
    unit : (3, L, 4) float64
        What each load is by a stiffness of 1 alone, as `Load.known`.
    known : (L, 4) float64
    """
    sizes = np.linalg.norm(np.nan_to_num(known[:, :3]), axis=1)
    pressing = np.isfinite(known[:, 0]) & (known[:, 0] != 0.0)
    heights = (unit[:2, pressing, 0] / sizes[pressing]).T
    target = known[pressing, 0] / sizes[pressing]
    # Forces along the gel count by the size of their load, and twists by that of all twists.
    twist = np.sqrt(np.nanmean(known[:, 3] ** 2)) if np.isfinite(known[:, 3]).any() else 0.0
    of_force = 1.0 / np.maximum(sizes, 1e-9)
    weights = np.column_stack([of_force, of_force, np.full(len(known), 1.0 / twist if twist > 0.0 else 0.0)])
    aside = np.isfinite(known[:, 1:])
    loads, along = (known[:, 1:] * weights)[aside], (unit[2][:, 1:] * weights)[aside]
    if not len(target) or not np.any(np.abs(loads) > _SMALL):
        return None
    singular = np.linalg.svd(heights / np.linalg.norm(heights, axis=0), compute_uv=False)
    both = np.zeros(2)
    if len(singular) == 2 and singular[1] > _SEPARATE * singular[0]:
        both = np.linalg.lstsq(heights, target, rcond=None)[0]
    else:
        both[1] = heights[:, 1] @ target / (heights[:, 1] @ heights[:, 1])
    return np.array([*both, along @ loads / (along @ along)])
