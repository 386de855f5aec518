"""Two sensor files beside each other: what differs, and what it means for the points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Rig, Simulator, triangulate
from gelstereo.geometry import rigid_fit
from gelstereo.setup.sensor import Sensor, SensorFileError
from gelstereo.setup.tree import leaves

__all__ = ["Comparison", "Difference", "compare_sensors"]

Array = npt.NDArray[np.float64]

#: Measured values of the gel, and their units.
GEL = {
    "rows": "",
    "cols": "",
    "pitch_mm": "mm",
    "dot_radius_mm": "mm",
    "surface_mm": "mm",
    "noise_levels": "grey levels",
    "point_sigma_mm": "mm",
    "decay_mm": "mm",
}


@dataclass(frozen=True)
class Difference:
    """A value that two sensor files give differently.

    Attributes
    ----------
    name, unit
        Name in the sensor file, and unit of the values.
    first, second
        The values; ``None`` where a file has none.
    sigmas
        Difference over its standard deviation, where the files state one; else ``None``.
    """

    name: str
    unit: str
    first: Any
    second: Any
    sigmas: float | None = None

    def __str__(self) -> str:
        numbers = (self.first, self.second)
        text = f"{self.name:<28} {_text(self.first):>12} {_text(self.second):>12} {self.unit}"
        if all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in numbers):
            text += f"   ({self.second - self.first:+.4g}"
            text += f", {self.sigmas:.1f} sigma)" if self.sigmas is not None else ")"
        return text


@dataclass(frozen=True)
class Comparison:
    """What `compare_sensors` found.

    Attributes
    ----------
    differences
        Values that differ, in the order of the file.
    shift_mm
        Mean error of the second sensor's markers at rest if its images are triangulated by the first
        sensor's rig.
    distortion_mm
        Root mean square of what is left of that error after the best rigid motion: a wrong shape.
    point_sigma_mm
        Depth noise of one marker in the second file, to compare these with.
    """

    differences: tuple[Difference, ...]
    shift_mm: float
    distortion_mm: float
    point_sigma_mm: float

    @property
    def is_interchangeable(self) -> bool:
        """Whether the first file can serve for the second sensor: both errors are below a marker's noise."""
        return max(self.shift_mm, self.distortion_mm) < self.point_sigma_mm

    def __str__(self) -> str:
        lines = [str(difference) for difference in self.differences] or ["all values are equal"]
        lines += [
            f"{'shift with the first rig':<28} {1e3 * self.shift_mm:.1f} um",
            f"{'distortion with it':<28} {1e3 * self.distortion_mm:.1f} um",
            f"{'noise of a marker':<28} {1e3 * self.point_sigma_mm:.1f} um",
        ]
        verdict = "can" if self.is_interchangeable else "cannot"
        return "\n".join([*lines, f"the first file {verdict} serve for the second sensor"])


def compare_sensors(first: Sensor, second: Sensor) -> Comparison:
    """Compare two sensors that were set up: the same one at another time, or two of one design.

    Parameters
    ----------
    first, second
        From `load_sensor`.

    Returns
    -------
    Comparison
        Values that differ, and the error that the points of the second sensor would have with the first
        one's rig.

    Raises
    ------
    SensorFileError
        The cameras have different image sizes.
    """
    if first.rig.size_px != second.rig.size_px:
        raise SensorFileError(
            f"the first sensor has images of {_size(first.rig)} and the second of {_size(second.rig)} "
            "pixels; compare sensors with images of one size"
        )
    differences = [
        Difference(name, unit, before, after)
        for (name, (before, unit)), (after, _) in zip(
            _geometry(first.rig).items(), _geometry(second.rig).values(), strict=True
        )
        if not math.isclose(before, after, rel_tol=1e-9, abs_tol=1e-12)
    ]
    layers = (
        leaves(first.rig.layers or {}, open_lists=True),
        leaves(second.rig.layers or {}, open_lists=True),
    )
    differences += _differing(*layers, "layers.")
    for name, unit in GEL.items():
        before, after = first.gel.get(name), second.gel.get(name)
        if before != after:
            differences.append(Difference(name, unit, before, after, _sigmas(first.gel, second.gel, name)))
    differences += _differing(leaves(first.params.to_dict()), leaves(second.params.to_dict()), "params.")
    error_mm, points_mm = _wrong_points(first.rig, second)
    motion = rigid_fit(points_mm, points_mm + error_mm)
    left_mm = points_mm + error_mm - (points_mm @ motion[:3, :3].T + motion[:3, 3])
    return Comparison(
        tuple(differences),
        float(np.mean(np.linalg.norm(error_mm, axis=1))),
        float(np.sqrt(np.mean(np.sum(left_mm**2, axis=1)))),
        float(second.gel["point_sigma_mm"]),
    )


def _wrong_points(rig: Rig, sensor: Sensor) -> tuple[Array, Array]:
    """Error of the sensor's markers at rest, triangulated by another rig, and their places."""
    points_mm = Simulator(sensor.scene()).press().points_mm
    left_px, right_px = sensor.rig.project(points_mm)
    return triangulate(rig, left_px, right_px) - points_mm, points_mm


def _geometry(rig: Rig) -> dict[str, tuple[float, str]]:
    """What people look at in a rig: focal lengths, principal points, baseline and convergence."""
    left, right, t_right_left = rig.left_matrix, rig.right_matrix, rig.t_right_left
    axis = t_right_left[:3, 2]
    return {
        "left focal length": (float(left[0, 0]), "px"),
        "left principal point x": (float(left[0, 2]), "px"),
        "left principal point y": (float(left[1, 2]), "px"),
        "right focal length": (float(right[0, 0]), "px"),
        "right principal point x": (float(right[0, 2]), "px"),
        "right principal point y": (float(right[1, 2]), "px"),
        "baseline": (rig.baseline_mm, "mm"),
        "angle of the optical axes": (math.degrees(math.atan2(math.hypot(axis[0], axis[1]), axis[2])), "deg"),
    }


def _differing(first: Mapping[str, Any], second: Mapping[str, Any], prefix: str) -> list[Difference]:
    names = [*first, *(name for name in second if name not in first)]
    return [
        Difference(prefix + name, _unit(name), first.get(name), second.get(name))
        for name in names
        if first.get(name) != second.get(name)
    ]


def _sigmas(first: Mapping[str, Any], second: Mapping[str, Any], name: str) -> float | None:
    key = name.replace("_mm", "_sigma_mm")
    if key == name or key not in first or key not in second:
        return None
    return float(abs(second[name] - first[name]) / math.hypot(first[key], second[key]))


def _unit(name: str) -> str:
    for ending in ("mm", "px", "deg"):
        if name.endswith(f"_{ending}"):
            return ending
    return ""


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "none" if value is None else str(value)


def _size(rig: Rig) -> str:
    return "x".join(str(pixels) for pixels in rig.size_px)
