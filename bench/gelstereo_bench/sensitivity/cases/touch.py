"""Forces, slip and motion of simulated contacts, with the reports' data."""

from __future__ import annotations

import numpy as np

from gelstereo import MotionStatus, SlipStatus
from gelstereo_bench.reports import forces, motion, motion_loops, slip
from gelstereo_bench.sensitivity.figures import Case, Evaluation

__all__ = ["load"]

_CONTACTS, _RUNS, _TURNS = 18, 45, 2


def _forces(contacts: list[forces.Contact]) -> Evaluation:
    out = Evaluation()
    resultant = {"method": "resultant", "thickness_mm": 4.0}
    resultant |= {"patch_n_per_mm3": 0.03, "around_n_per_mm3": 0.04, "shear_n_per_mm3": 0.0125}
    for method in (*forces.METHODS, "resultant"):
        found = [
            forces.errors_of(contact, resultant) if method == "resultant" else forces.errors(contact, method)
            for contact in contacts
        ]
        for each in found:
            out.see([each.normal, each.shear, each.twist, each.pressures, each.squared])
        # The stiffnesses of `resultant` are those of no gel in particular.
        for name in ("normal", "shear", "pressures")[: None if method != "resultant" else 0]:
            rms = np.sqrt(np.mean([getattr(each, name) ** 2 for each in found]))
            out.figures[f"{method}: error of {name}, rms, %"] = 100.0 * float(rms)
        out.figures[f"{method}: wrench NEES"] = float(np.mean([each.squared for each in found])) / 6.0
    return out


def _slip(runs: list[slip.Run]) -> Evaluation:
    out, random = Evaluation(), np.random.default_rng(31)
    seen = [slip.follow(run, random, patch_is_known=False) for run in runs]
    for each in seen:
        out.see([float(s.ratio or 0.0) for s in each], [int(s.status) for s in each])
    known = [s for run in seen for s in run if s.ratio is not None and s.status != SlipStatus.GROSS]
    off = [s.truth - float(s.ratio or 0.0) for s in known]
    within = [s.between[0] - 1e-9 <= s.truth <= s.between[1] + 1e-9 for s in known]
    out.figures["slip: error of the stick ratio, rms, %"] = 100.0 * float(np.sqrt(np.mean(np.square(off))))
    out.figures["slip: true ratio in its range, %"] = 100.0 * float(np.mean(within))
    alarms = slip.alarms("", seen)[1:]
    for name, text in zip(("in time", "false alarms", "gross in time", "gross without"), alarms, strict=True):
        out.figures[f"slip: {name}"] = float(text.partition(" ")[0])
    return out


def _motion(runs: list[slip.Run]) -> Evaluation:
    out, random = Evaluation(), np.random.default_rng(31)
    degrees, squares, partial = [], [], []
    for run in runs:
        seen = motion.follow(run, random, patch_is_known=False)
        if len(seen) < 7:
            continue
        held = [s for s in seen[5:] if s.truth >= 0.5]
        partial += [s.motion.status == MotionStatus.PARTIAL for s in seen]
        out.see(seen[-1].motion.pose, seen[-1].motion.covariance)
        if held:
            degrees.append(motion.errors(seen[4], held[-1])[0])
            squares.append(motion.normalized(held[-1], seen[0]))
    out.figures["motion: rotation, degrees"] = float(np.median(degrees))
    out.figures["motion: NEES"] = float(np.median(squares))
    out.figures["motion: frames not determined, %"] = 100.0 * float(np.mean(partial))
    return out


def _loops(rods: dict[str, tuple[motion_loops.Array, motion_loops.Frames]]) -> Evaluation:
    out = Evaluation()
    for rod, (rest, frames) in rods.items():
        found = [motion_loops.follow(rest, frames, seed, 32) for seed in range(_TURNS)]
        out.see([each.squared for each in found])
        out.figures[f"{rod}: loops"] = sum(each.loops for each in found)
        out.figures[f"{rod}: NEES"] = float(np.mean([each.squared for each in found])) / 6.0
    return out


def _recognition() -> Evaluation:
    out = Evaluation()
    for part, _, right, wrong, others in motion_loops.recognition_rows(4):
        out.see([ord(each) for each in f"{right} {wrong} {others}"])
        out.figures[f"{part}: recognized"] = float(right)
        out.figures[f"{part}: at a wrong pose"] = float(wrong)
        out.figures[f"{part}: other parts found"] = float(others.partition(" ")[0])
    return out


def load() -> dict[str, Case]:
    """Simulate all contacts."""
    contacts = list(forces.contacts(_CONTACTS, seed=5))
    runs = list(slip.runs(_RUNS, seed=30))
    rods = {rod: motion_loops.roll(rod) for rod in ("oval", "rib")}
    return {
        "forces": Case(lambda: _forces(contacts)),
        "slip": Case(lambda: _slip(runs)),
        "motion": Case(lambda: _motion(runs)),
        "loops": Case(lambda: _loops(rods)),
        "recognition": Case(_recognition),
    }
