"""Geometric verdicts against contact physics, on a sample of grasps, with what the time step and the gel's compliance
change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gelstereo.experiments.batch import Configuration, Trial, keyed_seed
from gelstereo.experiments.experiment import Experiment
from gelstereo.experiments.insertion.analysis import wilson
from gelstereo.experiments.insertion.grasp import GRASPED, fit_of
from gelstereo.experiments.insertion.physics import Hand, descend
from gelstereo.experiments.report import Report
from gelstereo.experiments.store import Record
from gelstereo.geometry import se3_exp
from gelstereo.reports.html import Block, Grid, Heading, Paragraph

__all__ = ["EXPERIMENT"]

#: Poses of each part; so many are enough for a share to 10 %.
_REPEATS = 24

#: Settings by name: what differs from the default hand.
_HANDS = {
    "as it is": Hand(),
    "half the time step": Hand(step_s=0.5 * Hand().step_s),
    "twice the time step": Hand(step_s=2.0 * Hand().step_s),
    "half as compliant": Hand().times(0.5),
    "twice as compliant": Hand().times(2.0),
}

#: Poses over the hole are drawn with standard deviations from nothing up to these, so that some fit, some are brought
#: in by chamfer and compliance, and some do not go in at all.
_TURN_RAD, _SHIFT_MM = 0.04, 1.0
#: Where the parts are held behind their tips, and how far from the bottom a part still counts as in.
_HELD_MM, _IN_MM = 25.0, 0.5


def inputs() -> dict[str, str]:
    """The hands."""
    return {
        f"hand {name}": "\n".join(f"{k} = {v}" for k, v in vars(hand).items())
        for name, hand in _HANDS.items()
    }


def trials(repeats: int, seed: int) -> Sequence[Trial]:
    """Poses over the holes."""
    return [
        Trial({"part": letter, "pose": pose}, keyed_seed(seed, "physics", letter, pose))
        for letter in GRASPED
        for pose in range(1, repeats + 1)
    ]


def run(configuration: Configuration, seed: int) -> Record:
    """Judge one pose by geometry, and lower the part with every hand: ``room_mm``, and depths by hand."""
    fit = fit_of(configuration["part"])
    random = np.random.default_rng(seed)
    twist = random.uniform() * random.normal(size=6) * np.repeat([_TURN_RAD, _SHIFT_MM], 3)
    # About the middle of the hole: the part's origin is far from it.
    about = np.eye(4)
    about[2, 3] = 0.5 * (fit.hole.tip_mm + fit.hole.mouth_mm)
    placed = about @ np.asarray(se3_exp(twist)) @ np.linalg.inv(about)
    return {
        "room_mm": fit.room_mm(placed),
        "depths_mm": {
            name: descend(fit.hole, fit.end, placed, hand, _HELD_MM) for name, hand in _HANDS.items()
        },
    }


_ASKED = (
    "Does a part that geometry lets in go in with contact, friction and a hand that yields, and what does the hand's "
    "compliance add? Parts are lowered into their holes from poses of which some fit and some do not."
)
_CONDITIONS = (
    f"simulated (MuJoCo); poses over the hole with standard deviations of up to {_TURN_RAD} rad and {_SHIFT_MM} mm; a "
    f"part is in from {_IN_MM} mm above the bottom on; force stop {Hand().force_stop_n} N"
)


def report(trials: Sequence[Trial], records: Sequence[Record], given: Mapping[str, str]) -> Report:
    """Compare both verdicts."""
    rows = []
    for letter in dict.fromkeys(trial.configuration["part"] for trial in trials):
        mine = [r for t, r in zip(trials, records, strict=True) if t.configuration["part"] == letter]
        rows.append([f"({letter}) {GRASPED[letter].name.replace('_', ' ')}", *_row(mine, letter)])
    head = ["part", "geometry: in %", *(f"{name}: of those in / of the others, %" for name in _HANDS)]
    verdicts = Grid("Share of poses that go in (95 % interval)", head, rows)
    findings: list[Block] = [
        Heading("Geometry and physics"),
        Paragraph(
            "Of the poses that geometry lets in all should go in; of the others, those that a chamfer and a yielding "
            "hand still bring in are what geometry leaves out."
        ),
        verdicts,
    ]
    return Report("Insertion by contact physics", _ASKED, _CONDITIONS, findings, given, [verdicts])


def _row(records: Sequence[Record], letter: str) -> list[str]:
    part = GRASPED[letter]
    fits = [record["room_mm"] >= 0.0 for record in records]

    def share(hits: Sequence[bool]) -> str:
        if not hits:
            return "-"
        low, high = wilson(sum(hits), len(hits))
        return f"{100 * np.mean(hits):.0f} ({100 * low:.0f} to {100 * high:.0f})"

    cells = [share(fits)]
    for name in _HANDS:
        went = [record["depths_mm"][name] > part.depth_mm - _IN_MM for record in records]
        within = [w for w, f in zip(went, fits, strict=True) if f]
        without = [w for w, f in zip(went, fits, strict=True) if not f]
        cells.append(f"{share(within)} / {share(without)}")
    return cells


EXPERIMENT = Experiment(
    name="insertion-physics",
    repeats=_REPEATS,
    inputs=inputs,
    trials=trials,
    run=run,
    report=lambda t, r: report(t, r, inputs()),
)
