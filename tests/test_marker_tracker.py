"""`MarkerTracker`: prints of any layout in one camera. Discs drawn by NumPy, in grey and in colour."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import pytest
from test_foreign_prints import draw

import gelstereo as gs
from gelstereo import MarkerState, MarkerTracker


def random_dots(seed: int = 0) -> np.ndarray:
    """(N, 2) dots at least 18 px apart, 60 px inside the image."""
    rng = np.random.default_rng(seed)
    kept: list[np.ndarray] = []
    for at in rng.uniform([60, 60], [580, 420], (3000, 2)):
        if all(np.hypot(*(at - other)) > 18 for other in kept):
            kept.append(at)
    return np.array(kept)


def hexagonal_dots() -> np.ndarray:
    row, col = np.mgrid[:18, :22].astype(float)
    return np.stack([60 + 24 * (col + 0.5 * (row % 2)), 60 + 20.78 * row], axis=-1).reshape(-1, 2)


def rectangular_dots() -> np.ndarray:
    y, x = np.mgrid[60:420:27, 60:580:20].astype(float)
    return np.stack([x, y], axis=-1).reshape(-1, 2)


LAYOUTS = {"random": random_dots(), "hexagonal": hexagonal_dots(), "rectangular": rectangular_dots()}


def pressed(rest: np.ndarray, share: float) -> np.ndarray:
    """A ball that spreads the markers by up to 6 px, and shear by (9, -5) px."""
    away = rest - [300.0, 260.0]
    spread = away * np.exp(-(away**2).sum(axis=1, keepdims=True) / (2 * 70.0**2)) * (6.0 / 42.5)
    return np.asarray(rest + share * (spread + [9.0, -5.0]))


def order(markers: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Index of the true dot of each marker at rest."""
    apart = np.linalg.norm(markers[:, None] - truth, axis=-1)
    assert apart.min(axis=1).max() < 0.5
    return apart.argmin(axis=1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_press_is_followed_in_any_layout(layout: str) -> None:
    rest = LAYOUTS[layout]
    tracker = MarkerTracker()
    first = tracker.process(draw(rest))
    assert first.is_certain and not first.displacement_px.any() and len(first) >= 0.99 * len(rest)
    names = order(first.rest_px, rest)
    squares = []
    for k in range(1, 9):
        truth = pressed(rest, k / 8)
        found = tracker.process(draw(truth, seed=k))
        assert found.is_certain and np.array_equal(found.rest_px, first.rest_px)
        seen = found.state == MarkerState.SEEN
        assert seen.mean() > 0.97
        off = found.positions_px - truth[names]
        # A disc's centre is measured to some 0.05 px; a wrong name is off by a spacing.
        assert np.abs(off[seen]).max() < 0.5
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance_px2), off)[seen])
    nse = np.concatenate(squares).mean() / 2
    # The detector's variances hold for defocus and grain, which these discs lack.
    assert 0.25 < nse < 1.5
    moved = (pressed(rest, 1) - rest)[names]
    assert np.abs(found.displacement_px - moved)[seen].max() < 0.6


def test_hidden_markers_are_held_with_a_covariance_that_fits() -> None:
    rest = LAYOUTS["random"]
    tracker = MarkerTracker(gs.Params().replace({"track.max_held_frames": 3}))
    first = tracker.process(draw(rest))
    names = order(first.rest_px, rest)
    hidden = np.random.default_rng(2).choice(len(first), 30, replace=False)
    left = np.delete(rest, names[hidden], axis=0)
    squares = []
    for k in range(1, 6):
        found = tracker.process(draw(pressed(left, k / 8), seed=k))
        assert found.is_certain
        assert (found.state[hidden] == (MarkerState.HELD if k <= 3 else MarkerState.LOST)).all()
        off = (found.positions_px - pressed(rest, k / 8)[names])[hidden]
        variance = found.covariance_px2[hidden, 0, 0]
        squares.append((off**2).sum(axis=1) / (2 * variance))
    assert 0.3 < np.mean(squares) < 3
    back = tracker.process(draw(pressed(rest, 5 / 8), seed=9))
    assert (back.state[hidden] == MarkerState.SEEN).mean() > 0.9


def test_an_image_without_the_print_is_not_certain_and_loses_nothing() -> None:
    rest, other = LAYOUTS["random"], random_dots(seed=5)
    tracker = MarkerTracker()
    first = tracker.process(draw(rest))
    held = tracker.process(draw(other))
    assert not held.is_certain and (held.state != MarkerState.SEEN).all()
    assert np.array_equal(held.positions_px, first.positions_px)
    with pytest.raises(gs.DetectError):
        tracker.process(np.full((480, 640), 128, np.uint8))
    again = tracker.process(draw(pressed(rest, 0.2)))
    assert again.is_certain and (again.state == MarkerState.SEEN).mean() > 0.97


def test_a_jump_is_followed_where_the_layout_shows_it() -> None:
    tracker = MarkerTracker()
    first = tracker.process(draw(LAYOUTS["random"]))
    found = tracker.process(draw(LAYOUTS["random"] + [37.0, -22.0]))
    assert found.is_certain
    assert np.abs(found.displacement_px - [37.0, -22.0])[found.state == 0].max() < 0.5
    assert tracker.spacing_px is not None and 18 < tracker.spacing_px < 30
    assert repr(tracker) == f"<MarkerTracker: {len(first)} markers, {tracker.spacing_px:.1f} px apart>"


def test_colour_images_are_tracked_in_the_channel_of_the_rest_image() -> None:
    grey = draw(LAYOUTS["hexagonal"])
    blue = cv2.merge([grey, np.full_like(grey, 170), np.full_like(grey, 170)])
    tracker = MarkerTracker()
    assert tracker.process(blue).channel == "blue"
    assert tracker.process(blue).is_certain
    assert MarkerTracker().process(grey).channel == "grey"


def test_bad_input_is_named_and_the_print_is_kept() -> None:
    tracker = MarkerTracker()
    with pytest.raises(gs.DetectError, match=r"shows 3 markers, and at least 5 are needed"):
        tracker.process(draw(LAYOUTS["random"][:3]))
    assert repr(tracker) == "<MarkerTracker: no rest image yet>" and tracker.spacing_px is None
    tracker.process(draw(LAYOUTS["random"]))
    with pytest.raises(gs.ImageError, match="320 x 480 pixels, but the first one was 640 x 480: reset"):
        tracker.process(draw(LAYOUTS["random"])[:, :320].copy())
    with pytest.raises(ValueError, match="valid are 'left' and 'right'"):
        MarkerTracker(view="top")  # type: ignore[arg-type]
    assert tracker.process(draw(LAYOUTS["random"])).is_certain
    tracker.reset()
    assert len(tracker.process(draw(LAYOUTS["hexagonal"]))) == len(LAYOUTS["hexagonal"])


def test_threads_share_a_tracker() -> None:
    tracker = MarkerTracker()
    image = draw(LAYOUTS["random"])
    tracker.process(image)
    certain: list[bool] = []

    def work() -> None:
        for _ in range(20):
            certain.append(tracker.process(image).is_certain and "px" in repr(tracker))

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert certain == [True] * 60
