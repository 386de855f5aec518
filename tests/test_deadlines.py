"""Deadlines from Python: limits of work, replays with them, and registration in time."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelstereo as gs

RIG = gs.Scene().rig


def follow(
    frames: list[gs.SimulatedFrame], limits: list[int | None], preset: str = "balanced"
) -> list[gs.Frame]:
    pipeline = gs.Pipeline(RIG, gs.Params.preset(preset))
    shown = zip(frames, limits, strict=True)
    return [pipeline.process(frame.left, frame.right, work_limit=limit) for frame, limit in shown]


@settings(max_examples=5, deadline=None)
@given(data=st.data())
def test_limits_of_a_run_with_deadlines_give_the_same_bits(
    noisy_press: list[gs.SimulatedFrame], data: st.DataObject
) -> None:
    """Whatever this computer's clock said."""
    deadlines_ms = data.draw(st.lists(st.floats(0.05, 20.0), min_size=5, max_size=5))
    pipeline = gs.Pipeline(RIG, gs.Params.preset("exact"))
    frames = noisy_press[:5]
    live = [
        pipeline.process(frame.left, frame.right, deadline_ms=deadline_ms)
        for frame, deadline_ms in zip(frames, deadlines_ms, strict=True)
    ]
    again = follow(frames, [frame.work_limit for frame in live], "exact")
    assert [frame.digest for frame in again] == [frame.digest for frame in live]
    assert all(frame.work_limit is not None for frame in live)


def test_a_frame_states_its_rungs(noisy_press: list[gs.SimulatedFrame]) -> None:
    frames = follow(noisy_press[:4], [2**60, 2**60, 0, None])
    rungs = [(frame.left.searched, frame.left.centre, frame.left.is_degraded) for frame in frames]
    assert rungs == [
        ("whole", "fit", False),
        ("windows", "fit", False),
        ("windows", "soft_threshold", True),
        ("windows", "fit", False),
    ]
    assert frames[2].work < frames[1].work
    assert frames[3].work_limit is None
    copy = pickle.loads(pickle.dumps(frames[2]))
    assert (copy.work, copy.work_limit, copy.left.is_degraded) == (frames[2].work, 0, True)


def test_covariances_of_the_cheaper_rung_are_larger(noisy_press: list[gs.SimulatedFrame]) -> None:
    """By the square of the ratio of the errors, 0.044 px to 0.029 px (docs/accuracy-vs-time.md)."""
    fit, centroid = (follow(noisy_press[:3], [2**60, 2**60, limit])[2] for limit in (2**60, 0))
    ratio = np.median(centroid.covariance_mm2[:, 2, 2] / fit.covariance_mm2[:, 2, 2])
    assert 1.5 < ratio < 3.5


@pytest.mark.parametrize("deadline_ms", [0.0, -1.0, float("nan"), float("inf")])
def test_a_deadline_is_a_positive_time(noisy_press: list[gs.SimulatedFrame], deadline_ms: float) -> None:
    shown = noisy_press[0]
    with pytest.raises(ValueError, match="positive time in milliseconds"):
        gs.Pipeline(RIG).process(shown.left, shown.right, deadline_ms=deadline_ms)
    with pytest.raises(ValueError, match="are both given; give one"):
        gs.Pipeline(RIG).process(shown.left, shown.right, deadline_ms=1.0, work_limit=5)


def ball() -> tuple[gs.Template, np.ndarray, np.ndarray]:
    """A template of a ball, points on its lower cap, and its pose."""
    import trimesh

    mesh = trimesh.creation.icosphere(3, 5.0)
    template = gs.Template.from_mesh(mesh, units="mm", spacing_mm=0.8).with_grid()
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-2.0, 2.1, 0.8), np.arange(-2.0, 2.1, 0.8)))
    points_mm = np.column_stack([x, y, -np.sqrt(25.0 - x**2 - y**2)])
    return template, points_mm, np.eye(4)


def test_registration_in_time_is_that_of_its_budget() -> None:
    template, points_mm, pose = ball()
    params = gs.Params.preset("balanced")
    first = gs.localize(points_mm, template, guess=pose, params=params, deadline_ms=1e3)
    assert first.work > 0
    short = gs.localize(points_mm, template, guess=pose, params=params, deadline_ms=1e-4)
    assert short.budget is not None and first.budget is not None and short.budget < first.budget
    again = gs.localize(
        points_mm,
        template,
        guess=pose,
        params=params.replace({"register.surface_search.budget": short.budget}),
    )
    assert again.digest == short.digest


def test_a_deadline_needs_a_method_with_a_budget() -> None:
    template, points_mm, pose = ball()
    with pytest.raises(ValueError, match=r'register\.method = "surface_close" or "surface_search"'):
        gs.localize(points_mm, template, guess=pose, params=gs.Params.preset("paper"), deadline_ms=5.0)
