"""Discs drawn with NumPy alone under typical imaging conditions, and detection by plain OpenCV.

A pixel's darkness is the fraction covered by a disc, sampled 8 x 8. Lens blur, illumination, dirt and noise
are added. No renderer of the project is used, and the truth is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

import gelstereo

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Find = Callable[[Image], Array]

SIZE_PX = (640, 480)
SIDE = 25
F_PX, BASELINE_MM, SURFACE_MM = 500.0, 6.0, 28.0
SAMPLES = 8


@dataclass(frozen=True)
class Condition:
    """Differences of images from a clean print in even illumination."""

    contrast_levels: float = 110.0
    gel_level: float = 170.0
    noise_levels: float = 2.0
    pitch_mm: float = 0.92
    radius_mm: float = 0.22
    turn_deg: float = 0.0
    #: Ratio of long to short axis, in random directions.
    ellipse: float = 1.0
    #: Relative standard deviation of radii; deviations are limited to 1.7 standard deviations.
    radius_jitter: float = 0.0
    #: Fraction of the light at the far side; it is lower still in the corners.
    far_light: float = 1.0
    smears: int = 0
    dust: int = 0
    tray: bool = False
    jpeg_quality: int | None = None


CONDITIONS: dict[str, Condition] = {
    "clean": Condition(),
    "contrast 25": Condition(contrast_levels=25.0),
    "contrast 25, tray": Condition(contrast_levels=25.0, tray=True),
    "tray": Condition(tray=True),
    "uneven light": Condition(far_light=0.25),
    "uneven light, tray": Condition(far_light=0.25, tray=True),
    "six smears": Condition(smears=6),
    "six smears, tray": Condition(smears=6, tray=True),
    "ellipses": Condition(ellipse=1.2),
    "JPEG 50": Condition(jpeg_quality=50),
    "dust": Condition(dust=60),
    "radius jitter": Condition(radius_jitter=0.2),
    "straight, dense": Condition(pitch_mm=0.75, radius_mm=0.18),
    "45 degrees, dense": Condition(pitch_mm=0.75, radius_mm=0.18, turn_deg=45.0),
}


@dataclass(frozen=True)
class Print:
    """A print under one condition, seen by two cameras."""

    condition: Condition = field(default_factory=Condition)
    seed: int = 1
    rig: gelstereo.Rig = field(default_factory=lambda: gelstereo.Rig.parallel(SIZE_PX, F_PX, BASELINE_MM))

    def params(self, preset: str) -> gelstereo.Params:
        """Settings for this print."""
        lattice = {
            "lattice.rows": SIDE,
            "lattice.cols": SIDE,
            "lattice.pitch_mm": self.condition.pitch_mm,
        }
        return gelstereo.Params.preset(preset).replace(lattice)

    def markers_mm(self, moved_mm: tuple[float, float] = (0.0, 0.0), press_mm: float = 0.0) -> Array:
        """Markers row by row, the print moved sideways and pressed in its middle, in the left
        camera's frame.
        """
        steps = (np.arange(SIDE) - (SIDE - 1) / 2) * self.condition.pitch_mm
        y, x = np.meshgrid(steps, steps, indexing="ij")
        turn = np.deg2rad(self.condition.turn_deg)
        x, y = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
        z = SURFACE_MM - press_mm * np.exp(-(x**2 + y**2) / (2 * 2.5**2))
        x = x + BASELINE_MM / 2 + moved_mm[0]
        return np.stack([x.ravel(), (y + moved_mm[1]).ravel(), z.ravel()], axis=1)

    def pair(self, points_mm: Array, frame: int) -> tuple[Image, Image]:
        """Left and right image; noise differs from frame to frame."""
        left_px, right_px = self.rig.project(points_mm)
        return self._view(left_px, points_mm[:, 2], frame, 0), self._view(right_px, points_mm[:, 2], frame, 1)

    def _view(self, at_px: Array, depth_mm: Array, frame: int, view: int) -> Image:
        condition = self.condition
        covered = self._covered(at_px, F_PX / depth_mm)
        if condition.dust:
            covered = np.maximum(covered, self._dust())
        blurred = cv2.GaussianBlur(covered, (0, 0), 0.7)
        levels = condition.gel_level - condition.contrast_levels * blurred
        levels = levels * self._light()
        if condition.tray:
            levels = with_tray(levels, *self._gel_px(view))
        levels = levels + self._smears(view)
        noise = np.random.default_rng([self.seed, frame, view]).normal(
            0.0, condition.noise_levels, levels.shape
        )
        image = np.clip(np.rint(levels + noise), 0, 255).astype(np.uint8)
        if condition.jpeg_quality is None:
            return image
        coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, condition.jpeg_quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)

    def _covered(self, at_px: Array, px_per_mm: Array) -> Array:
        """Fraction of every pixel covered by a disc."""
        condition = self.condition
        rng = np.random.default_rng([self.seed, 101])
        spread = np.clip(rng.normal(0.0, 1.0, len(at_px)), -1.7, 1.7)
        radii = condition.radius_mm * px_per_mm * (1.0 + condition.radius_jitter * spread)
        turns, long = rng.uniform(0.0, np.pi, len(at_px)), np.sqrt(condition.ellipse)
        covered = np.zeros(SIZE_PX[::-1])
        for (u, v), radius, turn in zip(at_px, radii, turns, strict=True):
            add_disc(covered, (u, v), (radius * long, radius / long), turn)
        return covered

    def _light(self) -> Array:
        """Light falls off linearly to one side, and toward the corners."""
        far = self.condition.far_light
        x, y = (np.arange(n) / (n - 1) for n in SIZE_PX)
        to_side = 1.0 - (1.0 - far) * x[None, :]
        from_middle = (x[None, :] - 0.5) ** 2 + (y[:, None] - 0.5) ** 2
        return np.asarray(to_side * (1.0 - (1.0 - far) * from_middle))

    def _smears(self, view: int) -> Array:
        """Opaque streaks of reflected light, at different places in each view."""
        x, y = np.meshgrid(*(np.arange(n, dtype=float) for n in SIZE_PX))
        low, high = self._gel_px(view)
        rng = np.random.default_rng([self.seed, 202, view])
        light = np.zeros(SIZE_PX[::-1])
        for _ in range(self.condition.smears):
            u, v = rng.uniform(low + 30.0, high - 30.0)
            turn, length, width = rng.uniform(0, np.pi), rng.uniform(20, 45), rng.uniform(5, 9)
            along = (x - u) * np.cos(turn) + (y - v) * np.sin(turn)
            across = (y - v) * np.cos(turn) - (x - u) * np.sin(turn)
            light += 200.0 * np.exp(-0.5 * ((along / length) ** 4 + (across / width) ** 2))
        return light

    def _dust(self) -> Array:
        """Dark specks, at the same places in all frames."""
        rng = np.random.default_rng([self.seed, 303])
        covered = np.zeros(SIZE_PX[::-1])
        low, high = self._gel_px(0)
        for _ in range(self.condition.dust):
            radius, shape = rng.uniform(0.8, 2.5), rng.uniform(1.0, 1.6)
            add_disc(
                covered,
                tuple(rng.uniform(low, high)),
                (radius * shape, radius / shape),
                rng.uniform(0, np.pi),
            )
        return covered

    def _gel_px(self, view: int) -> tuple[Array, Array]:
        at = self.rig.project(self.markers_mm())[view]
        return at.min(axis=0) - 15.0, at.max(axis=0) + 15.0


def add_disc(covered: Array, at_px: tuple[float, float], axes_px: tuple[float, float], turn: float) -> None:
    """Add an ellipse; pixel centres have integer coordinates."""
    reach = int(max(axes_px)) + 2
    u0, v0 = round(at_px[0]) - reach, round(at_px[1]) - reach
    size = 2 * reach + 1
    rows, cols = slice(max(v0, 0), v0 + size), slice(max(u0, 0), u0 + size)
    part = covered[rows, cols]
    if part.size == 0:
        return
    fine = (np.arange(size * SAMPLES) + 0.5) / SAMPLES - 0.5
    dx, dy = np.meshgrid(fine + u0 - at_px[0], fine + v0 - at_px[1])
    along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
    inside = ((along / axes_px[0]) ** 2 + (across / axes_px[1]) ** 2 <= 1.0).astype(float)
    share = inside.reshape(size, SAMPLES, size, SAMPLES).mean(axis=(1, 3))
    share = share[rows.start - v0 :, cols.start - u0 :][: part.shape[0], : part.shape[1]]
    np.maximum(part, share, out=part)


def with_tray(levels: Array, low: Array, high: Array) -> Array:
    """Add a dark tray around the gel, and a bright frame around the tray."""
    x, y = np.arange(SIZE_PX[0])[None, :], np.arange(SIZE_PX[1])[:, None]
    inside = np.minimum(np.minimum(x - low[0], high[0] - x), np.minimum(y - low[1], high[1] - y))
    wall = 1.0 / (1.0 + np.exp(-inside / 1.5))
    levels = 40.0 + (levels - 40.0) * wall
    return np.where(inside < -45.0, 200.0, levels)


def opencv_centres(image: Image) -> Array:
    """Detection by plain OpenCV, with one recipe for all conditions.

    The background is the morphological closing of the image by an ellipse wider than a disc. A pixel belongs
    to a disc if it is darker than the background by 0.45 of the local contrast and by 5 standard deviations
    of the noise. Components are filtered by area and fill relative to the median; centres are weighted by
    contrast.
    """
    smooth = cv2.GaussianBlur(image, (3, 3), 0).astype(np.float32)
    gel = cv2.GaussianBlur(
        cv2.morphologyEx(
            cv2.GaussianBlur(image, (5, 5), 0),
            cv2.MORPH_CLOSE,
            cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (17, 17)),
        ).astype(np.float32),
        (9, 9),
        0,
    )
    depth = np.maximum(gel - smooth, 0.0)
    residual = image.astype(np.float32) - cv2.medianBlur(image, 3)
    noise = 0.5 * (1.4826 * float(np.median(np.abs(residual[residual != 0]))) if residual.any() else 1.0)
    around = cv2.dilate(depth, np.ones((25, 25), np.uint8))
    mask = (depth > np.maximum(0.45 * around, max(5.0 * noise, 4.0))).astype(np.uint8)
    count, _, stats, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8)
    stats, centroids = stats[1:count], centroids[1:count]
    area = stats[:, cv2.CC_STAT_AREA]
    box = stats[:, cv2.CC_STAT_WIDTH] * stats[:, cv2.CC_STAT_HEIGHT]
    height, width = image.shape
    whole = (stats[:, 0] > 0) & (stats[:, 1] > 0)
    whole &= (stats[:, 0] + stats[:, 2] < width) & (stats[:, 1] + stats[:, 3] < height)
    shaped = whole & (area >= 8) & (area <= 400) & (area > 0.6 * box)
    aspect = stats[:, 2] / np.maximum(stats[:, 3], 1)
    shaped &= (aspect > 0.6) & (aspect < 1.0 / 0.6)
    if not shaped.any():
        return np.empty((0, 2))
    usual = np.median(area[shaped])
    keep = shaped & (area > 0.45 * usual) & (area < 2.0 * usual)
    return np.array([weighted(depth, centre, float(usual)) for centre in centroids[keep]]).reshape(-1, 2)


def weighted(depth: npt.NDArray[np.float32], centre: Array, area_px2: float) -> Array:
    """Mean of the pixels about a disc, weighted by their contrast between a fifth and seven tenths of the
    largest.
    """
    reach = int(np.sqrt(area_px2 / np.pi) + 2.5)
    u, v = np.rint(centre).astype(int)
    rows, cols = slice(max(v - reach, 0), v + reach + 1), slice(max(u - reach, 0), u + reach + 1)
    part = depth[rows, cols]
    largest = float(part.max())
    weight = np.clip(part - 0.2 * largest, 0.0, 0.5 * largest)
    x, y = np.arange(part.shape[1]) + cols.start, np.arange(part.shape[0]) + rows.start
    total = max(float(weight.sum()), 1e-9)
    return np.array([(weight * x).sum() / total, (weight * y[:, None]).sum() / total])
