"""Displacements between rest and press frames of a real gel, whose recorded markers are rendered and found
again.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from gelstereo import Scene, SceneError, Simulator
from gelstereo.recordings import episodes, load_pytac3d, pytac3d_example
from gelstereo_bench.reports.displacements import SALIENCY_MM, Replay, replay

needs_wheel = pytest.mark.skipif(
    find_spec("PyTac3D") is None,
    reason="the wheel pytac3d is absent (pip install --no-deps pytac3d==3.3.0.9)",
)


@pytest.fixture(scope="module")
def replayed() -> Replay:
    return replay(load_pytac3d(pytac3d_example("example_1", "AD2-0065L")))


def firm(replayed: Replay) -> np.ndarray:
    """Frames in which something presses."""
    runs = episodes(replayed.recording.indentation_mm(), SALIENCY_MM)
    return np.concatenate([np.arange(run.start, run.stop) for run in runs])


@needs_wheel
def test_every_marker_keeps_its_identity_over_the_whole_recording(replayed: Replay) -> None:
    assert replayed.displacement_mm.shape == (252, 400, 3)
    assert replayed.seen.all()
    assert replayed.switched().sum() == 0
    # A switched marker would be off by the pitch, 1 mm.
    assert np.linalg.norm(replayed.displacement_mm - replayed.recorded_mm, axis=2).max() < 0.1


@needs_wheel
@pytest.mark.parametrize("preset", ["balanced", "exact"])
def test_displacements_are_the_recordings_within_the_predicted_covariance(
    replayed: Replay, preset: str
) -> None:
    if preset != "balanced":
        replayed = replay(load_pytac3d(pytac3d_example("example_1", "AD2-0065L")), preset)
    pressed = firm(replayed)
    error = (replayed.displacement_mm - replayed.recorded_mm)[pressed]
    predicted = np.sqrt(np.einsum("fmii->fmi", replayed.covariance_mm2[pressed]).mean(axis=(0, 1)))
    rms = np.sqrt((error**2).mean(axis=(0, 1)))
    # The grain of the paint stays where it is, so rest and press frame share a part of their errors: what is
    # left is less than predicted, never more than the tenth that a rung's covariance may be off. The
    # recording's own noise of height, 0.01 mm, is drawn as a rough gel and counts as folds, which doubles the
    # variance across at most.
    assert (rms < 1.1 * predicted).all() and (rms > 0.5 * predicted).all()
    assert 0.5 < replayed.nees()[pressed].mean() / 3.0 < 1.2
    # No bias: a mean over 400 markers and 130 frames. Markers that lean in the dome share a bias of some
    # micrometres.
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.002


@needs_wheel
def test_displacements_are_smooth(replayed: Replay) -> None:
    rows, cols = replayed.recording.rows, replayed.recording.cols
    for frame in firm(replayed):
        field = replayed.displacement_mm[frame].reshape(rows, cols, 3)
        ring = (field[:-2, 1:-1] + field[2:, 1:-1] + field[1:-1, :-2] + field[1:-1, 2:]) / 4.0
        rough = np.linalg.norm(field[1:-1, 1:-1] - ring, axis=2)
        # A gel bends over its thickness of several pitches; one marker out of line would stand out by a
        # pitch. Height has a noise of 0.01 mm, of which three times are added.
        assert rough.max() < 0.3 * np.linalg.norm(field, axis=2).max() + 0.03
        assert np.median(rough) < 0.03


@needs_wheel
def test_nothing_moves_while_nothing_touches(replayed: Replay) -> None:
    indentation = replayed.recording.indentation_mm()
    # Ten times the recording's own noise of height.
    idle = np.abs(indentation).max(axis=1) < 0.03
    assert idle.sum() > 50
    moved = (replayed.displacement_mm - replayed.recorded_mm)[idle]
    sigma = np.sqrt(np.einsum("fmii->fmi", replayed.covariance_mm2[idle]))
    share = (np.abs(moved) < 3.0 * sigma).mean()
    assert share > 0.99
    assert not ((-moved[:, :, 2]) > SALIENCY_MM).any()


@needs_wheel
def test_far_from_the_contact_the_gel_hardly_moves(replayed: Replay) -> None:
    for frame in firm(replayed)[::7]:
        depth = -replayed.displacement_mm[frame][:, 2]
        place = replayed.recording.rest_mm[:, :2]
        salient = depth > SALIENCY_MM
        away = np.linalg.norm(place[:, None] - place[salient][None], axis=2).min(axis=1)
        far = away > 6.0
        assert np.linalg.norm(replayed.displacement_mm[frame][salient], axis=1).min() > 0.3
        assert np.linalg.norm(replayed.displacement_mm[frame][far], axis=1).max(initial=0.0) < 0.3


@needs_wheel
def test_both_views_agree_on_the_motion(replayed: Replay) -> None:
    pressed = firm(replayed)
    left, right = (
        press[pressed] - rest for press, rest in zip(replayed.press_px, replayed.rest_px, strict=True)
    )
    # The cameras stand side by side: what moves up or down does so in both by the same, but for noise (0.04
    # px each).
    assert np.sqrt(((left - right)[:, :, 1] ** 2).mean()) < 0.1
    # Towards the camera means more disparity, by f b / z² of the height (at most 560 * 8 / 23.6² px/mm).
    nearer = -replayed.displacement_mm[pressed][:, :, 2] > 0.1
    gain = (left - right)[:, :, 0][nearer]
    assert (gain > 0.0).all() and gain.max() < 560.0 * 8.0 / 23.6**2 * 1.6
    for frame, (a, b) in enumerate(zip(left, right, strict=True)):
        moved = np.hypot(*a.T) > 2.0
        if moved.sum() > 20:
            mean_a, mean_b = a[moved].mean(axis=0), b[moved].mean(axis=0)
            assert abs(mean_a[1] - mean_b[1]) < 0.1, frame


def test_points_of_another_lattice_are_refused() -> None:
    with pytest.raises(SceneError, match=r"number of points_mm is 3; valid is gel\.rows \* gel\.cols"):
        Simulator(Scene()).render_points(np.zeros((3, 3)))
