"""Evaluate registration under other laws than the simulator's: `python -m outside.judge_registration`.

The contacts are those of `data/grasped`; markers carry noise of 30 um along the camera's axis, half of it
across. By law, over starts of 5 degrees and 1 mm, 10 and 2, 20 and 3.5, 30 and 5:

- success, %: within 2 degrees and 0.3 mm over the directions that the contact determines, by start;
- over the bound: rms error of the successes over the Cramer-Rao bound, median;
- within 95 %: successes with the truth inside the 95 % region of their covariance;
- NEES: squared error of successes over the stated variance, per direction, median and mean; 1 is right;
- beyond 3x: successes with the truth beyond three times that region's radius;
- right: successes by verdict, `unsure` and `does_not_fit`;
- wrong believed: wrong results with the verdict `fits`: with another part; from guesses on another face,
  turned end for end or by a quarter; from ordinary starts without success, where no alternative is the truth.

Results that are equivalent to the truth by the part's surface are not counted, because no height could
distinguish them.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from gelstereo import (
    Error,
    Localization,
    Params,
    RestSurface,
    Template,
    localize,
    pressure_saliency,
)
from gelstereo.geometry import se3_exp
from gelstereo_bench.frontier.grasps import SIDE, Grasp, Start, surface_normals
from gelstereo_bench.frontier.nees import Nees
from gelstereo_bench.frontier.scenes import SURFACE_MM, VGA

from .grasped import DATA, PARTS, jobs, lattice

Array = npt.NDArray[np.float64]

SIGMA_MM = 0.03 * np.array([0.5, 0.5, 1.0])
STARTS = [Start(f"{deg:.0f} deg", deg, mm) for deg, mm in ((5.0, 1.0), (10.0, 2.0), (20.0, 3.5), (30.0, 5.0))]
# As in `gelstereo_bench.frontier.grasps`: faces steeper than this, as a cosine, are ignored in the bound.
STEEP_COSINE = 0.35
MIN_SALIENT = 12
# Limits for an equivalent pose: rms distance of markers in contact, and largest penetration: two and five
# standard deviations.
ALIKE_MM, WITHIN_MM = 0.06, 0.15


@dataclass(frozen=True)
class Judged:
    """A contact, with and without noise."""

    law: str
    #: Of the guesses.
    seed: int
    grasp: Grasp
    true_points_mm: Array
    touching: npt.NDArray[np.bool_]

    def is_alike(self, found: Array) -> bool:
        """Whether a pose is consistent with the gel without noise."""
        back = (self.true_points_mm - found[:3, 3]) @ found[:3, :3]
        off = self.grasp.template.closest(back).distances_mm
        return bool(np.sqrt(np.mean(off[self.touching] ** 2)) < ALIKE_MM and off.min() > -WITHIN_MM)

    def elsewhere(self) -> Array:
        """A guess on another face: end for end about the press direction, or a quarter turn about the part's
        axis.
        """
        turn = [0.0, 0.0, np.pi] if self.seed % 2 else list(0.5 * np.pi * self.grasp.t_sensor_object[:3, 2])
        about = np.eye(4)
        about[:3, 3] = self.grasp.centre_mm
        motion = se3_exp(np.array([*turn, 0.0, 0.0, 0.0]))
        return np.asarray(about @ motion @ np.linalg.inv(about) @ self.grasp.guess(STARTS[1], self.seed))


def contacts(half: str, draw: int = 0) -> Iterator[Judged]:
    """All contacts of a half, with a draw of noise and guesses."""
    templates = {
        press.name: Template.from_mesh(press.make(), units="mm", spacing_mm=0.3).with_grid()
        for press in PARTS
    }
    flat = np.column_stack((lattice() + VGA.centre_mm, np.full(SIDE * SIDE, SURFACE_MM)))
    rest, decay_mm = RestSurface(flat), Params().to_dict()["contact"]["decay_mm"]
    for name, (entry, press, seeds) in jobs().items():
        if entry["half"] != half or not (DATA / f"{name}.npz").exists():
            continue
        with np.load(DATA / f"{name}.npz") as file:
            stored = {key: file[key] for key in ("poses", "points_mm", "touching")}
        mesh, template = press.make(), templates[press.name]
        for k, seed in enumerate(seeds):
            random = np.random.default_rng([seed, 83, len(name), *([draw] if draw else [])])
            true, pose = stored["points_mm"][k].astype(np.float64), stored["poses"][k]
            touching = np.unpackbits(stored["touching"][k], count=len(true)).astype(bool)
            points = true + SIGMA_MM * random.normal(size=true.shape)
            heights, variance = rest.indentation_mm(points), np.full(len(points), SIGMA_MM[2] ** 2)
            salient, _ = pressure_saliency(rest, heights, variance, rows=SIDE, cols=SIDE, decay_mm=decay_mm)
            salient = np.asarray(salient)
            if salient.sum() < MIN_SALIENT:
                continue
            normals = np.full_like(points, np.nan)
            normals[touching] = surface_normals(mesh, template, pose, true[touching])
            normals[~(normals[:, 2] < -STEEP_COSINE)] = np.nan
            covariance = np.broadcast_to(np.diag(SIGMA_MM**2), (int(salient.sum()), 3, 3)).copy()
            grasp = Grasp(press.name, mesh, template, points[salient], covariance, points, normals, pose)
            yield Judged(entry["law"], seed + 1000 * draw, grasp, true, touching)


@dataclass
class Figures:
    """Figures of one law."""

    success: dict[str, list[bool]] = field(default_factory=lambda: defaultdict(list))
    over_bound: list[float] = field(default_factory=list)
    nees: Nees = field(default_factory=Nees)
    verdicts: list[str] = field(default_factory=list)
    other_part: list[bool] = field(default_factory=list)
    other_face: list[bool] = field(default_factory=list)
    failed_believed: list[bool] = field(default_factory=list)

    def row(self, name: str) -> str:
        """One row of the table."""
        squared, counts = np.asarray(self.nees.squared), np.asarray(self.nees.directions)
        beyond = squared > 9.0 * chi2.ppf(0.95, counts)
        cells = (
            name,
            f"{len(self.other_part)}",
            " / ".join(f"{percent(self.success[start.name]):.1f}" for start in STARTS),
            f"{np.median(self.over_bound):.2f}",
            f"{self.nees.within:.0f}",
            f"{np.median(squared / counts):.2f} / {self.nees.mean:.2f}",
            f"{percent(beyond):.1f}",
            " / ".join(
                f"{percent([it == name for it in self.verdicts]):.1f}" for name in ("unsure", "does_not_fit")
            ),
            f"{percent(self.other_part):.1f}",
            f"{percent(self.other_face):.1f} of {len(self.other_face)}",
            f"{sum(self.failed_believed)} of {len(self.failed_believed)}",
        )
        return "| " + " | ".join(cells) + " |\n"


HEAD = (
    "| law | contacts | success, % | over the bound, median | within 95 %, % | NEES, median / mean | beyond "
    "3x, % | right unsure / doubted, % | other part believed, % | other face believed, % | failed believed "
    "|\n" + 11 * "|---" + "|\n"
)


def percent(flags: object) -> float:
    """Percentage of true values."""
    found = np.asarray(flags, dtype=bool)
    return 100.0 * float(found.mean()) if len(found) else float("nan")


def registered(one: Judged, template: Template, guess: Array, params: Params) -> Localization | None:
    """Registration with all sensed data; None if it is refused."""
    grasp = one.grasp
    try:
        return localize(
            grasp.points_mm,
            template,
            guess=guess,
            all_points_mm=grasp.all_points_mm,
            covariance_mm2=grasp.covariance_mm2,
            params=params,
        )
    except Error:
        return None


def believed(found: Localization | None) -> bool:
    """Whether a pose has the verdict that it explains the contact."""
    return found is not None and found.verdict == "fits"


def judge(one: Judged, other: Grasp, params: Params, figures: Figures) -> None:
    """Search from every start, with another part, and on another face."""
    grasp = one.grasp
    for start in STARTS:
        found = registered(one, grasp.template, grasp.guess(start, one.seed), params)
        pose = None if found is None else np.asarray(found.t_sensor_object)
        score = None if pose is None else grasp.score(pose)
        right = score is not None and score.success
        figures.success[start.name].append(right)
        if right and found is not None and score is not None:
            figures.over_bound.append(float(np.sqrt(score.squared / max(score.observable, 1))))
            figures.nees.add(found, grasp.t_sensor_object)
            figures.verdicts.append(found.verdict)
        elif found is not None and pose is not None and not one.is_alike(pose):
            listed = any(grasp.score(np.asarray(pose)).success for pose, _ in found.alternatives)
            figures.failed_believed.append(believed(found) and not listed)
    guess = np.array(grasp.guess(STARTS[1], one.seed))
    # At the other part's middle instead of its origin.
    shift = guess[:3, :3] @ (grasp.mesh.bounds.mean(axis=0) - other.mesh.bounds.mean(axis=0))
    guess[:3, 3] += shift
    figures.other_part.append(believed(registered(one, other.template, guess, params)))
    found = registered(one, grasp.template, one.elsewhere(), params)
    if found is None:
        figures.other_face.append(False)
    else:
        pose = np.asarray(found.t_sensor_object)
        if not (grasp.score(pose).success or one.is_alike(pose)):
            figures.other_face.append(believed(found))


def main() -> int:
    """Print one row for each law."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--half",
        choices=("w", "j", "further"),
        default="w",
        help="w: for work, j: judged, further: more parts for work",
    )
    parser.add_argument("--without-gel", action="store_true", help="register without the gel's model")
    parser.add_argument("--by-part", action="store_true", help="a row for each part under each law")
    parser.add_argument("--draw", type=int, default=0, help="other noise and guesses for each number")
    parser.add_argument(
        "--half-turns", type=int, default=0, help="`register.surface_search.half_turn_budget`"
    )
    parser.add_argument("--budget", type=int, help="`register.surface_search.budget`")
    options = parser.parse_args()
    params = Params().replace(
        {"register": {"method": "surface_search", "advanced": {"search_radius_mm": 8.0}}}
    )
    params = params.replace({"register.surface_search.half_turn_budget": options.half_turns})
    if options.budget:
        params = params.replace({"register.surface_search.budget": options.budget})
    if options.without_gel:
        # A gel that returns to rest within a pitch is not evaluated.
        params = params.replace({"contact.decay_mm": 0.5})
    every = list(contacts(options.half, options.draw))
    by_part = {one.grasp.part: one.grasp for one in every}
    names = list(by_part)
    figures: dict[str, Figures] = defaultdict(Figures)
    for one in every:
        other = by_part[names[(names.index(one.grasp.part) + 1 + one.seed % 2) % len(names)]]
        row = f"{one.law}, {one.grasp.part}" if options.by_part else one.law
        judge(one, other, params, figures[row])
    sys.stdout.write(HEAD)
    for name, found in figures.items():
        sys.stdout.write(found.row(name))
    return 0


if __name__ == "__main__":
    sys.exit(main())
