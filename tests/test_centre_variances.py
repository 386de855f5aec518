"""What detection says of its own errors, on dots drawn without the project's renderers: exact
areas, blurred.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import pytest

import gelstereo

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

PRESETS = ("fast", "balanced", "exact")
SIDE = 24
OVERSAMPLED = 8
GEL, DOT = 170.0, 30.0


@dataclass(frozen=True)
class Print:
    """Dots on a lattice, each up to half a pixel off its place, in the middle of an image of grey gel."""

    radius_px: float = 4.0
    blur_px: float = 0.8
    pitch_px: float = 17.0
    margin_px: int = 60
    seed: int = 0

    def centres_px(self) -> Floats:
        """(N, 2) centres."""
        random = np.random.default_rng(self.seed)
        places = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2)
        off = random.uniform(-0.5, 0.5, (SIDE * SIDE, 2))
        return np.asarray(self.margin_px + self.pitch_px * (places + 0.5) + off)

    def levels(self) -> Floats:
        """Grey levels without noise: the mean over each pixel's area of the blurred print."""
        size = int(2 * self.margin_px + self.pitch_px * SIDE)
        fine = np.ones((size * OVERSAMPLED, size * OVERSAMPLED), dtype=np.float32)
        reach = int((self.radius_px + 2) * OVERSAMPLED)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        for centre in self.centres_px():
            column, row = np.rint((centre + 0.5) * OVERSAMPLED - 0.5).astype(int)
            along = (column + x + 0.5) / OVERSAMPLED - 0.5 - centre[0]
            down = (row + y + 0.5) / OVERSAMPLED - 0.5 - centre[1]
            outside_px = np.hypot(along, down) - self.radius_px
            fine[row + y, column + x] -= np.clip(0.5 - outside_px * OVERSAMPLED, 0, 1)
        if self.blur_px > 0:
            fine = cv2.GaussianBlur(fine, (0, 0), self.blur_px * OVERSAMPLED)
        shares = fine.reshape(size, OVERSAMPLED, size, OVERSAMPLED).mean(axis=(1, 3))
        return np.asarray(DOT + (GEL - DOT) * shares, dtype=float)


def noisy(levels: Floats, sigma: float, seed: int = 9) -> Image:
    """With white noise, in whole levels."""
    noise = np.random.default_rng(seed).normal(0, sigma, levels.shape)
    return np.clip(np.rint(levels + noise), 0, 255).astype(np.uint8)


def matched(found: gelstereo.Markers, centres_px: Floats) -> tuple[Floats, Floats, npt.NDArray[np.int64]]:
    """Errors (N, 2) and covariances (N, 2, 2) of markers within 3 px of a true centre, and whose they are."""
    far = np.linalg.norm(found.centres_px[:, None] - centres_px[None], axis=2)
    whose, close = far.argmin(axis=1), far.min(axis=1) < 3.0
    errors = (found.centres_px - centres_px[whose])[close]
    return errors, found.covariance_px2[close], whose[close]


def squared_errors(errors: Floats, covariances: Floats) -> Floats:
    """Normalised squared error of each marker: 1 in the mean where the covariance is right."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.asarray((errors * solved).sum(axis=1) / 2)


def surrounded(levels: Floats, kind: str, print_: Print) -> Floats:
    """The same print with something else than gel beside it."""
    out = levels.copy()
    size, margin = len(out), print_.margin_px
    y, x = np.mgrid[:size, :size].astype(float)
    if kind == "tray":
        beside = x < margin - 8
        out[beside] = (90 + 50 * np.sin(x / 4.1 + y / 19) + 15 * np.sin(x / 1.2 - y / 7))[beside]
    elif kind == "frame":
        beside = (np.abs(x - size / 2) > size / 2 - margin + 10) | (
            np.abs(y - size / 2) > size / 2 - margin + 10
        )
        out[beside] = np.where((x + y) % 14 < 7, 200.0, 20.0)[beside]
    else:
        # Light that falls off at a wall, over this many pixels.
        out /= 1 + np.exp(-(x - (margin - 12)) / float(kind))
    return out


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("kind", ["tray", "frame", "1", "3", "5", "8"])
def test_row_42_what_lies_around_the_lattice_is_no_noise(preset: str, kind: str) -> None:
    """Stated variances are those of the same print on gel without end, and they hold."""
    print_ = Print()
    levels, centres = print_.levels(), print_.centres_px()
    detector = gelstereo.Detector(gelstereo.Params.preset(preset))
    alone = np.median(detector.detect(noisy(levels, 2.0)).covariance_px2[:, 0, 0])
    found = gelstereo.Detector(gelstereo.Params.preset(preset)).detect(
        noisy(surrounded(levels, kind, print_), 2.0)
    )
    errors, covariances, whose = matched(found, centres)
    # The outermost columns stand in the light that falls off.
    inner = (whose % SIDE > 1) & (whose % SIDE < SIDE - 2) & (whose // SIDE > 1) & (whose // SIDE < SIDE - 2)
    assert inner.sum() >= 0.99 * (SIDE - 4) ** 2
    ratio = np.median(covariances[inner][:, 0, 0]) / alone
    # Noise from 10 000 pairs is known to 2 %, faint grain adds a tenth.
    assert 0.8 < ratio < 1.25, ratio
    assert 0.7 < squared_errors(errors[inner], covariances[inner]).mean() < 1.4


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("blur_px", [0.0, 0.2, 0.35, 0.5, 0.8, 1.1])
def test_row_43_a_sharp_lens_is_part_of_the_variance(preset: str, blur_px: float) -> None:
    """Outlines that begin and end within a pixel tell less of the centre than their noise says.

    Radii are mixed, as in any print: at one radius errors by the grid may cancel or add up.
    """
    squared = []
    for radius_px in (2.7, 3.6, 4.3, 5.1, 6.0):
        print_ = Print(radius_px=radius_px, blur_px=blur_px, pitch_px=max(17.0, 3.6 * radius_px))
        found = gelstereo.Detector(gelstereo.Params.preset(preset)).detect(noisy(print_.levels(), 0.7))
        errors, covariances, whose = matched(found, print_.centres_px())
        assert len(whose) == SIDE * SIDE
        squared.append(squared_errors(errors, covariances).mean())
    # Errors by the grid are known to half of their variance. Dots off their places by 2 % of the pitch, twice
    # the error of a stencil, may be folds: that takes up to 0.15.
    assert 0.55 < np.mean(squared) < 1.6, squared


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("size_px", [(7, 12), (16, 9), (22, 22)])
def test_row_44_markers_under_a_light_say_so(preset: str, size_px: tuple[int, int]) -> None:
    """A reflection that saturates the sensor hides parts of markers: the others are as certain as before."""
    print_ = Print()
    levels, centres = print_.levels(), print_.centres_px()
    hidden = np.zeros(levels.shape, dtype=np.float32)
    random, (wide, high) = np.random.default_rng(4), size_px
    for x, y in random.uniform(100, len(levels) - 120, (40, 2)).astype(int):
        hidden[y : y + high, x : x + wide] = 1.0
    shares = cv2.GaussianBlur(hidden, (0, 0), print_.blur_px)
    image = noisy(levels * (1 - shares) + 300 * shares, 2.0)
    found = gelstereo.Detector(gelstereo.Params.preset(preset)).detect(image)
    errors, covariances, whose = matched(found, centres)
    spread = cv2.dilate(hidden, np.ones((21, 21), np.uint8))
    lit = spread[tuple(np.rint(centres[whose]).astype(int)[:, ::-1].T)] > 0
    squared = squared_errors(errors, covariances)
    assert lit.sum() > 20
    # By their areas it is known to half of itself how much is hidden; without that the mean is up to 500.
    assert squared[lit].mean() < 4.0
    assert 0.7 < squared[~lit].mean() < 1.4


def test_a_region_of_interest_is_searched_alone() -> None:
    """Its markers are those of the cropped image, in the whole image's pixels; spots beside it
    are not found.
    """
    print_ = Print()
    levels = surrounded(print_.levels(), "frame", print_)
    image, (x, y, width, height) = noisy(levels, 2.0), (50, 52, 440, 430)
    settings = {"detect.roi.left_px": [x, y, width, height]}
    params = gelstereo.Params.preset("balanced").replace(settings)
    found = gelstereo.Detector(params, view="left").detect(image)
    crop = np.ascontiguousarray(image[y : y + height, x : x + width])
    expected = gelstereo.Detector(gelstereo.Params.preset("balanced")).detect(crop)
    assert np.array_equal(found.centres_px, expected.centres_px + [x, y])
    # Second differences of positions that are shifted differ by round-off.
    assert np.allclose(found.covariance_px2, expected.covariance_px2, rtol=1e-9, atol=0.0)
    assert np.array_equal(found.cut_centres_px, expected.cut_centres_px + [x, y])
    mask = gelstereo.Detector(params, view="left").mask(image)
    assert mask.shape == image.shape and mask[:y].sum() == 0 and mask[:, x + width :].sum() == 0
    assert mask.any()
    # The right view has no region of interest here.
    assert len(gelstereo.Detector(params, view="right").detect(image)) >= len(found)


def test_a_region_of_interest_lies_within_the_image() -> None:
    params = gelstereo.Params.preset("fast").replace({"detect.roi.right_px": [600, 0, 100, 100]})
    image = np.full((480, 640), 150, dtype=np.uint8)
    with pytest.raises(
        gelstereo.DetectError, match=r"begins at \(600, 0\) and is 100 x 100 pixels.*640 x 480"
    ):
        gelstereo.Detector(params, view="right").detect(image)
    with pytest.raises(gelstereo.Error, match=r"right.*640 x 480"):
        gelstereo.Pipeline(gelstereo.Scene().rig, params)
    with pytest.raises(gelstereo.ParamsError, match=r"detect\.roi\.left_px"):
        gelstereo.Params.preset("fast").replace({"detect.roi.left_px": [0, 0, 0, 5]})
    with pytest.raises(ValueError, match="'left' and 'right'"):
        gelstereo.Detector(params, view="middle")  # type: ignore[arg-type]
