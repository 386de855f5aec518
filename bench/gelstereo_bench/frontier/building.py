"""Time to create a template: its samples and their tree, the exact surface and the grid around it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gelstereo import Template, parts
from gelstereo_bench.frontier.table import Report, Table, Target, figure

__all__ = ["measure_building"]


def measure_building(rounds: int, report: Report) -> tuple[Table, list[Target]]:
    """Create, save and load a template of every part of the project; medians."""
    rows: list[list[str]] = []
    slowest_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.template"
        for name, make in {**parts.PEGS, **parts.CONTACTS}.items():
            report(f"templates: {name}")
            mesh = make()
            vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
            template = Template.from_triangles(vertices, faces)
            built_s = _seconds(lambda v=vertices, f=faces: Template.from_triangles(v, f), rounds)  # type: ignore[misc]
            alike_s = _seconds(template.with_symmetries, rounds)
            template.save(file)
            read_s = _seconds(lambda: Template.load(file), rounds)
            slowest_s = max(slowest_s, built_s)
            row = [name, str(len(faces)), str(len(template)), figure(built_s), figure(alike_s)]
            rows.append([*row, figure(file.stat().st_size / 2**20), figure(read_s)])
    head = ["part", "triangles", "samples", "template s", "symmetries s", "file MiB", "load s"]
    target = Target("template, slowest of the project's parts", 1.0, slowest_s, "s")
    return Table("templates", head, rows), [target]


def _seconds(call: Callable[[], object], rounds: int) -> float:
    taken = []
    for _ in range(rounds):
        begin = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))
