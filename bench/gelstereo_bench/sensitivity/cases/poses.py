"""Registration by every method: parts in gels of four laws (half for work) and in the simulator's, and poses
fused.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from gelstereo import Error, Localization, Localizer, Params, Template
from gelstereo.geometry import fuse_plane, fuse_poses, se3_exp
from gelstereo_bench.frontier.grasps import GRASPED, NOISES, Grasp, Start, grasps
from gelstereo_bench.frontier.nees import Nees
from gelstereo_bench.sensitivity.figures import Case, Evaluation
from outside.judge_registration import contacts

__all__ = ["load"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Trial:
    """A method, how far its guesses are off, and of how many contacts it gets one."""

    method: str
    start: Start
    every: int = 1


_TRIALS = (
    _Trial("surface_search", Start("", 20.0, 3.5), 3),
    _Trial("surface_close", Start("", 5.0, 1.0)),
    _Trial("filterreg_point", Start("", 5.0, 1.0), 18),
    _Trial("ransac_icp", Start("", 2.0, 0.5), 36),
)
#: Of the stored contacts every so manieth; simulated contacts of each part.
_EVERY, _SEEDS = 2, range(1, 6)
_SEQUENCE_FRAMES = 12
#: Steps are taken or not by chance: fewer cases than this are no change.
_CASES = 1.5


@dataclass
class _Tally:
    right: list[bool] = field(default_factory=list)
    over_bound: list[float] = field(default_factory=list)
    nees: Nees = field(default_factory=Nees)
    doubted: list[bool] = field(default_factory=list)

    def add(self, grasp: Grasp, found: Localization | None) -> None:
        """Count one answer."""
        if found is None:
            self.right.append(False)
            return
        score = grasp.score(np.asarray(found.t_sensor_object))
        self.right.append(score.success)
        if score.success:
            self.over_bound.append(float(np.sqrt(score.squared / max(score.observable, 1))))
            self.nees.add(found, grasp.t_sensor_object)
            self.doubted.append(found.verdict != "fits")

    def put(self, name: str, out: Evaluation) -> None:
        """Write the figures."""
        right = 100.0 * float(np.mean(self.right)) if self.right else float("nan")
        out.put(f"{name}: right poses, %", right, _CASES * 100.0 / max(len(self.right), 1))
        count = len(self.over_bound)
        if not count:
            return
        median, one = float(np.median(self.over_bound)), 100.0 / count
        # A median of few answers is known no better.
        out.put(f"{name}: median error over the bound", median, 0.3 * median / np.sqrt(count))
        out.put(f"{name}: within the stated 95 %, %", self.nees.within, _CASES * one)
        out.put(f"{name}: right but doubted, %", 100.0 * float(np.mean(self.doubted)), _CASES * one)


def _params(method: str) -> Params:
    advanced = {"search_radius_mm": 3.0 if method == "ransac_icp" else 8.0}
    return Params().replace({"register": {"method": method, "advanced": advanced}})


def _templates() -> dict[str, Template]:
    return {
        each.name: Template.from_mesh(each.make(), units="mm", spacing_mm=0.3).with_grid() for each in GRASPED
    }


def _tried(grasp: Grasp, template: Template, guess: Array, params: Params) -> Localization | None:
    try:
        return replace(grasp, template=template).registered(guess, params)
    except Error:
        return None


def _followed(grasp: Grasp, template: Template, out: Evaluation) -> None:
    """A part that turns and slides in the hand, frame after frame; then it is lost."""
    localizer = Localizer(
        template, guess=grasp.guess(Start("", 5.0, 1.0), 1), params=_params("surface_search")
    )
    right = 0
    for k in range(_SEQUENCE_FRAMES):
        # All turns about the contact, by half a degree a frame, and a jump in the middle.
        angle = np.deg2rad(0.5 * k + (8.0 if k >= _SEQUENCE_FRAMES // 2 else 0.0))
        about = np.eye(4)
        about[:3, 3] = grasp.centre_mm
        motion = about @ se3_exp(np.array([0.0, 0.0, angle, 0.0, 0.0, 0.0])) @ np.linalg.inv(about)
        turn = motion[:3, :3]
        noise = np.random.default_rng([k, 7]).normal(size=grasp.all_points_mm.shape) * 0.005
        points = grasp.all_points_mm @ turn.T + motion[:3, 3] + noise
        salient = (grasp.all_points_mm[:, None] == grasp.points_mm[None]).all(axis=2).any(axis=1)
        moved = replace(
            grasp,
            points_mm=points[salient],
            all_points_mm=points,
            t_sensor_object=motion @ grasp.t_sensor_object,
        )
        try:
            found = localizer.process(
                points[salient], all_points_mm=points, covariance_mm2=grasp.covariance_mm2
            )
        except Error:
            out.see([k])
            continue
        out.see([found.digest])
        right += int(moved.score(np.asarray(found.t_sensor_object)).success)
    out.put("followed: right poses, %", 100.0 * right / _SEQUENCE_FRAMES, _CASES * 100.0 / _SEQUENCE_FRAMES)


def _fused(out: Evaluation) -> None:
    """Two poses of known covariance, and a plane; the truth is the identity."""
    errors = []
    for seed in range(60):
        random = np.random.default_rng([seed, 31])
        spread = [np.array([0.2, 0.02, 0.1, 2.0, 0.1, 0.5]) * random.uniform(0.5, 2.0, 6) for _ in range(2)]
        poses = [se3_exp(sigma * random.normal(size=6)) for sigma in spread]
        told = [np.diag(1.0 / sigma**2) for sigma in spread]
        try:
            pose, information, mismatch = fuse_poses(poses[0], told[0], poses[1], told[1])
            pose, information, off = fuse_plane(
                pose, information, [0.0, 0.0, 5.0], [0.0, 0.0, 1.0], 5.0, 0.02
            )
        except Error:
            out.see([seed])
            continue
        out.see(pose, information, [mismatch, off])
        errors.append(float(np.linalg.norm(np.asarray(pose)[:3, 3])))
    out.figures["fused: error, um"] = (
        1000.0 * float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")
    )


def load() -> dict[str, Case]:
    """Read and simulate all contacts: a case for each method, and for what follows from poses."""
    stored = list(contacts("w"))[::_EVERY]
    pressed = [g for part in GRASPED for noise in NOISES[:2] for g in grasps(part, noise, _SEEDS)]
    every = [("simulated", k, g) for k, g in enumerate(pressed)]
    every += [(each.law, each.seed, each.grasp) for each in stored]
    templates: dict[str, Template] = {}

    def prepare() -> None:
        templates.update(_templates())

    def case(trial: _Trial) -> Case:
        def evaluate() -> Evaluation:
            out, tallies, params = Evaluation(), defaultdict[str, _Tally](_Tally), _params(trial.method)
            for law, seed, grasp in every[:: trial.every]:
                found = _tried(grasp, templates[grasp.part], grasp.guess(trial.start, seed), params)
                if found is not None:
                    out.see([found.digest])
                where = "simulated" if law == "simulated" else "other laws"
                tallies[f"{trial.method}, {where}"].add(grasp, found)
            for name, tally in tallies.items():
                tally.put(name, out)
            if trial.method == "surface_search":
                _believed(every, templates, out)
            return out

        return Case(evaluate, prepare)

    def follow() -> Evaluation:
        out = Evaluation()
        _followed(pressed[2], templates[pressed[2].part], out)
        return out

    def fuse() -> Evaluation:
        out = Evaluation()
        _fused(out)
        return out

    cases = {trial.method: case(trial) for trial in _TRIALS}
    return {**cases, "followed": Case(follow, prepare), "fused": Case(fuse)}


def _believed(every: list[tuple[str, int, Grasp]], templates: dict[str, Template], out: Evaluation) -> None:
    """Other parts that are said to fit."""
    names, fits = list(templates), []
    for _, seed, grasp in every[::9]:
        other = names[(names.index(grasp.part) + 1) % len(names)]
        guess = grasp.guess(Start("", 10.0, 2.0), seed)
        found = _tried(grasp, templates[other], guess, _params("surface_search"))
        fits.append(found is not None and found.verdict == "fits")
    out.put("another part believed, %", 100.0 * float(np.mean(fits)), _CASES * 100.0 / len(fits))
