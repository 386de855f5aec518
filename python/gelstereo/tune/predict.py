"""Time and error of all settings, predicted from one measurement of each rung.

Times add over the stages. So do the squared depth errors that detection and triangulation add to those of the
base. Registration receives the points with their covariance: its squared error is that measured at the base,
of which a measured share scales with the squared depth error. Contact also hands on a patch, which no
covariance describes, so contact and registration are measured together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from gelstereo._native import Params
from gelstereo.tune.front import front
from gelstereo.tune.goal import Goal, Outcome
from gelstereo.tune.measure import Figures, outcome_of
from gelstereo.tune.rungs import RUNGS, Rung, rungs_of
from gelstereo.tune.setting import Setting

__all__ = [
    "base_settings",
    "nearest_to",
    "predicted_front",
    "reference_setting",
    "rungs_beside",
    "settings_to_measure",
]

#: Triangulation beside which each other rung is measured.
_POINTS = "rays"
#: Scatter of times, as a share of the time of sensing at the base. On `grasp_cylinder` (two seeds, seven
#: goals each), 0.13 to 0.5 give a mean regret of 0.7 to 0.9 %, and 0 gives 3.4 %: settings that are a little
#: faster than predicted then never become candidates.
_TIME_SCATTER = 0.15
#: The most accurate rungs.
_REFERENCE = ("fine fit, whole images", "rays, disc bias")


def base_settings(params: Params, register: bool) -> list[Setting]:
    """Settings of which one stage at a time is changed: the fastest detection that can sense is the base.

    Beside a fast base, small times do not drown in the scatter of a large one. Contact is found as `params`
    state, and registration has the largest budget.
    """
    return [_setting(rung.name, _POINTS, params, register) for rung in rungs_of("detect")]


def reference_setting(params: Params, register: bool) -> Setting:
    """The most accurate setting; contact is found as `params` state, as no rule is the best for every gel."""
    return _setting(*_REFERENCE, params, register)


def _setting(detect: str, points: str, params: Params, register: bool) -> Setting:
    names = {"detect": detect, "points": points, "contact": params.to_dict()["contact"]["saliency"]}
    rungs = [next(rung for rung in RUNGS if (rung.stage, rung.name) == item) for item in names.items()]
    return Setting.of([*rungs, *rungs_of("register")[-1:]] if register else rungs)


def settings_to_measure(base: Setting) -> list[Setting]:
    """Every rung once: detection and triangulation beside the base, contact together with registration.

    With registration, the base is also registered from other centres, for the share of the pose error that
    follows the points.
    """
    sensing = base.sensing
    found = [Setting(rung, sensing.points, sensing.contact) for rung in rungs_of("detect")]
    found += [Setting(sensing.detect, rung, sensing.contact) for rung in rungs_of("points")]
    if base.register is not None:
        found += [
            Setting(sensing.detect, sensing.points, contact, rung)
            for contact in rungs_of("contact")
            for rung in rungs_of("register")
        ]
        found.append(_other_centres(base))
    return list(dict.fromkeys(found))


def rungs_beside(base: Setting, setting: Setting) -> list[Setting]:
    """Those of `settings_to_measure` from which a setting is predicted."""
    sensing = base.sensing
    found = [
        Setting(setting.detect, sensing.points, sensing.contact),
        Setting(sensing.detect, setting.points, sensing.contact),
    ]
    if setting.register is not None:
        found.append(Setting(sensing.detect, sensing.points, setting.contact, setting.register))
    return found


def _other_centres(base: Setting) -> Setting:
    """The base with the centres of the next more accurate kind."""
    kinds = rungs_of("detect")
    centre = base.detect.settings["detect.centre"]
    other = next((rung for rung in kinds if rung.settings["detect.centre"] != centre), kinds[-1])
    return Setting(other, base.points, base.contact, base.register)


@dataclass(frozen=True)
class _Estimate:
    """Sums over the stages so far; `pose_um2` and `failure` from registration on."""

    time_ms: float
    height_um2: float
    pose_um2: float | None = None
    failure: float | None = None

    def measures(self) -> tuple[float, ...]:
        found = (self.time_ms, self.height_um2)
        return (
            found if self.pose_um2 is None or self.failure is None else (*found, self.pose_um2, self.failure)
        )

    def outcome(self) -> Outcome:
        height_um = math.sqrt(self.height_um2)
        if self.pose_um2 is None or self.failure is None:
            return Outcome(self.time_ms, height_um)
        return Outcome(self.time_ms, height_um, math.sqrt(self.pose_um2), 1.0 - self.failure)


class _Predictor:
    """Effects of rungs, from the figures of `settings_to_measure`."""

    def __init__(self, figures: Mapping[Setting, Sequence[Figures]], base: Setting) -> None:
        self._base, self._register = base, base.register is not None
        self._outcomes = {setting: outcome_of(each) for setting, each in figures.items()}
        self._sensing = self._outcomes[self._base.sensing]
        self._share = self._pose_share(figures) if self._register else 0.0

    def _pose_share(self, figures: Mapping[Setting, Sequence[Figures]]) -> float:
        """Share of the squared pose error that scales with the squared depth error of the points."""
        pair = [figures[setting] for setting in (self._base, _other_centres(self._base))]
        # Of the same takes.
        takes = min(map(len, pair))
        base, other = (outcome_of(each[:takes]) for each in pair)
        more = (other.height_um / base.height_um) ** 2 - 1.0
        if not (math.isfinite(more) and abs(more) > 0.0 and base.error_um > 0.0):
            return 1.0
        return min(max(((other.error_um / base.error_um) ** 2 - 1.0) / more, 0.0), 1.0)

    def start(self) -> _Estimate:
        return _Estimate(self._sensing.time_ms, self._sensing.height_um**2)

    def stages(self) -> list[list[tuple[Rung, ...]]]:
        """Options of each independent stage."""
        alone: dict[str, list[tuple[Rung, ...]]] = {
            "detect": [(rung,) for rung in rungs_of("detect")],
            "points": [(rung,) for rung in rungs_of("points")],
        }
        last: list[tuple[Rung, ...]] = [(self._base.contact,)]
        if self._register:
            last = list(product(rungs_of("contact"), rungs_of("register")))
        return [alone["detect"], alone["points"], last]

    def add(self, state: _Estimate, option: tuple[Rung, ...]) -> _Estimate:
        base = self._base.sensing
        if option[0].stage == "detect":
            return self._sensed(state, Setting(option[0], base.points, base.contact))
        if option[0].stage == "points":
            return self._sensed(state, Setting(base.detect, option[0], base.contact))
        if len(option) == 1:
            return state
        found = self._outcomes[Setting(base.detect, base.points, *option)]
        more = state.height_um2 / self._sensing.height_um**2 - 1.0
        pose_um2 = found.error_um**2 * max(1.0 + self._share * more, 0.0)
        time_ms = state.time_ms + found.time_ms - self._sensing.time_ms
        return _Estimate(time_ms, state.height_um2, pose_um2, 1.0 - (found.success or 0.0))

    def _sensed(self, state: _Estimate, setting: Setting) -> _Estimate:
        found = self._outcomes[setting]
        return _Estimate(
            state.time_ms + found.time_ms - self._sensing.time_ms,
            max(state.height_um2 + found.height_um**2 - self._sensing.height_um**2, 0.0),
        )


def predicted_front(
    figures: Mapping[Setting, Sequence[Figures]], base: Setting
) -> list[tuple[Setting, Outcome]]:
    """Settings that no other setting is predicted to dominate, the fastest first.

    Times that differ by less than they scatter count as equal.

    Parameters
    ----------
    figures
        Of all `settings_to_measure`.
    base
        The setting beside which the rungs were measured.
    """
    predictor = _Predictor(figures, base)
    start = predictor.start()
    margin_ms = _TIME_SCATTER * start.time_ms
    paths = front(predictor.stages(), start, predictor.add, _Estimate.measures, margin_ms)
    return [
        (Setting.of(rung for option in options for rung in option), estimate.outcome())
        for options, estimate in paths
    ]


def nearest_to(goal: Goal, points: Sequence[tuple[Setting, Outcome]], count: int) -> list[Setting]:
    """Settings nearest to the goal, from both sides of its limits in turn, as predictions are not exact."""
    ranked = sorted(points, key=lambda point: goal.rank(point[1]))
    inside = [setting for setting, outcome in ranked if goal.excess(outcome) <= 0.0]
    outside = [setting for setting, outcome in ranked if goal.excess(outcome) > 0.0]
    shared = [setting for pair in zip(inside, outside, strict=False) for setting in pair]
    return (shared + inside[len(outside) :] + outside[len(inside) :])[:count]
