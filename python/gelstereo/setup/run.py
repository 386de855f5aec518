"""The steps of a setup, in order.

A finished step is stored, and used again while its inputs are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gelstereo._native import Rig, __version__
from gelstereo.setup import cameras, gel, layers, prints
from gelstereo.setup.plan import Plan
from gelstereo.setup.report import write_report
from gelstereo.setup.sensor import sensor_text
from gelstereo.setup.step import Step, digest_of, load_step, save_step

__all__ = ["learned_settings", "set_up"]


def set_up(plan: Plan, output: str | Path, report: Callable[[str], None] = lambda _: None) -> list[Step]:
    """Run all steps, and write ``sensor.toml`` and ``report.html`` into a folder.

    Parameters
    ----------
    plan
        Images and facts.
    output
        Folder; its subfolder ``steps`` holds finished steps. A step runs again if its images, its settings,
        an earlier step or the version of gelstereo differ.
    report
        Called with a line of text at each step.

    Returns
    -------
    list of Step
        Results. A step in doubt does not stop the setup.

    Raises
    ------
    Error
        A step has no result, for example because a board is not found. Earlier steps are kept.
    """
    output = Path(output)
    steps: list[Step] = []
    digest = ""

    def run(name: str, files: Iterable[Path], settings: object, make: Callable[[], Step]) -> Step:
        nonlocal digest
        digest = digest_of(__version__, files, digest, name, settings)
        path = output / "steps" / f"{len(steps) + 1}-{name}.json"
        step = load_step(path, digest)
        if step is None:
            report(f"{name} ...")
            step = make()
            save_step(path, step, digest)
        report(str(step))
        steps.append(step)
        return step

    found = run("cameras", _files(plan.cameras), plan.board, lambda: cameras.calibrate(plan))
    rig = Rig.from_toml(found.values["rig"])
    settings = run(
        "print", _files(plan.rest), (plan.preset, plan.pitch_mm, plan.params), lambda: prints.look(plan)
    ).values["settings"]
    images = [path for _, views in plan.boards for path in _files(views)]
    facts = (plan.layers, plan.priors, [height_mm for height_mm, _ in plan.boards])
    found = run("layers", images, facts, lambda: layers.fit(plan, rig, settings))
    rig = Rig.from_toml(found.values["rig"])
    over_plate_sigma_mm = found.values.get("over_plate_sigma_mm")
    values: dict[str, Any] = dict(run("rest", (), None, lambda: gel.rest(plan, rig, settings)).values["gel"])
    if plan.presses is not None:
        found = run(
            "presses",
            _files(plan.presses),
            (plan.ball_radius_mm, plan.thickness_mm),
            lambda: gel.presses(plan, rig, settings, over_plate_sigma_mm),
        )
        values |= found.values["gel"]
        settings = {**settings, **learned_settings(values), **plan.params} if found.is_good else settings
    path = output / "sensor.toml"
    path.write_text(sensor_text(rig, plan.preset, settings, values), encoding="utf-8")
    write_report(output / "report.html", steps)
    return steps


def learned_settings(gel: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that presses tell, with their standard deviations, by dotted names.

    A depth of the print below three standard deviations may be none. It is then taken for none, with an error
    that includes it.
    """
    learned = gel["learned"]
    settings: dict[str, Any] = {"contact.decay_mm": gel["decay_mm"]} if "decay_mm" in learned else {}
    if "depth_mm" in learned:
        depth_mm, sigma_mm = gel["depth_mm"], gel["depth_sigma_mm"]
        if depth_mm > 3.0 * sigma_mm:
            settings |= {"lattice.depth_mm": depth_mm, "lattice.depth_sigma_mm": sigma_mm}
        else:
            settings["lattice.depth_sigma_mm"] = round(float(np.hypot(depth_mm, sigma_mm)), 4)
    for name, unit in (("thickness", "_mm"), ("friction", "")):
        if name + unit in learned:
            settings |= {f"force.{key}": gel[key] for key in (name + unit, f"{name}_sigma{unit}")}
    return settings


def _files(views: Any) -> tuple[Path, ...]:
    return (*views.left, *views.right)
