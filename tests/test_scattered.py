"""`StereoMarkerTracker`: random dots under a ball, drawn in both views, to points and a pose."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from test_foreign_prints import draw

import gelstereo as gs
from gelstereo._native import pair_views
from gelstereo.scattered import PairingError, ScatteredFrame, StereoMarkerTracker

SURFACE_MM, RADIUS_MM, PRESS_MM = 28.7, 6.0, 1.2
BALL_MM = np.array([4.0, 0.5, SURFACE_MM - PRESS_MM + RADIUS_MM])
COUNT = 300


def random_print(seed: int = 0) -> np.ndarray:
    """(300, 3) random dots at least 0.72 mm apart, on a gel of 18 x 16 mm."""
    rng = np.random.default_rng(seed)
    kept: list[np.ndarray] = []
    while len(kept) < COUNT:
        at = rng.uniform([-4.0, -8.0], [13.0, 8.0])
        if all(np.hypot(*(at - other)) > 0.72 for other in kept):
            kept.append(at)
    return np.column_stack([kept, np.full(len(kept), SURFACE_MM)])


def pressed(rest_mm: np.ndarray, share: float) -> np.ndarray:
    """The markers on a ball's surface, and a shoulder that decays over 1.5 mm beside it."""
    away = np.hypot(*(rest_mm[:, :2] - BALL_MM[:2]).T)
    depth = share * PRESS_MM
    touch = np.sqrt(RADIUS_MM**2 - (RADIUS_MM - 0.5 * depth) ** 2)
    on_ball = depth - (RADIUS_MM - np.sqrt(np.maximum(RADIUS_MM**2 - np.minimum(away, touch) ** 2, 0.0)))
    out = rest_mm.copy()
    out[:, 2] -= on_ball * np.exp(-np.maximum(away - touch, 0.0) / 1.5)
    return out


@pytest.fixture(scope="module")
def rig() -> gs.Rig:
    return gs.Scene().rig


def images(rig: gs.Rig, points_mm: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Discs of 0.25 mm at the points, drawn in both views, with noise of 2 grey levels."""
    scale = SURFACE_MM / points_mm[:, 2]
    left_px, right_px = rig.project(points_mm)
    return draw(left_px, scale, seed=2 * seed), draw(right_px, scale, seed=2 * seed + 1)


def run(rig: gs.Rig, frames: list[np.ndarray], params: gs.Params | None = None) -> list[ScatteredFrame]:
    tracker = StereoMarkerTracker(rig, params)
    return [tracker.process(*images(rig, points, k)) for k, points in enumerate(frames)]


def names(points_mm: np.ndarray, truth_mm: np.ndarray) -> np.ndarray:
    apart = np.linalg.norm(points_mm[:, None] - truth_mm, axis=-1)
    assert apart.min(axis=1).max() < 0.1
    return apart.argmin(axis=1)


def test_a_ball_on_random_dots_is_measured_in_millimetres(rig: gs.Rig) -> None:
    rest = random_print()
    truth = [pressed(rest, k / 6) for k in range(7)]
    found = run(rig, truth)
    assert len(found[0]) > 0.97 * len(rest) and found[0].salient.sum() == 0
    who = names(found[0].points_mm, rest)
    assert len(set(who)) == len(who)
    squares = []
    for frame, points_mm in zip(found, truth, strict=True):
        seen = frame.state == gs.MarkerState.SEEN
        assert frame.is_certain and seen.mean() > 0.98
        off = frame.points_mm - points_mm[who]
        assert np.abs(off[seen]).max() < 0.1
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(frame.covariance_mm2), off)[seen])
    # The detector's variances hold for defocus and grain, which these discs lack.
    nse = np.concatenate(squares).mean() / 3
    assert 0.25 < nse < 1.5
    heights = SURFACE_MM - truth[-1][who, 2]
    assert np.abs(found[-1].indentation_mm - heights)[seen].max() < 0.1
    saliency_mm = gs.Params().to_dict()["contact"]["saliency_mm"]
    clear = np.abs(heights - saliency_mm) > 0.05
    assert (found[-1].salient == (heights > saliency_mm))[clear].all()
    assert repr(found[-1]).startswith(f"<ScatteredFrame: {len(who)} markers, ")


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("contact", [{"saliency": "pressure", "decay_mm": 1.5}, {"saliency": "adaptive"}])
def test_contact_by_pressure_leaves_the_shoulder_out(
    rig: gs.Rig, contact: dict[str, object], seed: int
) -> None:
    rest = random_print(seed)
    params = gs.Params().replace(contact=contact)
    found = run(rig, [pressed(rest, k / 6) for k in range(7)], params)
    frame = found[-1]
    assert found[0].salient.sum() == 0
    away_mm = np.hypot(*(rest[names(frame.points_mm, pressed(rest, 1.0)), :2] - BALL_MM[:2]).T)
    touch_mm = np.sqrt(RADIUS_MM**2 - (RADIUS_MM - 0.5 * PRESS_MM) ** 2)
    assert frame.salient[away_mm < touch_mm].mean() > 0.9
    assert not frame.salient[away_mm > touch_mm + 0.7].any()


def test_a_ball_is_localized_on_random_dots(rig: gs.Rig) -> None:
    rest = random_print(1)
    params = gs.Params().replace(contact={"saliency": "pressure", "decay_mm": 1.5})
    found = run(rig, [pressed(rest, k / 6) for k in range(7)], params)
    frame = found[-1]
    ball = gs.Template.from_mesh(trimesh.creation.icosphere(5, RADIUS_MM), units="mm", spacing_mm=0.5)
    guess = np.eye(4)
    guess[:3, 3] = BALL_MM + [0.5, -0.4, 0.3]
    pose = gs.localize(
        frame.points_mm[frame.salient],
        ball,
        guess=guess,
        covariance_mm2=frame.covariance_mm2[frame.salient],
        params=gs.Params().replace({"register.method": "surface_close"}),
    )
    assert pose.converged
    assert np.linalg.norm(np.asarray(pose.t_sensor_object)[:3, 3] - BALL_MM) < 0.15


@pytest.mark.parametrize("kind", ["hexagonal", "rectangular", "random"])
def test_views_of_any_layout_are_paired(kind: str) -> None:
    rng = np.random.default_rng(3)
    row, col = np.mgrid[:15, :18].astype(float)
    left = {
        "hexagonal": np.stack([60 + 26 * (col + 0.5 * (row % 2)), 60 + 22.5 * row], axis=-1).reshape(-1, 2),
        "rectangular": np.stack([60 + 20 * col, 60 + 27 * row], axis=-1).reshape(-1, 2),
        "random": rng.uniform([60, 60], [560, 420], (250, 2)),
    }[kind]
    # A tilted gel, rows off by half a pixel, noise, and markers that one view does not show.
    right = left - np.column_stack([110 + 0.05 * left[:, 1] + 0.03 * left[:, 0], np.full(len(left), 0.5)])
    right += rng.normal(0, 0.1, right.shape)
    order = rng.permutation(len(right))[: len(right) - 6]
    pairs = pair_views(left[6:], right[order])
    assert pairs is not None and np.array_equal(pairs[:, 0] + 6, order[pairs[:, 1]])
    assert len(pairs) > 0.9 * len(left)


def test_views_of_different_prints_are_not_paired(rig: gs.Rig) -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        left, right = rng.uniform([60, 60], [560, 420], (2, 250, 2))
        assert pair_views(left, right) is None
    assert pair_views(np.empty((0, 2)), np.empty((0, 2))) is None
    tracker = StereoMarkerTracker(rig)
    left, right = images(rig, random_print(0), 0)
    with pytest.raises(PairingError, match="cannot be paired: check that the rig belongs"):
        tracker.process(left, images(rig, random_print(7), 1)[1])
    assert tracker.rest is None
    assert len(tracker.process(left, right)) > 0.97 * COUNT and tracker.rest is not None
