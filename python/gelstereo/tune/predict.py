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
from gelstereo.tune.goal import Goal, Outcome, TuneError
from gelstereo.tune.measure import Figures, outcome_of
from gelstereo.tune.rungs import Rung, rungs_of
from gelstereo.tune.setting import Setting

__all__ = ["base_setting", "nearest_to", "predicted_front", "reference_setting", "settings_to_measure"]

#: Rungs that each other one is measured beside.
_BASE = {"detect": "fit, windows", "points": "rays"}
#: The most accurate rungs.
_REFERENCE = {"detect": "fine fit, whole images", "points": "rays, disc bias"}


def base_setting(params: Params, register: bool) -> Setting:
    """The setting of which one stage at a time is changed; contact is found as `params` state."""
    return _setting(_BASE, params, register)


def reference_setting(params: Params, register: bool) -> Setting:
    """The most accurate setting; contact is found as `params` state, as no rule is the best for every gel."""
    return _setting(_REFERENCE, params, register)


def _setting(names: Mapping[str, str], params: Params, register: bool) -> Setting:
    """Rungs by name; registration with the largest budget."""
    names = {**names, "contact": params.to_dict()["contact"]["saliency"]}
    detect, points, contact = (
        next(rung for rung in rungs_of(stage) if rung.name == names[stage])
        for stage in ("detect", "points", "contact")
    )
    return Setting(detect, points, contact, rungs_of("register")[-1] if register else None)


def settings_to_measure(base: Setting) -> list[Setting]:
    """Every rung once: detection and triangulation beside the base, contact together with registration.

    With registration, the base is also registered from the noisiest centres, for the share of the pose error
    that follows the points.
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
        found.append(_noisy(base))
    return list(dict.fromkeys(found))


def _noisy(base: Setting) -> Setting:
    return Setting(rungs_of("detect")[0], base.points, base.contact, base.register)


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
        if not math.isfinite(self._sensing.height_um):
            raise TuneError(
                "the frames cannot be sensed with the usual settings; `gelstereo inspect` states what an "
                "image shows, and `gelstereo setup` finds settings for it"
            )
        self._share = self._pose_share() if self._register else 0.0

    def _pose_share(self) -> float:
        """Share of the squared pose error that scales with the squared depth error of the points."""
        quiet, noisy = self._outcomes[self._base], self._outcomes[_noisy(self._base)]
        more = (noisy.height_um / quiet.height_um) ** 2 - 1.0
        if not (more > 0.0 and math.isfinite(more) and quiet.error_um > 0.0):
            return 1.0
        return min(max(((noisy.error_um / quiet.error_um) ** 2 - 1.0) / more, 0.0), 1.0)

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

    Parameters
    ----------
    figures
        Of all `settings_to_measure`.
    base
        The setting beside which the rungs were measured.

    Raises
    ------
    TuneError
        The base could not sense the frames.
    """
    predictor = _Predictor(figures, base)
    paths = front(predictor.stages(), predictor.start(), predictor.add, _Estimate.measures)
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
    rest = (inside[len(outside) :], outside[len(inside) :])
    return (shared + rest[0] + rest[1])[:count]
