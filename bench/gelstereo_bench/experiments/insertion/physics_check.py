"""Geometric verdicts against contact physics on a sample of poses, and the effect of time step, compliance
and force limit.

A trial is a direction of pose error over the hole. The largest error with a successful insertion is
determined by geometry, and by physics with every hand. These limits show small changes that a share of
verdicts would hide.
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

#: Settings by name: differences from the default hand, with steps of at most 0.5 ms.
_HANDS = {
    "as it is": Hand(),
    "half the time step": Hand(step_s=0.5 * Hand().step_s),
    "twice the time step": Hand(step_s=2.0 * Hand().step_s),
    "half as compliant": Hand().times(0.5),
    "twice as compliant": Hand().times(2.0),
    "half the force stop": replace(Hand(), force_stop_n=0.5 * Hand().force_stop_n),
    "twice the force stop": replace(Hand(), force_stop_n=2.0 * Hand().force_stop_n),
}

#: Units of rotation and translation of a pose error, and upper limit of the error in these units.
_TURN_RAD, _SHIFT_MM, _MAX_UNITS = 0.02, 0.5, 16.0
#: Upper limit of the search with physics, relative to geometry's limit, and number of bisections.
_MAX_RATIO, _HALVINGS = 8.0, 7
#: Distance from the tip to where parts are held, and largest distance from the bottom of an inserted part.
_HELD_MM, _IN_MM = 25.0, 0.5


def inputs() -> dict[str, str]:
    """The hands."""
    return {
        f"hand {name}": "\n".join(f"{k} = {v}" for k, v in vars(hand).items())
        for name, hand in _HANDS.items()
    }


def trials(repeats: int, seed: int) -> Sequence[Trial]:
    """One trial for each direction and hole."""
    return [
        Trial({"part": letter, "pose": pose}, keyed_seed(seed, "physics", letter, pose))
        for letter in GRASPED
        for pose in range(1, repeats + 1)
    ]


def limit(goes_in: Callable[[float], bool], max_distance: float, halvings: int) -> float:
    """Largest distance with success, by bisection to `max_distance` / 2^`halvings`; `max_distance` if it
    always succeeds.

    Success is assumed to be monotonic in the distance.
    """
    if goes_in(max_distance):
        return max_distance
    low, high = 0.0, max_distance
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if goes_in(middle) else (low, middle)
    return low


def run(configuration: Configuration, seed: int) -> Record:
    """Find the limits of the pose error in one direction: ``geometry``, in units of `_TURN_RAD` and
    `_SHIFT_MM`, and ``physics`` by hand, relative to that.

    ``depths_mm`` are the depths by hand at geometry's limit. Where geometry lets the part in, physics should
    too.
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
        "physics": {name: limit(lands(hand), _MAX_RATIO, _HALVINGS) for name, hand in _HANDS.items()},
    }


def _off(fit: Fit, twist: Array) -> Array:
    """A pose with an error about the middle of the hole, because the part's origin is far from it."""
    about = np.eye(4)
    about[2, 3] = 0.5 * (fit.hole.tip_mm + fit.hole.mouth_mm)
    return np.asarray(about @ np.asarray(se3_exp(twist)) @ np.linalg.inv(about))


_ASKED = (
    "Is a part that the geometric verdict accepts also inserted with contact, friction and a compliant hand? "
    "How much does the compliance add, and do time step, compliance and force stop matter? Parts are lowered "
    "into their holes with increasing offsets, in random directions."
)
_CONDITIONS = (
    f"simulated (MuJoCo); directions drawn with standard deviations of {_TURN_RAD} rad and {_SHIFT_MM} mm; "
    f"limits are searched up to {_MAX_RATIO} times the geometric limit, to within "
    f"{_MAX_RATIO / 2**_HALVINGS}; a part counts as inserted from {_IN_MM} mm above the bottom; time step "
    f"{1e3 * Hand().step_s} ms, force stop {Hand().force_stop_n} N, {Hand().stiffness_n_per_mm} N/mm"
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
        "inserted at the geometric limit",
        "limit over the geometric limit",
        *(f"{name}: change of the limit, %" for name in list(_HANDS)[1:]),
    ]
    limits = Grid("Limit of insertion: median over directions (least to largest)", head, rows)
    findings: list[Block] = [
        Heading("Geometry and physics"),
        Paragraph(
            "Parts that geometry accepts should be inserted. Chamfers and a compliant hand allow larger "
            "offsets, which geometry ignores. Its verdict is the stricter one if the ratio is above 1."
        ),
        limits,
        Figure("Limits by part, over the geometric limits", _limits(of_parts), "svg"),
    ]
    return Report("Insertion by contact physics", _ASKED, _CONDITIONS, findings, given, [limits])


def _limits(of_parts: Mapping[str, Sequence[Record]]) -> bytes:
    """Box plots of the limits by hand."""
    panels = {
        hand: {letter: [record["physics"][hand] for record in mine] for letter, mine in of_parts.items()}
        for hand in _HANDS
    }
    return as_svg(box_plots(panels, across=4, x_label="part", y_label="limit over the geometric limit"))


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
