"""The gel's own lengths from the user's presses, with their uncertainty; and what they do not tell."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Frame, Params, Pipeline, PitchWarning, RestSurface, Rig
from gelstereo.setup.ball import BallPress, print_depth
from gelstereo.states import MarkerState, SlipStatus

__all__ = [
    "ASSUMED",
    "GelLength",
    "by_thickness",
    "depth_of",
    "friction_of",
    "over_plate",
    "shoulder_of",
    "slides",
    "thickness_of",
]

Array = npt.NDArray[np.float64]

#: Values without presses that tell them, and their standard deviations. Decay: the default of
#: `contact.decay_mm` with the prior of registration (gel/rest.rs, a third of it). Thickness and friction span
#: those of bench/outside (2 to 5 mm; 0.4 to 0.6) twice. The shoulder is that of a membrane of the decay
#: length.
ASSUMED: Mapping[str, tuple[float, float]] = {
    "decay_mm": (2.5, 0.8),
    "shoulder_mm": (2.5, 0.8),
    "depth_mm": (0.0, 0.3),
    "thickness_mm": (5.0, 3.0),
    "friction": (0.5, 0.2),
    "pull_off_mm2": (0.0, 1.0),
}
#: Heights of the shoulder are used down to so many standard deviations.
MIN_SIGMAS = 5.0
#: Distances from the contact that belong to the shoulder, in pitches: nearer markers may touch, farther ones
#: show the gel's bulge.
SHOULDER_PITCHES = (0.7, 4.5)
#: Fewest frames of a slide, and of a shoulder.
MIN_FRAMES = 3
#: Fewest markers of a frame's shoulder.
MIN_MARKERS = 8
#: Systematic error of the ratio of shear and pressure. On the development half of the finite-element contacts
#: of bench/outside it is 2 to 23 % too large.
FORCE_ERROR = 0.15


@dataclass(frozen=True)
class GelLength:
    """A length of the gel, or a number without unit.

    Attributes
    ----------
    name : str
        As in the sensor file.
    value, sigma : float
    learned : bool
        False for an assumed value.
    why : str
        Where it comes from, or what would tell it.
    """

    name: str
    value: float
    sigma: float
    learned: bool
    why: str

    @classmethod
    def assumed(cls, name: str, why: str) -> GelLength:
        """The value that is assumed, with its wide prior."""
        return cls(name, *ASSUMED[name], False, why)

    def values(self) -> dict[str, float]:
        """Entries of the sensor file."""
        stem, unit = (self.name[: -len(u)], u) if (u := _unit(self.name)) else (self.name, "")
        return {self.name: round(self.value, 4), f"{stem}_sigma{unit}": round(self.sigma, 4)}

    def __str__(self) -> str:
        unit = _unit(self.name).strip("_").replace("mm2", "mm²")
        return f"{self.value:.2f} +- {self.sigma:.2f} {unit}".strip()


def _unit(name: str) -> str:
    return next((unit for unit in ("_mm2", "_mm") if name.endswith(unit)), "")


def depth_of(
    rest: RestSurface, frames: Sequence[Frame], cols: int, ball_radius_mm: float | None, given_mm: float
) -> GelLength:
    """Depth of the print below the skin, from presses with a ball."""
    if given_mm > 0.0:
        return GelLength("depth_mm", given_mm, 0.1 * given_mm, False, "lattice.depth_mm is given")
    if ball_radius_mm is None:
        return GelLength.assumed("depth_mm", "press a ball, and give ball_radius_mm")
    presses = [
        BallPress(np.asarray(frame.points_mm), np.asarray(frame.salient) & _seen(frame)) for frame in frames
    ]
    found = print_depth(rest, presses, cols=cols, radius_mm=ball_radius_mm)
    if found is None:
        return GelLength.assumed("depth_mm", "press a larger ball deeper: too few markers touch it")
    return GelLength(
        "depth_mm", found.depth_mm, found.sigma_mm, True, f"{found.markers} markers under the ball"
    )


def over_plate(
    rig: Rig, rest: RestSurface, sigma_mm: float | None, depth_mm: float = 0.0
) -> tuple[float, float] | None:
    """Distance of the print from the plate that the gel is bonded to, and its standard deviation.

    `rest` is the skin, where it lies so deep below it. None without layers. Layers that were not calibrated
    have a standard deviation of a twentieth of the distance.
    """
    layers = rig.layers
    if layers is None:
        return None
    normal = np.asarray(layers["normal"], np.float64)
    plates_mm = sum(float(plate["thickness_mm"]) for plate in layers["plates"])
    rest_mm = float(np.mean(np.asarray(rest.points_mm) @ normal))
    value = rest_mm - float(layers["gap_mm"]) - plates_mm - depth_mm
    return value, sigma_mm if sigma_mm is not None else 0.05 * abs(value)


def thickness_of(print_mm: tuple[float, float] | None, depth: GelLength) -> GelLength:
    """Thickness of the gel, from the plate to its skin, by the print's distance from the plate."""
    if print_mm is None:
        return GelLength.assumed("thickness_mm", "give [layers]: it is what lies between plate and print")
    value = print_mm[0] + depth.value
    if value <= 0.0:
        return GelLength.assumed("thickness_mm", "the print lies before the plate: check [layers]")
    sigma = float(np.hypot(print_mm[1], depth.sigma))
    return GelLength("thickness_mm", value, sigma, True, "distance of print and plate")


def by_thickness(
    print_mm: tuple[float, float] | None, thickness_mm: tuple[float, float]
) -> tuple[GelLength, GelLength]:
    """Depth of the print, and thickness of the gel, by its measured thickness and standard deviation."""
    thickness = GelLength("thickness_mm", *thickness_mm, True, "measured")
    if print_mm is None:
        return GelLength.assumed("depth_mm", "give [layers]: the depth is counted from the plate"), thickness
    value, sigma = thickness.value - print_mm[0], float(np.hypot(thickness.sigma, print_mm[1]))
    if value < -3.0 * sigma:
        why = f"the print lies {-value:.2f} mm beyond the gel's thickness: check [gel] and [layers]"
        return GelLength.assumed("depth_mm", why), thickness
    return GelLength(
        "depth_mm", max(value, 0.0), sigma, True, "thickness less the print's distance"
    ), thickness


def shoulder_of(rest: RestSurface, frames: Sequence[Frame], pitch_mm: float) -> GelLength:
    """Length over which the gel beside a contact falls to 1/e of its height at the rim."""
    rest_mm = np.asarray(rest.points_mm)
    normal = np.asarray(rest.normal)
    found = []
    for frame in frames:
        touching = np.asarray(frame.salient)
        if touching.sum() < MIN_MARKERS:
            continue
        away_mm = _distances(rest_mm, rest_mm[touching])
        heights_mm = np.asarray(frame.indentation_mm)
        variance = np.einsum("i,nij,j->n", normal, np.asarray(frame.covariance_mm2), normal)
        low, high = (pitches * pitch_mm for pitches in SHOULDER_PITCHES)
        used = _seen(frame) & ~touching & (away_mm > low) & (away_mm < high)
        used &= heights_mm > MIN_SIGMAS * np.sqrt(variance)
        if used.sum() >= MIN_MARKERS:
            slope = np.polyfit(away_mm[used], np.log(heights_mm[used]), 1)[0]
            if slope < 0.0:
                found.append(-1.0 / slope)
    if len(found) < MIN_FRAMES:
        return GelLength.assumed("shoulder_mm", "press deeper, with more of the gel around the part in view")
    value = float(np.median(found))
    # Between presses it varies by more than noise explains, as the shoulder is no exact exponential.
    sigma = float(max(1.4826 * np.median(np.abs(np.array(found) - value)), 0.1 * value))
    return GelLength("shoulder_mm", value, sigma, True, f"{len(found)} frames")


def slides(
    pairs: Sequence[tuple[Any, Any]], rig: Rig, params: Params, thickness: GelLength
) -> tuple[GelLength, GelLength]:
    """Friction from presses that slide, and the pull-off from those that leave a sticky gel.

    The pull-off is the largest pull over Young's modulus, mm².
    """
    hints = (
        GelLength.assumed("friction", "slide a part over the gel until it slips"),
        GelLength.assumed("pull_off_mm2", "no frame shows that the gel pulls at a part"),
    )
    if not thickness.learned or params.to_dict()["lattice"]["layout"] != "square":
        return hints
    settings = {
        "force.method": "ridge",
        "force.thickness_mm": round(thickness.value, 3),
        # Ratios of forces do not depend on it.
        "force.young_kpa": 1.0,
        "slip.method": "rigid",
    }
    pipeline = Pipeline(rig, params.replace(settings))
    loads: list[tuple[float, float, float, bool]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PitchWarning)
        for left, right in pairs:
            frame = pipeline.process(left, right)
            surface, wrench = pipeline.rest, frame.wrench
            if surface is None or wrench is None or wrench.is_cut:
                continue
            normal = np.asarray(surface.normal)
            force = np.asarray(wrench.force_n)
            pressed = float(force @ normal)
            sigma = float(np.sqrt(normal @ np.asarray(wrench.covariance)[:3, :3] @ normal))
            shear = float(np.linalg.norm(force - pressed * normal))
            slips = frame.slip is not None and frame.slip.status == SlipStatus.GROSS
            loads.append((pressed, shear, sigma, slips))
    return friction_of(loads, hints[0]), _pull_off(loads, hints[1])


def friction_of(loads: Sequence[tuple[float, float, float, bool]], otherwise: GelLength) -> GelLength:
    """Friction from frames as (pressure, shear, sigma of the pressure, whether the whole part slips)."""
    ratios = np.array(
        [shear / pressed for pressed, shear, sigma, slips in loads if slips and pressed > 5 * sigma]
    )
    if len(ratios) < MIN_FRAMES:
        return otherwise
    value = float(np.median(ratios))
    scatter = 1.4826 * float(np.median(np.abs(ratios - value)))
    return GelLength(
        "friction", value, float(np.hypot(scatter, FORCE_ERROR * value)), True, f"{len(ratios)} frames"
    )


def _pull_off(loads: Sequence[tuple[float, float, float, bool]], otherwise: GelLength) -> GelLength:
    pulls = [(pressed, sigma) for pressed, _, sigma, _ in loads if pressed < -MIN_SIGMAS * sigma]
    if not pulls:
        return otherwise
    pressed, sigma = min(pulls)
    # Newtons at a modulus of 1 kPa, which is 1e-3 N / mm².
    return GelLength("pull_off_mm2", -1e3 * pressed, 1e3 * sigma, True, f"{len(pulls)} frames that pull")


def _seen(frame: Frame) -> npt.NDArray[np.bool_]:
    return np.asarray(np.asarray(frame.state) == MarkerState.SEEN)


def _distances(points: Array, others: Array) -> Array:
    """Distance of each point from the nearest of the others."""
    apart = np.linalg.norm(points[:, None] - others[None], axis=-1)
    return np.asarray(apart.min(axis=1))
