"""Margin to the friction limit, beside NumPy and the simulator's true loads."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo as gs
from gelstereo import MarginSource
from gelstereo_bench.reports.slip import SIDE, SIGMA_MM, Run, runs
from gelstereo_bench.reports.slip_margin import margins, true_margin

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def dragged() -> list[Run]:
    """A ball, a peg and a plate that are dragged."""
    return list(runs(3, seed=30))


def estimated(run: Run, at: int) -> tuple[gs.RestSurface, gs.Wrench, Array, Array]:
    rest_mm = run.steps[0].points_mm
    rest, count = gs.RestSurface(rest_mm), len(rest_mm)
    force = {"method": "ridge", "thickness_mm": run.thickness_mm, "young_kpa": 100.0}
    covariance = np.tile(np.diag(SIGMA_MM**2), (count, 1, 1))
    params = gs.Params().replace(force=force)
    estimator = gs.ForceEstimator(rest, params, cols=SIDE, covariance_mm2=covariance)
    step = run.steps[at]
    traction, wrench = estimator.run(step.points_mm, covariance, (step.stick != gs.Stick.FREE).tolist())
    assert wrench is not None
    return rest, wrench, traction, step.points_mm


@pytest.mark.parametrize("at", [6, 12, 25])
@pytest.mark.parametrize("kind", [0, 2])
def test_the_friction_limit_is_numpys(dragged: list[Run], kind: int, at: int) -> None:
    """With its range by a numerical derivative of all six components of the wrench."""
    run = dragged[kind]
    rest, wrench, traction, points = estimated(run, at)
    normal = rest.normal
    pressure = np.maximum(traction @ normal, 0.0)
    centre = pressure @ points / pressure.sum()
    radius = pressure @ np.linalg.norm(points - centre, axis=1) / pressure.sum()
    moved = wrench.about(centre)

    def used(loads: Array) -> float:
        pressing = loads[:3] @ normal
        along = loads[:3] - pressing * normal
        total = np.hypot(np.linalg.norm(along), loads[3:] @ normal / radius)
        return float(total / (run.friction * pressing))

    loads = np.concatenate([moved.force_n, moved.torque_nmm])
    steps = 1e-6 * np.eye(6)
    slope = np.array([(used(loads + step) - used(loads - step)) / 2e-6 for step in steps])
    pressing = loads[:3] @ normal
    twist = loads[3:] @ normal / radius / (run.friction * pressing)
    sigma = np.sqrt(slope @ moved.covariance @ slope + (0.06 * twist**2 / used(loads)) ** 2)
    margin = gs.friction_margin(rest, wrench, traction, points, run.friction)
    assert margin is not None and margin.source == MarginSource.LIMIT
    found = [margin.share, *margin.range]
    expected = np.clip(1.0 - used(loads) + sigma * np.array([0.0, -1.96, 1.96]), 0.0, 1.0)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_margins_hold_the_simulators(dragged: list[Run]) -> None:
    """Three contacts; docs/slip.md has more. Bounds are twice what is there."""
    random = np.random.default_rng(2)
    seen = [(run.kind, m) for run in dragged for m in margins(run, random, patch_is_known=False)]
    limits = [(m.truth, m.by_limit) for _, m in seen if m.by_limit is not None]
    assert len(limits) > 40
    assert np.sqrt(np.mean([(margin.share - truth) ** 2 for truth, margin in limits])) < 0.03
    sticks = [(m.truth, m.by_stick) for _, m in seen if m.by_stick is not None]
    assert len(sticks) > 20 and all(margin.source == MarginSource.STICK for _, margin in sticks)
    assert np.mean([margin.range[0] <= truth <= margin.range[1] for truth, margin in sticks]) > 0.9
    assert not any(m.by_stick for kind, m in seen if kind == "plate")


def test_what_is_not_known_has_no_margin(dragged: list[Run]) -> None:
    rest, wrench, traction, points = estimated(dragged[0], 12)
    assert gs.friction_margin(rest, wrench, traction, points, 0.0) is None
    assert gs.friction_margin(rest, wrench, np.zeros_like(traction), points, 0.5) is None
    one = np.where(traction == np.abs(traction).max(), traction, 0.0)
    assert gs.friction_margin(rest, wrench, one, points, 0.5) is None
    # A lying peg is longer than the lattice: forces beyond it are missing.
    rest, wrench, traction, points = estimated(dragged[1], 12)
    assert wrench.is_cut and gs.friction_margin(rest, wrench, traction, points, 0.5) is None
    with pytest.raises(gs.ContactError, match="a list has 3 entries"):
        gs.friction_margin(rest, wrench, traction[:3], points, 0.5)
    assert gs._native.margin_sources() == {source.name: source.value for source in MarginSource}


def test_sliding_leaves_nothing_and_pressing_everything() -> None:
    x, y = np.meshgrid(np.arange(3.0), np.arange(3.0))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(9, 30.0)])
    pressed = np.tile([0.0, 0.0, -2.0], (9, 1))
    assert true_margin(pressed, points, 0.5) == 1.0
    assert true_margin(pressed + [0.6, -0.8, 0.0], points, 0.5) == pytest.approx(0.0)
    assert true_margin(pressed + [0.3, -0.4, 0.0], points, 0.5) == pytest.approx(0.5)
    arm = points[:, :2] - 1.0
    turning = np.column_stack([-arm[:, 1], arm[:, 0], np.zeros(9)]) / np.maximum(
        np.hypot(*arm.T)[:, None], 1e-9
    )
    assert true_margin(pressed + turning, points, 0.5) == pytest.approx(0.0)


def test_shear_is_found_after_frames_without_it() -> None:
    """The variance of shears falls to nothing in these, and did not rise again."""
    run = next(runs(1, seed=3))
    found = [m for m in margins(run, np.random.default_rng(3), patch_is_known=True) if m.by_limit is not None]
    assert min(m.truth for m in found) < 0.5
    assert max(abs(m.by_limit.share - m.truth) for m in found if m.by_limit is not None) < 0.1
