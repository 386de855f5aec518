"""Force and torque on contacts solved by finite elements: `python -m outside.judge_force [--half w|j]`.

Markers 0.9 mm apart have the true displacement and noise of 1.5 um sideways and 5 um along the line of sight.
The markers in contact are given, so that the figures are those of the force alone. The true force is the
integral of the stored pressures and tractions. Gels are neo-Hookean and of finite width; the estimator's
layer is linear and unbounded.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

import gelstereo
from gelstereo.force import compute_compliance

from .contacts import HALF_MM, table
from .fields import DATA, Field

Array = npt.NDArray[np.float64]

ROWS, PITCH_MM, SURFACE_MM = 25, 0.9, 30.0
#: Gel beyond the markers of a centred lattice.
RIM_MM = HALF_MM - PITCH_MM * (ROWS // 2)
#: Places of the lattice beside the part's first touch.
OFFSETS_MM = ((0.0, 0.0), (0.2, -0.13), (0.45, 0.3))
SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
#: Unit of the stored pressures.
SHEAR_MODULUS_KPA = 30.0


@dataclass(frozen=True)
class Case:
    """Estimated and true force of one contact. x and y lie in the gel's plane; z is into the layer."""

    gel: str
    strain: float
    touching: int
    estimate: Array
    truth: Array
    covariance: Array
    misfit: float
    seconds: float

    @property
    def pressing_error(self) -> float:
        """Relative."""
        return float(self.estimate[2] / self.truth[2] - 1.0)

    @property
    def shear_error(self) -> float:
        """In units of the pressing force."""
        return float(np.hypot(*(self.estimate - self.truth)[:2]) / self.truth[2])

    @property
    def torque_error(self) -> float:
        """About the part's first touch, over the pressing force, mm."""
        return float(np.linalg.norm((self.estimate - self.truth)[3:]) / self.truth[2])

    @property
    def squared(self) -> float:
        """Normalised squared error of the force: 3 in the mean if the covariance is right."""
        return self._squared(slice(3))

    @property
    def tilt_squared(self) -> float:
        """The same of the torque along the gel: 2 in the mean."""
        return self._squared(slice(3, 5))

    def _squared(self, which: slice) -> float:
        error = (self.estimate - self.truth)[which]
        return float(error @ np.linalg.solve(self.covariance[which, which], error))


def true_wrench(contact: Field, stage: int) -> Array:
    """Force along x, y and into the layer, and torque about the first touch; over the shear modulus, mm² and
    mm³.
    """
    arrays = contact.arrays
    if "r" in arrays:
        r = np.linspace(0.0, arrays["r"][-1], 20_001)
        pressure = np.interp(r, arrays["r"], arrays["pressure"][stage])
        pressing = float(np.trapezoid(2.0 * np.pi * r * pressure, r))
        return np.array([0.0, 0.0, pressing, 0.0, 0.0, 0.0])
    area = np.outer(np.gradient(arrays["y"]), np.gradient(arrays["x"]))
    traction = arrays["traction"][stage]
    forces = (
        np.stack([traction[..., 0], traction[..., 1], arrays["pressure"][stage]], axis=-1) * area[..., None]
    )
    x, y = np.meshgrid(arrays["x"], arrays["y"])
    # The layer's axes are left-handed: its z is into the layer. The torque is that of the sensor's axes.
    sensor = forces * (1.0, 1.0, -1.0)
    arms = np.stack([x, y, np.zeros_like(x)], axis=-1)
    return np.concatenate([forces.sum(axis=(0, 1)), np.cross(arms, sensor).sum(axis=(0, 1))])


@cache
def compliance(gel: str) -> gelstereo.Compliance:
    """Of a square gel with a centred lattice."""
    made = table()["gels"][gel]
    return compute_compliance(
        rows=ROWS,
        cols=ROWS,
        pitch_mm=PITCH_MM,
        thickness_mm=made["thickness_mm"],
        poisson_ratio=made["poisson_ratio"],
        rim_mm=RIM_MM,
    )


def cases(
    half: str | None = None,
    *,
    rim_mm: float | None = None,
    matrix: bool = False,
    stiffening: float = 0.0,
    factors: tuple[float, float] = (1.0, 1.0),
) -> Iterator[Case]:
    """All contacts of a half with at least one marker in contact, at each place of the lattice.

    With `rim_mm`, the gel of the estimate has free sides; with `matrix`, it is computed by finite elements.
    Its thickness and Poisson's ratio are the true ones times `factors`.
    """
    more = {"stiffening": stiffening, **({} if rim_mm is None else {"rim_mm": rim_mm})}
    rng = np.random.default_rng(20211)
    gels = table()["gels"]
    for path in sorted(DATA.glob("*.npz")):
        contact = Field.load(path.stem)
        if "gel" not in contact.meta or half not in (None, contact.meta["half"]):
            continue
        gel = gels[contact.meta["gel"]]
        found = compliance(contact.meta["gel"]) if matrix else None
        for stage, (depth_mm, *_) in enumerate(contact.stages):
            for offset in OFFSETS_MM:
                case = _case(contact, stage, gel, offset, rng, found, {**_taken(gel, factors), **more})
                if case is not None:
                    yield Case(contact.meta["gel"], depth_mm / gel["thickness_mm"], *case)


def _taken(gel: dict[str, float], factors: tuple[float, float]) -> dict[str, float]:
    """The gel's numbers for the estimate, which states how far they are off as standard deviations."""
    young_kpa = 2.0 * (1.0 + gel["poisson_ratio"]) * SHEAR_MODULUS_KPA
    thickness_mm, poisson_ratio = factors[0] * gel["thickness_mm"], factors[1] * gel["poisson_ratio"]
    return {
        "thickness_mm": thickness_mm,
        "thickness_sigma_mm": abs(factors[0] - 1.0) * gel["thickness_mm"],
        "poisson_ratio": poisson_ratio,
        "poisson_sigma": abs(factors[1] - 1.0) * gel["poisson_ratio"],
        "young_kpa": young_kpa,
    }


def _case(
    contact: Field,
    stage: int,
    gel: dict[str, float],
    offset: tuple[float, float],
    rng: np.random.Generator,
    matrix: gelstereo.Compliance | None,
    force: dict[str, float],
) -> tuple[int, Array, Array, Array, float, float] | None:
    along = PITCH_MM * (np.arange(ROWS) - ROWS // 2)
    x, y = (axis.ravel() for axis in np.meshgrid(along + offset[0], along + offset[1]))
    places = np.column_stack([x, y])
    patch = contact.touching(stage, places)
    if not patch.any():
        return None
    rest = np.column_stack([places, np.full(len(places), SURFACE_MM)])
    moved = rest + contact.motion(stage, places) + rng.normal(size=rest.shape) * SIGMA_MM
    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    params = gelstereo.Params().replace(force={"method": "ridge", **force})
    estimator = gelstereo.ForceEstimator(
        gelstereo.RestSurface(rest), params, cols=ROWS, covariance_mm2=1e-6 * covariance, compliance=matrix
    )
    touching = patch.tolist()
    begun = time.perf_counter()
    _, wrench = estimator.run(moved, covariance, touching)
    seconds = time.perf_counter() - begun
    if wrench is None:
        return None
    wrench = wrench.about((0.0, 0.0, SURFACE_MM))
    # The camera sees the gel from below: into the layer is -z of the sensor.
    to = np.diag([1.0, 1.0, -1.0])
    whole = block_diag(to, np.eye(3))
    truth = true_wrench(contact, stage) * SHEAR_MODULUS_KPA * 1e-3
    return (
        int(patch.sum()),
        np.concatenate([to @ wrench.force_n, wrench.torque_nmm]),
        truth,
        whole @ wrench.covariance @ whole.T,
        wrench.misfit,
        seconds,
    )


def calibrated_rms(found: list[Case]) -> float:
    """rms of the relative error of the pressing force, with one modulus for each gel.

    It is fitted to these contacts, as known weights would give it.
    """
    off = []
    for gel in {case.gel for case in found}:
        ratios = np.array([1.0 + case.pressing_error for case in found if case.gel == gel])
        off.append(ratios * ratios.sum() / np.sum(ratios**2) - 1.0)
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _row(name: str, found: list[Case]) -> str:
    pressing = np.array([case.pressing_error for case in found])
    shear = np.array([case.shear_error for case in found])
    torque = np.array([case.torque_error for case in found])
    squared = np.array([case.squared for case in found])
    rms = float(np.sqrt(np.mean(pressing**2)))
    # 7.815 is the 95 % point of chi squared with three degrees of freedom.
    return (
        f"| {name} | {len(found)} | {100 * pressing.mean():+.1f} | {100 * np.median(np.abs(pressing)):.1f} | "
        f"{100 * rms:.1f} | {100 * np.sqrt(np.mean(shear**2)):.1f} | {np.sqrt(np.mean(torque**2)):.3f} | "
        f"{squared.mean():.1f} | "
        f"{100 * np.mean(squared < 7.815):.0f} |"
    )


def main() -> None:
    """Print a table: groups of contacts, errors of the force, and of its covariance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("w", "j"))
    parser.add_argument("--free-sides", action="store_true", help="with the gels' sides in the estimate")
    parser.add_argument("--compliance", action="store_true", help="with matrices by finite elements")
    parser.add_argument("--stiffening", type=float, default=0.0, help="rise of loads by strain (%(default)s)")
    parser.add_argument("--thickness", type=float, default=1.0, help="taken for the true one, times this")
    parser.add_argument("--poisson", type=float, default=1.0, help="the same of Poisson's ratio")
    arguments = parser.parse_args()
    groups: dict[str, list[Case]] = defaultdict(list)
    rim_mm = RIM_MM if arguments.free_sides else None
    found = cases(
        arguments.half,
        rim_mm=rim_mm,
        matrix=arguments.compliance,
        stiffening=arguments.stiffening,
        factors=(arguments.thickness, arguments.poisson),
    )
    for case in found:
        deep = "an eighth" if case.strain <= 0.125 else "a fifth" if case.strain <= 0.2 else "a third"
        name = f"pressed to {deep} of the thickness" if case.touching >= 4 else "one to three markers"
        groups[name].append(case)
        groups["all"].append(case)
    print(
        "| contacts | count | pressing force, mean error, % | median | rms "
        "| shear, rms, % of the pressing force | torque, rms, mm times the pressing force "
        "| normalised squared error (3) | within the 95 % region, % |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name in sorted(groups, key=lambda name: (name == "all", name)):
        print(_row(name, groups[name]))
    calibrated = 100 * calibrated_rms(groups["all"])
    print(
        f"\nWith one modulus fitted to each gel, the rms error of the pressing force is {calibrated:.1f} %."
    )
    times = 1e3 * np.array([case.seconds for case in groups["all"]])
    print(f"A frame takes {np.median(times):.2f} ms, at most {times.max():.2f}.")


if __name__ == "__main__":
    main()
