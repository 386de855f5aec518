"""Slip beside an independent solution, and on parts that are dragged through simulated images."""

from __future__ import annotations

import pickle

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import gelstereo as gs
from gelstereo import SlipStatus, Stick
from gelstereo_bench.reports.slip import Run, Step, follow, runs, touched
from gelstereo_bench.reports.slip_floor import floor

Array = npt.NDArray[np.float64]

SIDE = 9
SIGMA_MM = np.array([0.0015, 0.0015, 0.005])
RIGID = gs.Params().replace(slip={"method": "rigid"})


def lattice() -> Array:
    x, y = np.meshgrid(*[0.9 * (np.arange(SIDE) - SIDE // 2)] * 2)
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)])


def independent(anchors: Array, points: Array) -> tuple[Array, Array]:
    """Rotation vector and translation about the centroid, by SciPy's Cauchy loss of whole markers."""
    middle, sigma = points.mean(axis=0), SIGMA_MM * np.sqrt(2.0)

    def residuals(x: Array) -> Array:
        moved = Rotation.from_rotvec(x[:3]).apply(anchors - middle) + middle + x[3:]
        squared = np.sum(((points - moved) / sigma) ** 2, axis=1)
        # Cauchy's loss of the squared distance, with half weight at 9; the prior of one frame's motion.
        return np.concatenate([np.sqrt(9.0 * np.log1p(squared / 9.0)), x[:3] / 0.02, x[3:] / 0.3])

    found = least_squares(residuals, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return found[:3], found[3:]


@pytest.mark.parametrize("seed", range(6))
def test_the_motion_is_that_of_scipy(seed: int) -> None:
    random, rest = np.random.default_rng(seed), lattice()
    count = len(rest)
    tracker = gs.SlipTracker(gs.RestSurface(rest), RIGID, cols=SIDE)
    covariance = np.tile(np.diag(SIGMA_MM**2), (count, 1, 1))
    patch = [bool(near) for near in np.hypot(*rest[:, :2].T) < 3.0]
    touch = rest - [0.0, 0.0, 0.3] + SIGMA_MM * random.normal(size=(count, 3))
    stick, slip = tracker.run(touch, covariance, patch)
    assert slip is not None and slip.status == SlipStatus.UNKNOWN and slip.motion is None
    assert {Stick(s).name for s in stick} == {"FREE", "UNKNOWN"}
    turn, shift = random.normal(size=3) * 0.004, random.normal(size=3) * 0.03
    middle = touch[patch].mean(axis=0)
    moved = Rotation.from_rotvec(turn).apply(touch - middle) + middle + shift
    moved += SIGMA_MM * random.normal(size=moved.shape)
    lags = np.flatnonzero(patch)[:3]
    moved[lags, 0] -= 0.05
    stick, slip = tracker.run(moved, covariance, patch)
    assert slip is not None and slip.status == SlipStatus.INCIPIENT
    assert np.all(stick[lags] == Stick.SLIPS) and np.sum(stick == Stick.SLIPS) == 3
    omega, v = independent(touch[patch], moved[patch])
    about = slip.about_mm
    assert about is not None and slip.motion is not None
    expected = Rotation.from_rotvec(omega)
    # Steps end below 1e-6; SciPy's rounding is smaller.
    np.testing.assert_allclose(slip.motion[:3, :3], expected.as_matrix(), atol=3e-6)
    np.testing.assert_allclose(
        (slip.motion @ [*about, 1.0])[:3],
        expected.apply(about - moved[patch].mean(axis=0)) + moved[patch].mean(axis=0) + v,
        atol=3e-6,
    )


def dragged(scene: gs.Scene, steps: int, step_mm: float) -> list[tuple[gs.Frame, gs.SimulatedFrame]]:
    """A part is pressed in three frames, and then dragged along x, through images."""
    sensor = gs.Simulator(scene)
    pipeline = gs.Pipeline(scene.rig, gs.Params.preset("balanced").replace(slip={"method": "rigid"}))
    pose = np.eye(4)
    pose[:3, 3] = 4.0, 0.0, 40.0
    rest = sensor[0]
    pipeline.process(rest.left, rest.right)
    seen = []
    for index in range(1, 4 + steps):
        held = np.array(sensor.pressed(pose, 0.3 * min(index, 3)))
        held[0, 3] += step_mm * max(index - 3, 0)
        frame = sensor.advance(held, frame=index)
        seen.append((pipeline.process(frame.left, frame.right), frame))
    return seen


def scene_of(friction: float) -> gs.Scene:
    return gs.Scene().replace(
        indenter={"kind": "sphere", "radius_mm": 6.0},
        effects={"elastic_layer": {"friction": friction}, "sensor_noise": {}},
    )


def ratio(frame: gs.SimulatedFrame) -> float:
    assert frame.loads is not None
    stuck, slips = (int(np.sum(frame.loads.stick == value)) for value in (Stick.STUCK, Stick.SLIPS))
    return stuck / (stuck + slips)


def test_a_drag_is_stuck_then_incipient_then_gross() -> None:
    seen = dragged(scene_of(0.25), 26, 0.02)
    slips = [frame.slip for frame, _ in seen[1:]]
    order = [slip.status for slip in slips if slip is not None]
    assert len(order) == len(slips) and order == sorted(order), [SlipStatus(s).name for s in order]
    assert {SlipStatus.STUCK, SlipStatus.INCIPIENT, SlipStatus.GROSS} <= set(order)
    truth = [ratio(frame) for _, frame in seen[1:]]
    first = order.index(SlipStatus.INCIPIENT)
    assert truth[first] > 0.5, truth
    assert truth[order.index(SlipStatus.GROSS)] < 0.3, truth
    again = pickle.loads(pickle.dumps(seen[first][0]))
    assert again.slip is not None and again.digest == seen[first][0].digest
    assert repr(again.slip).startswith("<Slip: STUCK, stick ratio between")


def test_a_part_that_sticks_is_followed_without_a_model() -> None:
    seen = dragged(scene_of(20.0), 12, 0.02)
    (first, _), (last, _) = seen[3], seen[-1]
    assert first.slip is not None and last.slip is not None and last.slip.status == SlipStatus.STUCK
    before, after = first.slip.motion, last.slip.motion
    about, covariance = last.slip.about_mm, last.slip.motion_covariance
    assert before is not None and after is not None and about is not None and covariance is not None
    moved = (after @ np.linalg.inv(before) @ [*about, 1.0])[:3] - about
    # Four standard deviations of two motions.
    sigma_mm = np.sqrt(2.0 * np.diag(covariance)[3:])
    assert np.all(np.abs(moved - [0.02 * 11, 0.0, 0.0]) < 4.0 * sigma_mm), (moved, sigma_mm)


def test_the_stick_ratio_is_the_simulators() -> None:
    """Whose patch is known; docs/slip.md has more contacts. Bounds are twice what is there."""
    random = np.random.default_rng(1)
    seen = [s for run in runs(6, seed=30) for s in follow(run, random, patch_is_known=True)]
    known = [s for s in seen if s.ratio is not None and s.status != SlipStatus.GROSS]
    off = [s.truth - s.ratio for s in known if s.ratio is not None]
    assert len(known) > 60 and np.sqrt(np.mean(np.square(off))) < 0.12
    assert np.mean([s.between[0] <= s.truth <= s.between[1] for s in known]) > 0.9
    moved = [s.motion_um for s in known if s.motion_um is not None and s.truth > 0.5]
    assert np.median(moved) < 6.0


def test_forces_tell_the_border_of_a_ball() -> None:
    """Of a true contact with simulated balls, patches from heights leave out a fifth or more."""
    random, found, wider, touching, beside = np.random.default_rng(2), 0, 0, 0, 0
    for run in (run for run in runs(12, seed=30) if run.kind == "ball"):
        rest, step = gs.RestSurface(run.steps[0].points_mm), run.steps[8]
        covariance = np.tile(np.diag(SIGMA_MM**2), (len(step.points_mm), 1, 1))
        force = {"method": "ridge", "thickness_mm": run.thickness_mm, "young_kpa": 100.0}
        params = gs.Params().replace(force=force)
        estimator = gs.ForceEstimator(rest, params, cols=25, covariance_mm2=1e-6 * covariance)
        points = step.points_mm + SIGMA_MM * random.normal(size=step.points_mm.shape)
        patch, true = touched(step, rest, points), step.stick != Stick.FREE
        traction_kpa, _ = estimator.run(points, covariance, patch.tolist())
        wide = estimator.touching(traction_kpa, patch.tolist())
        assert not np.any(patch & ~wide)
        found, wider = found + int(np.sum(patch & true)), wider + int(np.sum(wide & true))
        touching, beside = touching + int(np.sum(true)), beside + int(np.sum(wide & ~true))
    assert found < 0.85 * touching and wider > 0.93 * touching and beside < 0.03 * touching
    with pytest.raises(gs.ContactError, match="a list has 3 entries, but there are 625 markers"):
        estimator.touching(traction_kpa[:3], patch.tolist())


def test_gel_that_strains_as_it_is_pressed_does_not_slip() -> None:
    """Markers stray sideways by a fiftieth of how deep they are pressed. A fifth of a millimetre is slip."""
    random, rest = np.random.default_rng(5), lattice()
    stray = 0.02 * random.normal(size=(len(rest), 2))
    covariance = np.tile(np.diag(SIGMA_MM**2), (len(rest), 1, 1))
    found = {}
    for share in (0.0, 0.04):
        params = RIGID.replace(slip={"method": "rigid", "strain_share": share})
        tracker = gs.SlipTracker(gs.RestSurface(rest), params, cols=SIDE)
        counts = []
        for step in range(12):
            depth_mm = 0.05 * step
            points = rest + SIGMA_MM * random.normal(size=rest.shape)
            points[:, 2] -= depth_mm
            points[:, :2] += depth_mm * stray
            points[40, 0] += 0.2 * (step == 11)
            stick, _ = tracker.run(points, covariance, [True] * len(rest))
            counts.append(int(np.sum(stick == gs.Stick.SLIPS)))
            slips = stick[40] == gs.Stick.SLIPS
        found[share] = counts, slips
    assert max(found[0.0][0][:-1]) > 5
    assert found[0.04] == ([0] * 11 + [1], True)


@pytest.mark.parametrize(("slips_mm", "found"), [(0.0, 0.0), (0.005, 1.0), (0.02, 1.0)])
def test_a_slip_is_found_only_if_it_is_seen_in_time(slips_mm: float, found: float) -> None:
    """A fifth of the markers slip in the frame before all do. In the middle one, only all of them show it."""
    rest, steps = lattice(), []
    for step in range(5):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * step
        points, stick = rest + pose[:3, 3], np.full(len(rest), int(Stick.STUCK), np.uint8)
        if step >= 3:
            points[:16, 0] -= slips_mm
            stick[: 16 if step == 3 else 81] = int(Stick.SLIPS)
        steps.append(Step(points, stick, pose))
    run = Run("plate", "drag", steps, 0.5, 4.0)
    seen = floor(run, np.random.default_rng(7))
    assert seen is not None and seen.largest_um == pytest.approx(1e3 * slips_mm, abs=1e-6)
    assert seen.by_slip == pytest.approx(found, abs=0.1)
    assert seen.by_marker == pytest.approx(float(slips_mm > 0.01), abs=0.1)
    assert floor(Run("plate", "drag", steps[:4], 0.5, 4.0), np.random.default_rng(7)) is None


def test_settings_and_lists_are_checked() -> None:
    rest = gs.RestSurface(lattice())
    with pytest.raises(gs.ContactError, match="81 markers do not fill rows of 7"):
        gs.SlipTracker(rest, RIGID, cols=7)
    with pytest.raises(gs.ParamsError, match=r"slip\.frame_rate_hz"):
        RIGID.replace(slip={"method": "rigid", "frame_rate_hz": 0.0})
    with pytest.raises(gs.ParamsError, match=r"slip\.strain_sigma_mm"):
        RIGID.replace(slip={"method": "rigid", "strain_sigma_mm": -0.01})
    with pytest.raises(gs.ParamsError, match=r"slip\.strain_share is 2; valid is 0 to 1"):
        RIGID.replace(slip={"method": "rigid", "strain_share": 2.0})
    tracker = gs.SlipTracker(rest, RIGID, cols=SIDE)
    assert repr(tracker) == "<SlipTracker: 81 markers>"
    with pytest.raises(gs.ContactError, match="a list has 80 entries"):
        tracker.run(lattice()[1:], np.zeros((81, 3, 3)), [True] * 81)
    stick, slip = tracker.run(lattice(), np.tile(np.diag(SIGMA_MM**2), (81, 1, 1)), [False] * 81)
    assert slip is None and not stick.any()
    assert gs._native.slip_statuses() == {status.name: status.value for status in SlipStatus}
