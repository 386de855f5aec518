"""Points of the front: error, success and time of one method over scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gelstereo import Params
from gelstereo.tune.rungs import Rung
from gelstereo_bench.frontier.pipeline.cases import Case
from gelstereo_bench.frontier.pipeline.front import is_on_front
from gelstereo_bench.frontier.pipeline.intervals import Interval, bootstrap, wilson
from gelstereo_bench.frontier.pipeline.locators import Combination
from gelstereo_bench.frontier.pipeline.sensing import Record, is_lost
from gelstereo_bench.frontier.pipeline.sensors import PAPER, Family, Sensing, sensing_preset
from gelstereo_bench.frontier.registering import SUCCESS_MM

__all__ = ["Point", "Results", "depth_point", "f1", "front_of", "median_ms", "named_of", "pose_point"]

Array = npt.NDArray[np.float64]
#: By scene, a record by method for each seed.
Results = Mapping[str, list[Mapping[str, Record]]]

_BRIEF = (
    ("soft threshold", "soft"),
    ("whole images", "whole"),
    ("polynomial", "poly"),
    ("surface_search, budget ", "search "),
    ("surface_close", "close"),
    ("000000", "M"),
    ("0000", "0k"),
)
#: A point of the front is named if it is better by this share than the one named before it. Medians of pose
#: errors have intervals of 20 % and more.
_GAIN = 0.2
#: A time counts as equal above this share of another, and an error below this share.
_FASTER, _EQUAL = 0.9, 1.05


@dataclass(frozen=True)
class Point:
    """One method on one axis.

    Attributes
    ----------
    ms
        Time per frame: median in each scene, geometric mean over scenes.
    error
        Depth in um rms, geometric mean over scenes; or pose in mm, median over all runs.
    success
        Share of poses within 0.15 mm; None for depth.
    by_scene
        Error of each scene, and success for poses; NaN where the method lost the markers.
    """

    name: str
    label: str
    family: Family
    presets: tuple[str, ...]
    ms: float
    error: Interval
    success: Interval | None
    by_scene: Mapping[str, tuple[float, float]]

    @property
    def is_complete(self) -> bool:
        """Whether it worked in every scene."""
        return bool(np.all(np.isfinite([error for error, _ in self.by_scene.values()])))


def front_of(points: Sequence[Point]) -> list[bool]:
    """Whether each method is on the front of error and time; only methods that work in every scene can be."""
    errors = [point.error.value if point.is_complete else np.inf for point in points]
    return [bool(flag) for flag in is_on_front([point.ms for point in points], errors)]


def named_of(points: Sequence[Point]) -> list[Point]:
    """Points that table and picture name, by time.

    They are the presets, the paper's method, the other libraries, and points of the front that are at least
    20 % better than the one named before, unless a preset is equal to them within the chance of repeated
    runs.
    """
    presets = [point for point in points if point.presets]
    found, best = [], np.inf
    for point, is_front in sorted(zip(points, front_of(points), strict=True), key=lambda each: each[0].ms):
        is_equal = any(
            preset.ms < point.ms / _FASTER and preset.error.value < _EQUAL * point.error.value
            for preset in presets
        )
        is_step = is_front and not is_equal and point.error.value < (1.0 - _GAIN) * best
        if point.presets or is_step:
            best = min(best, point.error.value)
        if is_step or point.presets or point.family in ("paper", "peer"):
            found.append(point)
    return found


def _short(rungs: Sequence[Rung]) -> str:
    """Names of rungs as a label."""
    text = ", ".join(
        rung.name.replace(", ", " ") if rung.stage != "register" else rung.name for rung in rungs
    )
    for long, brief in _BRIEF:
        text = text.replace(long, brief)
    return text


def _geometric(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values)))) if len(values) else float("nan")


def median_ms(records: Sequence[Record]) -> float:
    """Median over frames of all seeds; NaN without frames."""
    taken = [ms for record in records for ms in record["ms"]]
    return float(np.median(taken)) if taken else float("nan")


# Depth


def depth_point(method: Sensing, cases: Sequence[Case], results: Results) -> Point:
    """Depth error of a method over scenes. Scenes where a run is lost do not count."""
    by_scene, groups, times = {}, [], []
    for case in cases:
        records = [block[method.name] for block in results[case.name]]
        times.append(median_ms(records))
        if any(is_lost(record) for record in records):
            by_scene[case.name] = (float("nan"), float("nan"))
            continue
        group = [np.array([record["squared_um2"], record["markers"]]) for record in records]
        groups.append(group)
        by_scene[case.name] = (_rms([group]), float("nan"))
    nothing = Interval(float("nan"), float("nan"), float("nan"))
    presets = sensing_preset(method)
    return Point(
        method.name,
        ", ".join(presets) or _short(method.rungs[:2]) or method.name,
        method.family,
        presets,
        _geometric([ms for ms in times if np.isfinite(ms)]),
        bootstrap(groups, _rms) if groups else nothing,
        None,
        by_scene,
    )


def _rms(groups: Sequence[Sequence[Array]]) -> float:
    """Root mean square of each scene; geometric mean over scenes."""
    sums = np.array([np.sum(group, axis=0) for group in groups])
    return _geometric(np.sqrt(sums[:, 0] / sums[:, 1]).tolist())


def f1(method: Sensing, case: Case, results: Results) -> float:
    """Harmonic mean of precision and recall of the markers in contact, over all frames of a scene."""
    counts = np.sum([block[method.name]["contact"] for block in results[case.name]], axis=0)
    return float(2.0 * counts[0] / (counts[1] + counts[2])) if counts[1] + counts[2] else float("nan")


# Poses


def pose_point(each: Combination, cases: Sequence[Case], sensing: Results, locating: Results) -> Point:
    """Pose error and success of a combination over scenes; a refusal counts as a failure."""
    by_scene, groups, times = {}, [], []
    for case in cases:
        records = [block[each.name] for block in locating[case.name]]
        group = [_errors_mm(record) for record in records]
        sense_ms = median_ms([block[each.sensing.name] for block in sensing[case.name]])
        times.append(sense_ms + median_ms(records))
        if not any(len(errors) for errors in group):
            continue  # the scene has no frame whose pose is judged
        groups.append(group)
        errors = np.concatenate(group)
        by_scene[case.name] = (float(np.median(errors)), float(np.mean(errors < SUCCESS_MM)))
    every = np.concatenate([errors for group in groups for errors in group])
    presets = _presets(each)
    rungs = (*each.sensing.rungs, *([each.rung] if each.rung else []))
    return Point(
        each.name,
        ", ".join(presets) or (_short(rungs) if each.rung else _plain(each)),
        each.sensing.family,
        presets,
        _geometric([ms for ms in times if np.isfinite(ms)]),
        bootstrap(groups, _median),
        wilson(int(np.sum(every < SUCCESS_MM)), len(every)),
        by_scene,
    )


def _errors_mm(record: Record) -> Array:
    return np.array([np.inf if error is None else error for error in record["error_mm"]])


def _median(groups: Sequence[Sequence[Array]]) -> float:
    return float(np.median(np.concatenate([errors for group in groups for errors in group])))


def _presets(each: Combination) -> tuple[str, ...]:
    """Presets that sense and register like this."""
    if each.params is None or each.sensing.name == PAPER:
        return ()
    own = each.params.to_toml()
    return tuple(name for name in sensing_preset(each.sensing) if Params.preset(name).to_toml() == own)


def _plain(each: Combination) -> str:
    """Label of the paper's method, or of another library behind OpenCV."""
    return PAPER if each.sensing.name == PAPER else f"OpenCV + {each.locator.split(':')[0]}"
