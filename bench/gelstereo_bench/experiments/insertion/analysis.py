"""Analysis of many grasps: success with its interval, ranges, calibration, effect of robot errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo_bench.experiments.batch import Trial
from gelstereo_bench.experiments.insertion.grasp import Fit
from gelstereo_bench.experiments.insertion.looks import MIN_CHANCE, Regrasp
from gelstereo_bench.experiments.insertion.robot import RobotErrors, over_hole
from gelstereo_bench.experiments.store import Record

__all__ = [
    "MIN_CHANCE",
    "Verdict",
    "allowed",
    "break_even",
    "calibration",
    "cause",
    "expected",
    "share_with",
    "verdicts",
    "wilson",
]

Array = npt.NDArray[np.float64]

#: Results that the paper reports over all its trials (section VI-B).
PAPER_SHARE = 0.8571

_ROBOTS = 8
_MIN_GRASPS = 5


@dataclass(frozen=True)
class Verdict:
    """Result of one method on one look at a grasped part."""

    part: str
    method: str
    hold: dict[str, float]
    truth: Array
    refused: str | None
    found: Array
    taught: tuple[Array, Array]
    room_mm: float
    #: Predicted chance of insertion; 0 for a method without prediction.
    chance: float
    #: Directions that the contact's faces do not determine and that matter for the insertion.
    matters: tuple[str, ...]
    #: The least certain direction that matters.
    weakest: str
    #: Later looks of the same method; and the regrasp that led to this one, except for the first.
    further: tuple[Verdict, ...] = ()
    regrasp: Regrasp | None = None

    @property
    def last(self) -> Verdict:
        """The look used for the insertion."""
        return self.further[-1] if self.further else self

    @property
    def inserted(self) -> bool:
        """Whether the part goes in, with a robot that moves exactly."""
        return self.room_mm >= 0.0

    @property
    def go(self) -> bool:
        """Whether the robot attempts the insertion."""
        return self.chance >= MIN_CHANCE

    def placed(self, mount: Array | None = None, motion: Array | None = None) -> Array:
        """Pose of the part in the hole's frame. Errors as in `over_hole`; the mount's error rotates about the
        part.
        """
        return over_hole(self.truth, self.found, self.taught, mount, motion, self.truth[:3, 3])


def verdicts(trials: Sequence[Trial], records: Sequence[Record]) -> list[Verdict]:
    """Read the records."""
    return [
        _verdict(trial.configuration["part"], name, record, result)
        for trial, record in zip(trials, records, strict=True)
        for name, result in record["methods"].items()
    ]


def _verdict(part: str, method: str, record: Record, result: dict[str, Any]) -> Verdict:
    truth = np.array(record["t_sensor_object"])
    refused = result.get("refused")
    if refused is not None:
        nothing = np.eye(4)
        return Verdict(
            part, method, record["hold"], truth, refused, nothing, (nothing, nothing), -np.inf, 0.0, (), ""
        )
    taught = np.array(result["taught"][0]), np.array(result["taught"][1])
    found = np.array(result["t_sensor_object"])
    room, chance, matters = result["room_mm"], result.get("chance", 0.0), tuple(result["matters"])
    weakest = result["weakest"]
    first = Verdict(part, method, record["hold"], truth, None, found, taught, room, chance, matters, weakest)
    return replace(first, further=tuple(_further(first, look) for look in result.get("looks", ())))


def _further(first: Verdict, look: dict[str, Any]) -> Verdict:
    """Read a look after the first one."""
    return replace(
        first,
        truth=np.array(look["truth"]),
        found=np.array(look["t_sensor_object"]),
        room_mm=look["room_mm"],
        chance=look["chance"],
        matters=(),
        weakest=look["weakest"],
        regrasp=Regrasp(**look["regrasp"]),
    )


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a proportion, 0 to 1 (Wilson 1927)."""
    if trials == 0:
        return 0.0, 1.0
    z, share = 1.959964, successes / trials
    middle = share + z * z / (2.0 * trials)
    half = z * np.sqrt(share * (1.0 - share) / trials + z * z / (4.0 * trials * trials))
    scale = 1.0 + z * z / trials
    # Round-off can exceed 0 and 1.
    return max(float((middle - half) / scale), 0.0), min(float((middle + half) / scale), 1.0)


def allowed(chosen: Sequence[Verdict], angle: str, share: float = 1.0) -> float | None:
    """Largest angle (a key of `Verdict.hold`) up to which at least this share of grasps goes in, rad, or
    None.

    An angle counts only if at least `_MIN_GRASPS` grasps do not exceed it.
    """
    order = sorted(chosen, key=lambda verdict: abs(verdict.hold[angle]))
    best, inserted = None, 0
    for count, verdict in enumerate(order, start=1):
        inserted += verdict.inserted
        if verdict.inserted and count >= _MIN_GRASPS and inserted >= share * count:
            best = abs(verdict.hold[angle])
    return best


def calibration(chosen: Sequence[Verdict], bins: int = 10) -> list[tuple[float, int, int]]:
    """Predicted chance against outcome: mean chance, grasps and insertions of every bin with grasps."""
    return [
        (float(np.mean([v.chance for v in within])), len(within), sum(v.inserted for v in within))
        for within in _bins(chosen, bins)
    ]


def expected(chosen: Sequence[Verdict], bins: int = 10) -> list[tuple[int, int]]:
    """Central 95 % interval of the insertions in each bin, if the predicted chances are right."""
    return [_poisson_binomial([v.chance for v in within]) for within in _bins(chosen, bins)]


def _bins(chosen: Sequence[Verdict], bins: int) -> list[list[Verdict]]:
    judged = [v for v in chosen if v.refused is None]
    every = [[v for v in judged if min(int(v.chance * bins), bins - 1) == index] for index in range(bins)]
    return [within for within in every if within]


def _poisson_binomial(chances: Sequence[float]) -> tuple[int, int]:
    """Central 95 % interval of the number of successes."""
    law = np.ones(1)
    for chance in chances:
        law = np.convolve(law, [1.0 - chance, chance])
    below = np.cumsum(law)
    return int(np.searchsorted(below, 0.025)), int(np.searchsorted(below, 0.975))


def share_with(chosen: Sequence[Verdict], fits: dict[str, Fit], errors: RobotErrors) -> float:
    """Share of grasps that go in, over several robots with these errors."""
    inserted = [
        fits[verdict.part].room_mm(verdict.placed(*errors.draw(robot, number))) >= 0.0
        for robot in range(_ROBOTS)
        for number, verdict in enumerate(chosen)
    ]
    return float(np.mean(inserted))


def break_even(
    share_at: Callable[[float], float], max_scale: float, goal: float = PAPER_SHARE
) -> float | None:
    """Scale of the errors at which the share falls to `goal`, by bisection; None if it does not."""
    if share_at(0.0) < goal or share_at(max_scale) > goal:
        return None
    low, high = 0.0, max_scale
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if share_at(middle) >= goal else (low, middle)
    return 0.5 * (low + high)


def cause(fit: Fit, placed: Array) -> str:
    """Reason why a part does not go in: the component of its pose error that suffices by itself, and its
    size.
    """
    axis = placed[:3, 2]
    tilt_deg = float(np.rad2deg(np.arctan2(np.hypot(axis[0], axis[1]), axis[2])))
    turn_deg = float(np.rad2deg(np.arctan2(placed[1, 0] - placed[0, 1], placed[0, 0] + placed[1, 1])))
    # Distance from the hole's axis at the middle of the hole.
    middle_mm = 0.5 * (fit.hole.tip_mm + fit.hole.mouth_mm)
    off = (placed[:3, 3] + placed[:3, :3] @ [0.0, 0.0, middle_mm])[:2]
    moved, turned, leaning = np.eye(4), np.eye(4), np.array(placed)
    moved[:2, 3] = off
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    turned[:2, :2] = [[c, -s], [s, c]]
    leaning[:2, 3] -= off
    leaning[:3, :3] = leaning[:3, :3] @ turned[:3, :3].T
    words = {
        f"beside the hole by {np.hypot(*off):.2f} mm": fit.room_mm(moved),
        f"turned by {turn_deg:.1f} deg": fit.room_mm(turned),
        f"leaning by {tilt_deg:.1f} deg": fit.room_mm(leaning),
    }
    enough = [word for word, room_mm in words.items() if room_mm < 0.0]
    return ", ".join(enough) if enough else "a little of everything: " + ", ".join(words)
