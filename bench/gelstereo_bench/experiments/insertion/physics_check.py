"""Geometric verdicts against contact physics, on a sample of poses, with what the time step, the gel's compliance and
the force stop change.

A trial is a direction in which a part stands off over its hole. Along it the part goes in up to some distance: by
geometry, and by physics with every hand. Such limits show small changes that a share of verdicts hides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gelstereo.geometry import se3_exp
from gelstereo.view.html import Block, Figure, Grid, Heading, Paragraph
from gelstereo_bench.experiments.batch import Configuration, Trial, keyed_seed
from gelstereo_bench.experiments.experiment import Experiment
from gelstereo_bench.experiments.figures import as_svg, box_plots
from gelstereo_bench.experiments.insertion.grasp import GRASPED, Fit, fit_of
from gelstereo_bench.experiments.insertion.physics import Hand, descend
from gelstereo_bench.experiments.report import Report
from gelstereo_bench.experiments.store import Record

__all__ = ["EXPERIMENT", "limit"]

Array = npt.NDArray[np.float64]

#: Directions for each part.
_REPEATS = 8

#: Settings by name: what differs from the default hand, with steps of at max_distance 0.5 ms.
_HANDS = {
    "as it is": Hand(),
    "half the time step": Hand(step_s=0.5 * Hand().step_s),
    "twice the time step": Hand(step_s=2.0 * Hand().step_s),
    "half as compliant": Hand().times(0.5),
    "twice as compliant": Hand().times(2.0),
    "half the force stop": replace(Hand(), force_stop_n=0.5 * Hand().force_stop_n),
    "twice the force stop": replace(Hand(), force_stop_n=2.0 * Hand().force_stop_n),
}

#: A part stands off in all six directions, in proportion to these; the limit of geometry is within so many times that.
_TURN_RAD, _SHIFT_MM, _MAX_UNITS = 0.02, 0.5, 16.0
#: Limits of physics are looked for up to so many times that of geometry, by so many halvings.
_MOST, _HALVINGS = 8.0, 7
#: Where the parts are held behind their tips, and how far from the bottom a part still counts as in.
_HELD_MM, _IN_MM = 25.0, 0.5


def inputs() -> dict[str, str]:
    """The hands."""
    return {
        f"hand {name}": "\n".join(f"{k} = {v}" for k, v in vars(hand).items())
        for name, hand in _HANDS.items()
    }


def trials(repeats: int, seed: int) -> Sequence[Trial]:
    """Directions over the holes."""
    return [
        Trial({"part": letter, "pose": pose}, keyed_seed(seed, "physics", letter, pose))
        for letter in GRASPED
        for pose in range(1, repeats + 1)
    ]


def limit(goes_in: Callable[[float], bool], max_distance: float, halvings: int) -> float:
    """How far off something still goes in, by bisection to `max_distance` / 2^`halvings`: `max_distance` if it always does.

    What goes in farther out than where something else did not is not looked for.
    """
    if goes_in(max_distance):
        return max_distance
    low, high = 0.0, max_distance
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if goes_in(middle) else (low, middle)
    return low


def run(configuration: Configuration, seed: int) -> Record:
    """Find how far a part may stand off in one direction: ``geometry``, in units of `_TURN_RAD` and `_SHIFT_MM`, and by
    hand ``physics``, over that.

    ``depths_mm`` are those by hand at the limit of geometry: where it lets the part in, physics should too.
    """
    fit = fit_of(configuration["part"])
    random = np.random.default_rng(seed)
    twist = random.normal(size=6) * np.repeat([_TURN_RAD, _SHIFT_MM], 3)
    geometry = limit(lambda scale: fit.room_mm(_off(fit, scale * twist)) >= 0.0, _MAX_UNITS, 20)

    def depth_mm(hand: Hand, scale: float) -> float:
        return descend(fit.hole, fit.end, _off(fit, scale * geometry * twist), hand, _HELD_MM)

    def lands(hand: Hand) -> Callable[[float], bool]:
        return lambda scale: depth_mm(hand, scale) > fit.part.depth_mm - _IN_MM

    return {
        "geometry": geometry,
        "depths_mm": {name: round(depth_mm(hand, 1.0), 6) for name, hand in _HANDS.items()},
        "physics": {name: limit(lands(hand), _MOST, _HALVINGS) for name, hand in _HANDS.items()},
    }


def _off(fit: Fit, twist: Array) -> Array:
    """A pose off the ideal, about the middle of the hole: the part's origin is far from it."""
    about = np.eye(4)
    about[2, 3] = 0.5 * (fit.hole.tip_mm + fit.hole.mouth_mm)
    return np.asarray(about @ np.asarray(se3_exp(twist)) @ np.linalg.inv(about))


_ASKED = (
    "Does a part that geometry lets in go in with contact, friction and a hand that yields; what does the hand's "
    "compliance add; and do time step, compliance and force stop matter? Parts are lowered into their holes from ever "
    "farther off, in directions drawn by chance."
)
_CONDITIONS = (
    f"simulated (MuJoCo); directions drawn with standard deviations of {_TURN_RAD} rad and {_SHIFT_MM} mm; limits are "
    f"looked for up to {_MOST} times that of geometry, to {_MOST / 2**_HALVINGS}; a part is in from {_IN_MM} mm above "
    f"the bottom on; time step {1e3 * Hand().step_s} ms, force stop {Hand().force_stop_n} N, "
    f"{Hand().stiffness_n_per_mm} N/mm"
)


def report(trials: Sequence[Trial], records: Sequence[Record], given: Mapping[str, str]) -> Report:
    """Compare both verdicts."""
    of_parts: dict[str, list[Record]] = {}
    for trial, record in zip(trials, records, strict=True):
        of_parts.setdefault(trial.configuration["part"], []).append(record)
    rows = [
        [f"({letter}) {GRASPED[letter].name.replace('_', ' ')}", *_row(mine, letter)]
        for letter, mine in of_parts.items()
    ]
    head = [
        "part",
        "at the limit of geometry: in",
        "limit over that of geometry",
        *(f"{name}: limit changes by %" for name in list(_HANDS)[1:]),
    ]
    limits = Grid("Where parts stop going in: median over directions (least to largest)", head, rows)
    findings: list[Block] = [
        Heading("Geometry and physics"),
        Paragraph(
            "What geometry lets in should go in. How much farther off a part may stand is what chamfers and a hand "
            "that yields add, and geometry leaves out: its verdict is the stricter one where the ratio is above 1."
        ),
        limits,
        Figure("Limits by part, over those of geometry", _limits(of_parts), "svg"),
    ]
    return Report("Insertion by contact physics", _ASKED, _CONDITIONS, findings, given, [limits])


def _limits(of_parts: Mapping[str, Sequence[Record]]) -> bytes:
    """Box plots of every hand's limits."""
    panels = {
        hand: {letter: [record["physics"][hand] for record in mine] for letter, mine in of_parts.items()}
        for hand in _HANDS
    }
    return as_svg(box_plots(panels, across=4, x_label="part", y_label="limit over that of geometry"))


def _row(records: Sequence[Record], letter: str) -> list[str]:
    first, *others = _HANDS
    went = [record["depths_mm"][first] > GRASPED[letter].depth_mm - _IN_MM for record in records]
    ours = np.array([record["physics"][first] for record in records])
    cells = [f"{sum(went)} of {len(went)}", _spread(ours, ".2f")]
    for name in others:
        theirs = np.array([record["physics"][name] for record in records])
        cells.append(_spread(100.0 * (theirs / ours - 1.0), "+.1f"))
    return cells


def _spread(values: Array, form: str) -> str:
    return f"{np.median(values):{form}} ({values.min():{form}} to {values.max():{form}})"


EXPERIMENT = Experiment(
    name="insertion-physics",
    repeats=_REPEATS,
    inputs=inputs,
    trials=trials,
    run=run,
    report=lambda t, r: report(t, r, inputs()),
)
