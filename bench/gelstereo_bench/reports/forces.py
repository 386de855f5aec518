"""Forces of simulated contacts whose elastic layer is known, so that the law has no error.

Run ``python -m gelstereo_bench.reports.forces`` to fill the table in docs/force.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import ForceEstimator, LayerContact, Params, RestSurface, Wrench
from gelstereo.force.resultant import NAMES, fit_stiffness
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = ["METHODS", "Contact", "Errors", "contacts", "errors", "errors_of", "main"]

Array = npt.NDArray[np.float64]

METHODS = ("ridge", "bounded")
#: Thickness in mm and Poisson's ratio of the gels on which `resultant` is calibrated.
GELS = ((3.0, 0.48), (5.0, 0.47))
#: Noise of a marker, mm.
_SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
#: Fine grid of the layer; every third point is a marker, 0.9 mm apart.
_SIDE, _CELL_MM, _EVERY, _MARKERS = 96, 0.3, 3, 25
_YOUNG_KPA, _REST_Z_MM = 100.0, 30.0
_AXIS = (np.arange(_SIDE) - (_SIDE - 1) / 2) * _CELL_MM
_X, _Y = np.meshgrid(_AXIS, _AXIS)
_PICKED = (_SIDE - _EVERY * (_MARKERS - 1)) // 2 + _EVERY * np.arange(_MARKERS)
_AT = np.ix_(_PICKED, _PICKED)


@dataclass(frozen=True)
class Contact:
    """A contact, its sensed markers and the true loads. Sensor frame, mm; z points into the gel's plate."""

    thickness_mm: float
    poisson_ratio: float
    rest_mm: Array
    points_mm: Array
    touching: npt.NDArray[np.bool_]
    #: (N, 3) mean traction around each marker, kPa.
    traction_kpa: Array
    centre_mm: Array
    #: (6,) force in N, and torque about `centre_mm` in N mm.
    wrench: Array


@dataclass(frozen=True)
class Errors:
    """Errors of one contact by one method."""

    #: Of the pressing force, of the shear force and of the twist, relative to their true values.
    normal: float
    shear: float
    twist: float
    #: Norm of the error of the pressures over the norm of the pressures.
    pressures: float
    #: Error of the sum of the tractions along z, relative to the pressing force.
    summed: float
    #: Normalised squared error of the six components.
    squared: float


def _obstacle_mm(kind: int, centre: Array, random: np.random.Generator) -> Array:
    """Depth of a ball, a plate or a cylinder under the surface; -inf beside it."""
    x, y, turn = _X - centre[0], _Y - centre[1], random.uniform(0.0, np.pi)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    if kind == 0:
        radius, depth, away = random.uniform(1.5, 8.0), random.uniform(0.1, 0.8), np.hypot(x, y)
        within = away <= radius
    elif kind == 1:
        half, depth = random.uniform(1.0, 4.0, 2), random.uniform(0.1, 0.6)
        within = (np.abs(u) < half[0]) & (np.abs(v) < half[1])
        return np.where(within, depth + 0.03 * u, -np.inf)
    else:
        radius, depth, away = random.uniform(1.0, 4.0), random.uniform(0.1, 0.6), np.abs(v)
        within = (away <= radius) & (np.abs(u) <= 4.0)
    below = radius - np.sqrt(np.maximum(radius**2 - away**2, 0.0))
    return np.where(within, depth - below, -np.inf)


def contacts(count: int, seed: int, gel: tuple[float, float] | None = None) -> Iterator[Contact]:
    """Press, drag and twist balls, plates and cylinders in turn. The gel's thickness and Poisson's ratio are
    random if they are not given.
    """
    random = np.random.default_rng(seed)
    for k in range(count):
        thickness_mm, poisson, friction = (
            random.uniform(*between) for between in ((2.5, 5.0), (0.45, 0.495), (0.2, 1.0))
        )
        thickness_mm, poisson = gel or (thickness_mm, poisson)
        layer = LayerContact(
            thickness_mm=thickness_mm,
            poisson_ratio=poisson,
            rows=_SIDE,
            cols=_SIDE,
            cell_mm=_CELL_MM,
            friction=friction,
        )
        centre = random.uniform(-3.0, 3.0, 2)
        obstacle = np.minimum(_obstacle_mm(k % 3, centre, random), 0.3 * thickness_mm)
        shift, twist = random.uniform(-0.15, 0.15, 2), random.uniform(-0.05, 0.05)
        carried = np.stack([shift[0] - twist * (_Y - centre[1]), shift[1] + twist * (_X - centre[0])], -1)
        solved = layer.press(obstacle, carried, tolerance_mm=1e-5)
        traction = _YOUNG_KPA * np.dstack([solved.traction, -solved.pressure])
        force = traction.reshape(-1, 3) * _CELL_MM**2 * 1e-3
        lever = np.column_stack([_X.ravel() - centre[0], _Y.ravel() - centre[1], np.zeros(_X.size)])
        near = (-1, 0, 1)
        around = sum(traction[np.ix_(_PICKED + a, _PICKED + b)] for a in near for b in near) / len(near) ** 2
        rest = np.column_stack([_X[_AT].ravel(), _Y[_AT].ravel(), np.full(_MARKERS**2, _REST_Z_MM)])
        motion = solved.motion_mm[_AT].reshape(-1, 3) * [1.0, 1.0, -1.0]
        yield Contact(
            thickness_mm,
            poisson,
            rest,
            rest + motion + _SIGMA_MM * random.normal(size=rest.shape),
            (solved.pressure > 0.0)[_AT].ravel(),
            np.asarray(around).reshape(-1, 3),
            np.array([*centre, _REST_Z_MM]),
            np.concatenate([force.sum(axis=0), np.cross(lever, force).sum(axis=0)]),
        )


def errors(contact: Contact, method: str) -> Errors:
    """Estimate the loads of a contact, and compare them with the truth."""
    force: dict[str, object] = {
        "method": method,
        "thickness_mm": contact.thickness_mm,
        "poisson_ratio": contact.poisson_ratio,
        "young_kpa": _YOUNG_KPA,
    }
    return errors_of(contact, force)


def errors_of(contact: Contact, force: dict[str, object]) -> Errors:
    """The same with these settings."""
    traction, wrench = _sensed(contact, force)
    error = np.concatenate([wrench.force_n, wrench.torque_nmm]) - contact.wrench
    pressure = contact.traction_kpa[:, 2]
    return Errors(
        abs(error[2] / contact.wrench[2]),
        float(np.hypot(*error[:2]) / np.hypot(*contact.wrench[:2])),
        abs(error[5] / contact.wrench[5]),
        float(np.linalg.norm(traction[:, 2] - pressure) / np.linalg.norm(pressure)),
        abs(float(traction[:, 2].sum()) * (_EVERY * _CELL_MM) ** 2 * 1e-3 / contact.wrench[2] - 1.0),
        float(error @ np.linalg.solve(wrench.covariance, error)),
    )


def _sensed(contact: Contact, force: dict[str, object]) -> tuple[Array, Wrench]:
    """Tractions, and the wrench about the contact's centre."""
    count = len(contact.rest_mm)
    estimator = ForceEstimator(
        RestSurface(contact.rest_mm),
        Params().replace(force=force),
        cols=_MARKERS,
        covariance_mm2=np.tile(1e-12 * np.eye(3), (count, 1, 1)),
    )
    noise = np.tile(np.diag(_SIGMA_MM**2), (count, 1, 1))
    traction, found = estimator.run(contact.points_mm, noise, contact.touching.tolist())
    assert found is not None, "every contact touches markers"
    return traction, found.about(contact.centre_mm)


def _stiffness(loads: Iterable[Contact], thickness_mm: float) -> dict[str, object]:
    """Settings of `resultant` that fit these loads."""
    unit, known = [], []
    for contact in loads:
        of_load = []
        for name in NAMES:
            stiffness = {each: float(each == name) for each in NAMES}
            force = {"method": "resultant", "thickness_mm": thickness_mm, **stiffness}
            _, wrench = _sensed(contact, force)
            of_load.append([-wrench.force_n[2], *wrench.force_n[:2], -wrench.torque_nmm[2]])
        force_n, torque_nmm = contact.wrench[:3], contact.wrench[3:]
        unit.append(of_load)
        known.append([-force_n[2], *force_n[:2], -torque_nmm[2]])
    found = fit_stiffness(np.array(unit).transpose(1, 0, 2), np.array(known))
    assert found is not None
    return {"method": "resultant", "thickness_mm": thickness_mm, **dict(zip(NAMES, found, strict=True))}


def _resultants(count: int) -> list[list[str]]:
    """Errors by sums without a layer, calibrated with six balls on the same gel."""
    rows = []
    for thickness_mm, poisson in GELS:
        balls = list(contacts(18, 6, (thickness_mm, poisson)))[::3]
        force = _stiffness(balls, thickness_mm)
        tested = list(contacts(count, 7, (thickness_mm, poisson)))
        for kind, name in enumerate(("balls", "plates", "cylinders")):
            found = [errors_of(contact, force) for contact in tested[kind::3]]
            rms = [100 * np.sqrt(np.mean([e.normal**2 for e in found]))]
            rms += [
                100 * np.median([getattr(e, each) for e in found]) for each in ("normal", "shear", "twist")
            ]
            squared = f"{np.mean([e.squared for e in found]):.1f}"
            gel = f"{thickness_mm:g} mm, {poisson:g}"
            rows.append([gel, name, *(f"{each:.0f}" for each in rms), squared])
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Fill the table of simulated forces in docs/force.md."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.forces", description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    parser.add_argument("--contacts", type=int, default=120, help="number of contacts")
    options = parser.parse_args(arguments)
    found: dict[str, list[Errors]] = {method: [] for method in METHODS}
    for contact in contacts(options.contacts, seed=5):
        for method in METHODS:
            found[method].append(errors(contact, method))
    rows = []
    for method, all_errors in found.items():
        middle = [
            f"{100 * np.median([getattr(e, name) for e in all_errors]):.1f}"
            for name in ("normal", "shear", "twist", "pressures", "summed")
        ]
        rows.append([f"`{method}`", *middle, f"{np.mean([e.squared for e in all_errors]):.1f}"])
    head = ["method", "pressing force, %", "shear, %", "twist, %", "pressures, %", "sum of the tractions, %"]
    head.append("normalised squared error (6)")
    replace_between(options.docs / "force.md", "forces", table(head, rows))
    head = ["thickness, Poisson's ratio", "contacts", "pressing force, rms, %", "median", "shear, median, %"]
    head += ["twist, median, %", "normalised squared error (6)"]
    replace_between(options.docs / "force.md", "resultants", table(head, _resultants(options.contacts // 2)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
