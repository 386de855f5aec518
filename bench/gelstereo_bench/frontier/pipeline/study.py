"""The measurements of the front: sensing in every scene first, then registration behind what is worth it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gelstereo.progress import Progress
from gelstereo_bench.frontier.pipeline.cases import Case, Origin, Take
from gelstereo_bench.frontier.pipeline.front import is_near_front
from gelstereo_bench.frontier.pipeline.kept import Kept, Stage, code_digest, key_of
from gelstereo_bench.frontier.pipeline.locating import measure_locating
from gelstereo_bench.frontier.pipeline.locators import Combination, combined
from gelstereo_bench.frontier.pipeline.sensing import Record, measure_sensing
from gelstereo_bench.frontier.pipeline.sensors import Sensing, sensing_preset
from gelstereo_bench.frontier.pipeline.summary import Results, depth_point

__all__ = ["Extent", "Study", "measure"]


@dataclass(frozen=True)
class Extent:
    """How much is measured.

    Attributes
    ----------
    every
        One in so many path-traced scenes, and kinds of contact for budgets, is used.
    seeds, traced_seeds
        Runs of every simulated scene, and noises of every path-traced one.
    starts
        Guesses for every judged frame.
    budget_seeds, law_seeds
        Contacts for every part and noise, and for every part and law, on which budgets are compared.
    """

    every: int
    seeds: int
    traced_seeds: int
    starts: int
    budget_seeds: int
    law_seeds: int

    def of(self, origin: Origin) -> range:
        """Seeds of a scene."""
        return range(1, 1 + (self.seeds if origin == "simulated" else self.traced_seeds))


@dataclass
class Study:
    """All results."""

    cases: Sequence[Case]
    methods: Sequence[Sensing]
    combinations: Sequence[Combination]
    #: Libraries that cannot be loaded, with the reason.
    missing: Mapping[str, str]
    #: By scene, a record by method for each seed.
    sensing: Results = field(default_factory=lambda: defaultdict(list))
    locating: Results = field(default_factory=lambda: defaultdict(list))


def measure(kept: Kept, cases: Sequence[Case], methods: Sequence[Sensing], extent: Extent) -> Study:
    """Measure what is not kept yet.

    Registration runs only behind combinations of sensing rungs that are near the front of depth error and
    time, in the simulator or on path-traced images, among those with the same contact rung; behind the
    presets; and behind the paper's sensing and OpenCV's. The others have the same depth at a higher price.
    """
    study = Study(cases, methods, [], {})
    study.sensing = _blocks(
        kept,
        "sensing",
        cases,
        extent,
        {method.name: _digest(method.params) for method in methods},
        lambda take, seed: measure_sensing(take, methods, seed),
    )
    study.combinations, study.missing = combined(_worth(study))
    study.locating = _blocks(
        kept,
        "locating",
        cases,
        extent,
        {each.name: _digest(each.params) for each in study.combinations},
        lambda take, seed: measure_locating(take, study.combinations, seed, extent.starts),
    )
    return study


def _digest(params: Any) -> str:
    return "" if params is None else key_of({"toml": params.to_toml()})


def _blocks(
    kept: Kept,
    stage: Stage,
    cases: Sequence[Case],
    extent: Extent,
    settings: Mapping[str, str],
    run: Callable[[Take, int], Mapping[str, Record]],
) -> Results:
    """Run every scene and seed that is not kept.

    All methods of a scene and seed are one result, because they take turns and their times are compared.
    """
    blocks = [(case, seed) for case in cases for seed in extent.of(case.origin)]
    code = code_digest(stage)
    found: dict[str, list[Mapping[str, Record]]] = defaultdict(list)
    with Progress(f"frontier pipeline: {stage}") as shown:
        for done, (case, seed) in enumerate(blocks):
            shown(done, len(blocks), f"{case.name}, seed {seed}")
            about = {"stage": stage, "scene": case.name, "seed": seed}
            more: dict[str, Any] = {"code": code, "methods": settings, "origin": case.origin}
            if stage == "locating":
                more["starts"] = extent.starts
            key = key_of({**about, **more})
            result = kept.get(key)
            if result is None:
                result = run(case.take(seed), seed)
                kept.add(key, about, result)
            found[case.name].append(result)
        shown(len(blocks), len(blocks))
    return found


def _worth(study: Study) -> list[Sensing]:
    """Ways to sense behind which registration is measured."""
    contacts = {method.rungs[2].name for method in study.methods if method.rungs}
    kept = {method.name for method in study.methods if not method.rungs or sensing_preset(method)}
    for origin in ("simulated", "path-traced"):
        cases = [case for case in study.cases if case.origin == origin]
        if not cases:
            continue
        for contact in contacts:
            group = [m for m in study.methods if m.rungs and m.rungs[2].name == contact]
            points = [depth_point(method, cases, study.sensing) for method in group]
            near = is_near_front([p.ms for p in points], [p.error.value for p in points])
            kept |= {method.name for method, is_near in zip(group, near, strict=True) if is_near}
    return [method for method in study.methods if method.name in kept]
