"""Hard case 53: a print of few small dots, seen through a clear gel with large objects behind it."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from gelstereo import Detector, Params

ROWS, COLS, PITCH_PX, RADIUS_PX = 4, 6, 60.0, 4.0
WIDTH, HEIGHT, SCALE = 640, 480, 4
INK = 25.0


def scene(seed: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """An image, the centres of its dots (N, 2) in pixels, and which of them stand out from what is behind."""
    random = np.random.default_rng(seed)
    image = np.full((HEIGHT * SCALE, WIDTH * SCALE), random.uniform(120, 190), np.float32)
    for _ in range(40):
        centre = tuple(int(random.uniform(0, side) * SCALE) for side in (WIDTH, HEIGHT))
        axes = tuple(int(random.uniform(8, 60) * SCALE) for _ in range(2))
        level = float(random.uniform(20, 230))
        cv2.ellipse(image, centre, axes, float(random.uniform(0, 180)), 0, 360, level, -1, cv2.LINE_AA)
    # The objects are out of focus.
    image = cv2.GaussianBlur(image, (0, 0), 2.0 * SCALE)
    behind = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    row, col = np.divmod(np.arange(ROWS * COLS), COLS)
    offset = np.stack([col - (COLS - 1) / 2, row - (ROWS - 1) / 2], axis=1) * PITCH_PX
    turn = random.uniform(-0.2, 0.2)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    centres = offset @ rotation.T + [WIDTH / 2, HEIGHT / 2] + random.uniform(-5, 5, 2)
    for centre in centres:
        at = tuple(int(v) for v in np.round((centre + 0.5) * SCALE * 16 - 8))
        cv2.circle(image, at, int(RADIUS_PX * SCALE * 16), INK, -1, cv2.LINE_AA, 4)
    image = cv2.GaussianBlur(image, (0, 0), 0.8 * SCALE)
    image = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    around = cv2.erode(behind, np.ones((17, 17))) - INK
    uneven = cv2.dilate(behind, np.ones((17, 17))) - cv2.erode(behind, np.ones((17, 17)))
    x, y = np.round(centres).astype(int).T
    stands_out = (around[y, x] > 60) & (uneven[y, x] < 20)
    noisy = image + random.normal(0, 2, image.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8), centres, stands_out


@pytest.mark.parametrize("preset", ["fast", "balanced", "exact"])
def test_row_53_small_dots_before_large_objects(preset: str) -> None:
    """Before, the objects' area was taken for the markers' in 15 of 16 such scenes, and no dot was found."""
    detector, shares = Detector(Params.preset(preset)), []
    for seed in range(24):
        image, centres, stands_out = scene(seed)
        # Half of the print is needed, so that markers have neighbours in rows.
        if stands_out.sum() >= ROWS * COLS / 2:
            found = detector.detect(image)
            distance = np.linalg.norm(centres[:, None] - found.centres_px[None], axis=-1)
            shares.append((distance[stands_out].min(axis=1) < 0.2).mean())
            assert found.share_in_rows is not None and found.share_in_rows > 1 / 3, seed
    assert len(shares) > 15 and min(shares) > 0.8 and np.mean(shares) > 0.97, shares


def test_row_53_objects_alone_are_no_print() -> None:
    """Dots in rows are what makes a print: these stand anywhere, and the result says so."""
    random = np.random.default_rng(5)
    image = np.full((HEIGHT, WIDTH), 170, np.uint8)
    places = np.stack([random.uniform(20, WIDTH - 20, 60), random.uniform(20, HEIGHT - 20, 60)], axis=1)
    for x, y in places:
        cv2.circle(image, (round(x * 16), round(y * 16)), 80, INK, -1, cv2.LINE_AA, 4)
    found = Detector(Params.preset("balanced")).detect(image)
    assert len(found) > 40
    assert found.share_in_rows is not None and found.share_in_rows < 1 / 3
    assert "no print" in repr(found)
