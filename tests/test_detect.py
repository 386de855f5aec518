"""Detection against the same method in OpenCV, and hard case 30: images that are none, or have nothing to
show.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from gelstereo import DetectError, Detector, Error, ImageError, Params, Rig, SimulatedFrame

PAPER = Params.preset("paper")


def opencv_centres(image: np.ndarray, threshold: int) -> tuple[np.ndarray, np.ndarray]:
    """The paper's detection, section III-B: difference of Gaussians, threshold, components, centroids."""
    smooth = cv2.GaussianBlur(image.astype(np.float64), (3, 3), 0)
    surround = cv2.GaussianBlur(image.astype(np.float64), (51, 51), 0)
    mask = (surround - smooth >= threshold).astype(np.uint8)
    _, _, stats, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8)
    area = stats[1:, cv2.CC_STAT_AREA]
    low, high = stats[1:, :2], stats[1:, :2] + stats[1:, 2:4]
    whole = (low > 0).all(axis=1) & (high < [image.shape[1], image.shape[0]]).all(axis=1)
    keep = whole & (area >= 6) & (area <= 2000)
    return centroids[1:][keep], area[keep]


def test_centres_are_opencvs(noisy_press: list[SimulatedFrame]) -> None:
    detector = Detector(PAPER)
    for frame in noisy_press:
        found = detector.detect(frame.left)
        centres, area = opencv_centres(frame.left, 35)
        assert len(found) == len(centres) == 625
        order = [int(np.argmin(np.linalg.norm(centres - c, axis=1))) for c in found.centres_px]
        assert sorted(order) == list(range(625))
        # Fixed-point filters are within 1/64 of a level, so that only pixels on the very threshold may
        # differ: a marker has 40 pixels, 1/64 level is crossed by few of them, and one pixel at 4 px moves a
        # centroid by 0.1.
        differing = found.area_px2.astype(int) != area[order]
        assert differing.mean() < 0.02
        assert np.abs(found.centres_px - centres[order])[~differing].max() < 1e-9
        assert np.abs(found.centres_px - centres[order]).max() < 0.11


def pictures() -> list[np.ndarray]:
    """Noise, blurred noise and steps: every spatial frequency, and grey levels to both ends."""
    rng = np.random.default_rng(7)
    noise = rng.integers(0, 256, (90, 120), dtype=np.uint8)
    soft = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX)
    steps = np.where(np.indices((90, 120)).sum(axis=0) % 40 < 20, 0, 255).astype(np.uint8)
    return [noise, soft, steps]


@pytest.mark.parametrize("kernels", [(1, 3), (3, 9), (3, 51), (7, 31), (11, 21)])
def test_blur_is_opencvs(kernels: tuple[int, int]) -> None:
    smooth_px, surround_px = kernels
    for image in pictures():
        exact = image.astype(np.float64)
        smooth = cv2.GaussianBlur(exact, (smooth_px, smooth_px), 0)
        difference = cv2.GaussianBlur(exact, (surround_px, surround_px), 0) - smooth
        for threshold in (5, 20, 35, 60):
            params = PAPER.replace(
                detect={
                    "smooth_kernel_px": smooth_px,
                    "background_kernel_px": surround_px,
                    "threshold_levels": threshold,
                }
            )
            mask = Detector(params).mask(image)
            # Each blur is within 1/64 of a level. Farther from the threshold than two of those, and up to the
            # image's border, both must decide alike.
            sure = np.abs(difference - threshold) > 2 / 64
            assert sure.mean() > 0.98
            assert np.array_equal(mask[sure], (difference >= threshold)[sure])


@pytest.mark.parametrize("threshold", [10, 35, 70])
def test_components_are_opencvs(threshold: int) -> None:
    params = PAPER.replace(
        detect={
            "smooth_kernel_px": 3,
            "background_kernel_px": 9,
            "threshold_levels": threshold,
            "min_area_px2": 1,
            "max_area_px2": 1_000_000,
            "min_fill": 0.0,
        }
    )
    detector = Detector(params)
    for image in pictures():
        found, mask = detector.detect(image), detector.mask(image)
        _, _, stats, centroids = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
        low, high = stats[1:, :2], stats[1:, :2] + stats[1:, 2:4]
        whole = (low > 0).all(axis=1) & (high < [image.shape[1], image.shape[0]]).all(axis=1)
        expected = np.column_stack([centroids, stats[:, cv2.CC_STAT_AREA]])[1:][whole]
        ours = np.column_stack([found.centres_px, found.area_px2])
        # OpenCV numbers components in an order of its own. Both centroids are a quotient of whole numbers.
        assert np.allclose(ours[np.lexsort(ours.T)], expected[np.lexsort(expected.T)], rtol=1e-14, atol=0)


@pytest.mark.parametrize(
    ("image", "error", "words"),
    [
        (np.full((48, 64), 128, np.uint8), DetectError, "128"),
        (np.full((48, 64), 255, np.uint8), DetectError, "saturated"),
        (np.zeros((48, 64), np.uint8), DetectError, "black"),
        (np.zeros((1, 640), np.uint8), DetectError, "640"),
        (np.zeros((480, 1), np.uint8), DetectError, "480"),
        (np.zeros((0, 64), np.uint8), ImageError, "at least 1"),
        (np.zeros((48, 64)), ImageError, "float64"),
        (np.zeros((48, 64), np.int8), ImageError, "int8"),
        (np.zeros((48, 64), np.uint16), ImageError, "uint16"),
        (np.zeros((48, 64), bool), ImageError, "bool"),
        (np.zeros((48, 64, 3), np.uint8), DetectError, "black"),
        (np.zeros((48, 64, 2), np.uint8), ImageError, "of blue, green and red"),
        (np.zeros((48, 64, 4), np.uint8), ImageError, "cvtColor"),
        (np.zeros(64, np.uint8), ImageError, r"\(64,\)"),
        ([[1, 2], [3, 4]], ImageError, "list"),
        (None, ImageError, "NoneType"),
    ],
)
def test_row_30_images_without_an_answer(image: object, error: type[Error], words: str) -> None:
    for method in (Detector(PAPER).detect, Detector(PAPER).mask):
        with pytest.raises(error, match=words):
            method(image)  # type: ignore[arg-type]


@pytest.mark.parametrize("preset", Params.presets())
def test_row_30_memory_layout_does_not_matter(noisy_press: list[SimulatedFrame], preset: str) -> None:
    detector = Detector(Params.preset(preset))
    image = noisy_press[-1].left
    assert not image.flags.writeable
    reference = detector.detect(image).centres_px
    wide = np.zeros((480, 1280), np.uint8)
    wide[:, 640:] = image
    spaced = np.zeros((960, 1280), np.uint8)
    spaced[::2, ::2] = image
    flipped = np.ascontiguousarray(image[::-1, ::-1])
    layouts = [wide[:, 640:], spaced[::2, ::2], np.asfortranarray(image), flipped[::-1, ::-1], image.copy()]
    for layout in layouts:
        assert np.array_equal(detector.detect(layout).centres_px, reference)


def test_row_30_markers_on_the_border_are_left_out() -> None:
    image = np.full((120, 160), 170, np.uint8)
    for centre in [(40, 60), (0, 30), (159, 90), (80, 119), (120, 6)]:
        cv2.circle(image, centre, 4, 50, -1)
    found = Detector(PAPER).detect(image)
    assert sorted(map(tuple, np.round(found.centres_px).tolist())) == [(40, 60), (120, 6)]


def test_the_image_is_not_changed(noisy_press: list[SimulatedFrame]) -> None:
    image = noisy_press[0].left.copy()
    before = image.copy()
    Detector().detect(image)
    assert np.array_equal(image, before)


def test_results_are_read_only(noisy_press: list[SimulatedFrame]) -> None:
    found = Detector().detect(noisy_press[0].left)
    for array in (found.centres_px, found.area_px2, Rig.parallel((640, 480), 560, 8).left_matrix):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert found.centres_px is found.centres_px  # made once
