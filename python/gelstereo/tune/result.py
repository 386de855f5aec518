"""The result of tuning, and its file."""

from __future__ import annotations

from dataclasses import dataclass

from gelstereo._native import Params
from gelstereo.tune.cache import Conditions
from gelstereo.tune.goal import Goal, Outcome
from gelstereo.tune.intervals import Interval, of_share, of_take
from gelstereo.tune.measure import Figures, outcome_of
from gelstereo.tune.setting import Setting

__all__ = ["ERROR_RATIO", "TIME_RATIO", "Check", "Tuned"]

#: By what factors held-out frames may differ: in time, and in error.
TIME_RATIO, ERROR_RATIO = 1.2, 1.5


@dataclass(frozen=True)
class Check:
    """A figure that tuning expects, beside that of frames which it did not see.

    Attributes
    ----------
    name, unit : str
    expected : float
    interval : Interval
        Where one more take lies in 95 of 100 cases; of a success, where the rate lies.
    held_out : float
    is_confirmed : bool
        Whether the held-out time is within 20 %, the error within a factor of 1.5, and the success not
        significantly below what is expected.
    """

    name: str
    unit: str
    expected: float
    interval: Interval
    held_out: float
    is_confirmed: bool

    def __str__(self) -> str:
        text = f"{self.name:<13}{self.expected:8.4g} {self.unit:<3}"
        text += f"({self.interval.low:.4g} to {self.interval.high:.4g}), held out {self.held_out:.4g}"
        return text if self.is_confirmed else f"{text}: NOT CONFIRMED"


@dataclass(frozen=True)
class Tuned:
    """Settings for a goal, and what they do.

    Attributes
    ----------
    goal : Goal
    setting : Setting
        The chosen rungs.
    params : Params
        The settings.
    figures, held_out : tuple of Figures
        Of each take that was tuned on, and of each that was not.
    front : tuple of (Setting, Outcome)
        Predicted: settings that no other one dominates.
    is_simulated : bool
        Whether errors are against the truth. Otherwise they are what covariances, the scatter between frames
        and the distance from the best answer state.
    """

    goal: Goal
    setting: Setting
    params: Params
    figures: tuple[Figures, ...]
    held_out: tuple[Figures, ...]
    front: tuple[tuple[Setting, Outcome], ...]
    is_simulated: bool

    @property
    def outcome(self) -> Outcome:
        """Time and error on the takes that were tuned on."""
        return outcome_of(self.figures)

    @property
    def is_reached(self) -> bool:
        """Whether the outcome keeps the goal's limits."""
        return self.goal.excess(self.outcome) <= 0.0

    @property
    def is_confirmed(self) -> bool:
        """Whether held-out frames confirm every figure."""
        return all(check.is_confirmed for check in self.checks())

    def checks(self) -> list[Check]:
        """What is expected, how far it may be off, and what held-out frames show."""
        expected, held_out = self.outcome, outcome_of(self.held_out)
        takes = [outcome_of([each]) for each in self.figures]
        times = of_take([take.time_ms for take in takes])
        heights = of_take([take.height_um for take in takes])
        found = [
            _check("time", "ms", expected.time_ms, times, held_out.time_ms, TIME_RATIO),
            _check("height error", "um", expected.height_um, heights, held_out.height_um, ERROR_RATIO),
        ]
        if expected.pose_um is None or held_out.pose_um is None:
            return found
        poses = of_take([take.pose_um for take in takes if take.pose_um is not None])
        found.append(_check("pose error", "um", expected.pose_um, poses, held_out.pose_um, ERROR_RATIO))
        return [*found, self._success()]

    def _success(self) -> Check:
        successes, trials = _counted(self.figures)
        passed, tried = _counted(self.held_out)
        rate, held_out = of_share(successes, trials), of_share(passed, tried)
        percent = Interval(100.0 * rate.low, 100.0 * rate.high)
        shares = (100.0 * successes / trials, 100.0 * passed / tried)
        return Check("success", "%", shares[0], percent, shares[1], held_out.high >= rate.low)

    def __str__(self) -> str:
        lines = [f"{rung.stage:<13}{rung.name}" for rung in self.setting.rungs]
        lines += [str(check) for check in self.checks()]
        if not self.is_reached:
            lines.append(f"no setting was found for {self.goal}; this one is nearest:")
            lines += self.goal.misses(self.outcome)
        if not self.is_confirmed:
            lines.append("held-out frames do not confirm this; measure more takes, on a machine at rest")
        return "\n".join(lines)

    def to_toml(self, conditions: Conditions) -> str:
        """Text of a settings file for `Params.load`, with what is expected in comments.

        Parameters
        ----------
        conditions
            Machine, image size, print and version of the measurements.
        """
        source = "against the simulator's truth"
        if not self.is_simulated:
            source = "as covariances, the scatter between frames and the distance from the best answer state"
        head = ["Written by `gelstereo tune`.", f"goal: {self.goal}", *str(self).splitlines()]
        head += [f"errors: {source}", f"takes: {len(self.figures)} to tune on, {len(self.held_out)} held out"]
        head.append("in brackets: where one more take, or the success rate, lies in 95 of 100 cases")
        head.append(
            f"machine: {conditions.processor}, {conditions.cores} cores; images {conditions.image_size}; "
            f"markers {conditions.markers}; gelstereo {conditions.version}"
        )
        return "\n".join([*(f"# {line}" for line in head), "", self.params.to_toml()])


def _check(name: str, unit: str, expected: float, interval: Interval, held_out: float, ratio: float) -> Check:
    near = expected / ratio <= held_out <= expected * ratio
    return Check(name, unit, expected, interval, held_out, near)


def _counted(figures: tuple[Figures, ...]) -> tuple[int, int]:
    return sum(each.successes for each in figures), sum(each.trials for each in figures)
