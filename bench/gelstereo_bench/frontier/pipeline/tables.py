"""Tables of the front, one for each kind of images and kind of error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gelstereo_bench.frontier.pipeline.cases import Case, Origin
from gelstereo_bench.frontier.pipeline.front import is_near_front
from gelstereo_bench.frontier.pipeline.intervals import Interval
from gelstereo_bench.frontier.pipeline.sensors import sensing_preset
from gelstereo_bench.frontier.pipeline.study import Study
from gelstereo_bench.frontier.pipeline.summary import (
    Point,
    depth_point,
    f1,
    front_of,
    median_ms,
    named_of,
    pose_point,
)
from gelstereo_bench.frontier.table import Table, figure

__all__ = ["ORIGINS", "PIPELINE_SECTIONS", "Points", "front_tables", "points_of"]

ORIGINS: tuple[Origin, ...] = ("simulated", "path-traced")
#: Points by kind of images.
Points = Mapping[Origin, Sequence[Point]]

#: Markers of docs/accuracy-vs-time.md that this topic fills.
PIPELINE_SECTIONS = (
    "front-conditions",
    "front-presets",
    "front-depth-simulated",
    "front-depth-path-traced",
    "front-pose-simulated",
    "front-pose-path-traced",
    "front-contact",
    "front-budgets",
)
#: The contact rung of all presets but the paper's; depth does not depend on it.
_CONTACT = "adaptive"
#: An error counts as equal within the chance of repeated runs, and so does a time.
_EQUAL, _FASTER = 1.02, 0.9


def points_of(study: Study) -> tuple[Points, Points]:
    """Points of depth and of poses, by kind of images."""
    depth, poses = {}, {}
    for origin in ORIGINS:
        cases = [case for case in study.cases if case.origin == origin]
        depth[origin] = [
            depth_point(method, cases, study.sensing)
            for method in study.methods
            if not method.rungs or method.rungs[2].name == _CONTACT
        ]
        poses[origin] = [
            pose_point(each, cases, study.sensing, study.locating) for each in study.combinations
        ]
    return depth, poses


def front_tables(study: Study, depth: Points, poses: Points) -> list[Table]:
    """All tables but that of budgets."""
    tables = [_presets_table(depth, poses), _contact_table(study)]
    for origin in ORIGINS:
        cases = [case for case in study.cases if case.origin == origin]
        tables.append(_depth_table(origin, cases, depth[origin], study))
        tables.append(_pose_table(origin, poses[origin], study.missing))
    return tables


def _listed(points: Sequence[Point]) -> list[tuple[Point, bool]]:
    """Points that a table lists, and whether each is on the front."""
    fronts = {point.name for point, is_front in zip(points, front_of(points), strict=True) if is_front}
    return [(point, point.name in fronts) for point in named_of(points)]


def _name(point: Point, is_on_front: bool) -> str:
    if not np.isfinite(point.error.value):
        return f"{point.name} (refuses every scene)"
    presets = f"**preset {', '.join(point.presets)}**: " if point.presets else ""
    name = "preset paper" if point.family == "paper" else point.name
    return f"{presets}{name}" + (" (front)" if is_on_front else "")


def _with_interval(error: Interval, unit: float) -> str:
    """A value with its interval, multiplied by `unit`; a dash without a value."""
    if not np.isfinite(error.value):
        return "-"
    return f"{figure(unit * error.value)} ({figure(unit * error.low)} to {figure(unit * error.high)})"


def _depth_table(origin: Origin, cases: Sequence[Case], points: Sequence[Point], study: Study) -> Table:
    methods = {method.name: method for method in study.methods}
    rows = []
    for point, flag in _listed(points):
        scores = [f1(methods[point.name], case, study.sensing) for case in cases]
        known = [score for score in scores if np.isfinite(score)]
        rows.append(
            [
                _name(point, flag),
                figure(point.ms),
                _with_interval(point.error, 1.0),
                *(figure(point.by_scene[case.name][0]) for case in cases),
                f"{np.mean(known):.2f}" if known else "-",
            ]
        )
    head = ["method", "ms", "all scenes, um (95 %)", *(case.name for case in cases), "contact, F1"]
    return Table(f"front-depth-{origin}", head, rows)


def _pose_table(origin: Origin, points: Sequence[Point], missing: Mapping[str, str]) -> Table:
    scenes = list(points[0].by_scene) if points else []
    rows = []
    for point, flag in _listed(points):
        assert point.success is not None
        rate = point.success
        cells = []
        for scene in scenes:
            error_mm, share = point.by_scene[scene]
            cells.append(f"{figure(1e3 * error_mm)}, {100 * share:.0f}")
        rows.append(
            [
                _name(point, flag),
                figure(point.ms),
                _with_interval(point.error, 1e3),
                f"{100 * rate.value:.0f} ({100 * rate.low:.0f} to {100 * rate.high:.0f})",
                *cells,
            ]
        )
    # A table's cell must be one line without vertical bars.
    dashes = ["-"] * (len(scenes) + 3)
    rows += [
        [f"{name} ({' '.join(why.replace('|', '/').split())})", *dashes] for name, why in missing.items()
    ]
    head = ["method", "ms", "all scenes, um (95 %)", "success, % (95 %)", *scenes]
    return Table(f"front-pose-{origin}", head, rows)


def _contact_table(study: Study) -> Table:
    """Contacts found and time of the contact rungs, behind the centres and points of preset balanced."""
    usual = next(each for each in study.methods if "balanced" in sensing_preset(each))
    rows = []
    for method in study.methods:
        if not method.rungs or method.rungs[:2] != usual.rungs[:2]:
            continue
        row = [method.rungs[2].name]
        for origin in ORIGINS:
            cases = [case for case in study.cases if case.origin == origin]
            scores = [f1(method, case, study.sensing) for case in cases]
            records = [block[method.name] for case in cases for block in study.sensing[case.name]]
            row += [f"{np.nanmean(scores):.3f}", figure(median_ms(records))]
        rows.append(row)
    head = ["contact"]
    for origin in ORIGINS:
        head += [f"F1, {origin}", "median ms of a frame"]
    return Table("front-contact", head, rows)


def _presets_table(depth: Points, poses: Points) -> Table:
    """For each preset: what is as accurate and takes less time."""
    rows = []
    for title, groups in (("depth", depth), ("pose", poses)):
        for origin, points in groups.items():
            for point, said in zip(points, _on_front(points), strict=True):
                if not (point.presets or point.family == "paper"):
                    continue
                name = ", ".join(point.presets) or "paper"
                rows.append([name, f"{title}, {origin}", said, *_rival(point, points)])
    head = ["preset", "error", "on the front", "as accurate in less time", "time, share of the preset's"]
    return Table("front-presets", head, sorted(rows, key=lambda row: (row[0], row[1])))


def _on_front(points: Sequence[Point]) -> list[str]:
    """Whether each method is on the front, up to the chance of repeated runs."""
    errors = [point.error.value if point.is_complete else np.inf for point in points]
    near = is_near_front([point.ms for point in points], errors, gain=1.0 - _FASTER, tolerance=_EQUAL - 1.0)
    return [
        "yes" if is_near else "by chance" if is_on else "no"
        for is_near, is_on in zip(near, front_of(points), strict=True)
    ]


def _rival(point: Point, points: Sequence[Point]) -> tuple[str, str]:
    """The fastest method that is as accurate and as successful."""

    def is_as_good(other: Point) -> bool:
        if not other.is_complete or not other.error.value <= _EQUAL * point.error.value:
            return False
        if point.success is None or other.success is None:
            return True
        return other.success.value >= point.success.value

    rivals = [other for other in points if other.ms < _FASTER * point.ms and is_as_good(other)]
    if not rivals:
        return "none", "-"
    best = min(rivals, key=lambda other: other.ms)
    return _name(best, False), f"{best.ms / point.ms:.2f}"
