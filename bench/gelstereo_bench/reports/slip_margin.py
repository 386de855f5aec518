"""Margin to the friction limit of simulated parts that are dragged and twisted, beside the true one.

Run ``python -m gelstereo_bench.reports.slip_margin`` to fill the table in docs/slip.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import (
    ForceEstimator,
    Params,
    RestSurface,
    Scene,
    SlipMargin,
    SlipTracker,
    Stick,
    friction_margin,
)
from gelstereo_bench.reports.markdown import replace_between, table
from gelstereo_bench.reports.slip import SIDE, SIGMA_MM, Run, runs, touched

__all__ = ["Margins", "main", "margins", "true_margin"]

Array = npt.NDArray[np.float64]

#: Parts whose stick ratio has a law, by kind.
_SHAPES = {"ball": "ball", "peg": "cylinder", "plate": "unknown"}
#: A sliding part has no margin that could be wrong.
_SLIDES = 0.01


@dataclass(frozen=True)
class Margins:
    """True margin of one frame, and those found by the stick ratio and by the friction limit."""

    truth: float
    by_stick: SlipMargin | None
    by_limit: SlipMargin | None


def true_margin(traction_kpa: Array, points_mm: Array, friction: float) -> float:
    """Share of the friction limit that true tractions leave, with the ellipse of force and torque."""
    pressure = np.abs(traction_kpa[:, 2])
    centre = pressure @ points_mm[:, :2] / pressure.sum()
    arm = points_mm[:, :2] - centre
    along = traction_kpa[:, :2].sum(axis=0)
    twist = np.sum(arm[:, 0] * traction_kpa[:, 1] - arm[:, 1] * traction_kpa[:, 0])
    used_force = np.hypot(*along) / (friction * pressure.sum())
    used_twist = twist / (friction * pressure @ np.hypot(*arm.T))
    return float(1.0 - np.hypot(used_force, used_twist))


def margins(run: Run, random: np.random.Generator, *, patch_is_known: bool) -> Iterator[Margins]:
    """Margins of every frame in contact of at least three markers, from markers with noise."""
    rest_mm = run.steps[0].points_mm
    rest, count = RestSurface(rest_mm), len(rest_mm)
    layer = Scene().replace(effects={"elastic_layer": {}}).to_dict()["effects"]["elastic_layer"]
    force = {"method": "ridge", "thickness_mm": run.thickness_mm}
    force |= {key: layer[key] for key in ("young_kpa", "poisson_ratio")}
    params = Params().replace(slip={"method": "rigid", "shape": _SHAPES[run.kind]}, force=force)
    covariance = np.tile(np.diag(SIGMA_MM**2), (count, 1, 1))
    tracker = SlipTracker(rest, params, cols=SIDE)
    estimator = ForceEstimator(
        rest, params, cols=SIDE, covariance_mm2=1e-12 * np.tile(np.eye(3), (count, 1, 1))
    )
    for step in run.steps:
        points = step.points_mm + SIGMA_MM * random.normal(size=rest_mm.shape)
        patch = touched(step, rest, None if patch_is_known else points).tolist()
        _, slip = tracker.run(points, covariance, patch)
        traction, wrench = estimator.run(points, covariance, patch)
        if slip is None or wrench is None or step.traction_kpa is None:
            continue
        if np.sum(step.stick != Stick.FREE) < 3:
            continue
        truth = true_margin(step.traction_kpa, step.points_mm, run.friction)
        yield Margins(truth, slip.margin, friction_margin(rest, wrench, traction, points, run.friction))


def _row(name: str, found: list[tuple[float, SlipMargin]]) -> list[str]:
    off = np.array([margin.share - truth for truth, margin in found])
    low, high = np.array([margin.range for _, margin in found]).T
    truth = np.array([truth for truth, _ in found])
    within = (low - 1e-9 <= truth) & (truth <= high + 1e-9)
    return [
        name,
        str(len(found)),
        f"{np.sqrt(np.mean(off**2)):.3f}",
        f"{np.mean(off):+.3f}",
        f"{100 * np.mean(within):.0f}",
        f"{100 * np.mean(truth < low - 1e-9):.0f}",
        f"{np.median(high - low):.2f}",
    ]


def main(arguments: list[str] | None = None) -> int:
    """Fill the table of margins in docs/slip.md."""
    parser = argparse.ArgumentParser(
        prog="python -m gelstereo_bench.reports.slip_margin", description=__doc__
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    parser.add_argument("--contacts", type=int, default=180, help="number of contacts")
    options = parser.parse_args(arguments)
    made = [run for run in runs(options.contacts, seed=30) if run.motion in ("drag", "twist")]
    rows = []
    for name, patch_is_known in (("known patch", True), ("patch from heights", False)):
        random = np.random.default_rng(31)
        seen = [list(margins(run, random, patch_is_known=patch_is_known)) for run in made]
        for source in ("stick ratio", "friction limit"):
            for kind in _SHAPES:
                for motion in ("drag", "twist"):
                    pairs = [
                        (m.truth, found)
                        for run, of_run in zip(made, seen, strict=True)
                        for m in of_run
                        if (run.kind, run.motion) == (kind, motion) and m.truth > _SLIDES
                        if (found := m.by_stick if source == "stick ratio" else m.by_limit) is not None
                    ]
                    if pairs:
                        rows.append(_row(f"{source}: {kind}, {motion}, {name}", pairs))
    head = ["margin by", "frames", "rms error", "mean", "true margin in the range, %", "below it, %"]
    replace_between(options.docs / "slip.md", "margins", table([*head, "width of the range, median"], rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
