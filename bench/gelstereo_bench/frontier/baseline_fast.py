"""A fast OpenCV implementation: the baseline of the speed tables.

Box background, connected components, grey centroids over windows, nearest neighbours, triangulation with Q.
All loops are OpenCV's and NumPy's, on one thread. Labels are given with the first frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs
from gelstereo_bench.frontier.baseline import (
    Array,
    BaselineFrame,
    Image,
    StereoGeometry,
    indentation_mm,
    nearest_within_gate,
    triangulate_q,
)

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = ["FastBaseline"]


class FastBaseline:
    """Box background, components and grey centroids; tracks by nearest neighbours."""

    def __init__(self, geometry: StereoGeometry, params: Mapping[str, Any]) -> None:
        """``params``: the parsed TOML of `gelstereo.Params`; only this one rung of each stage is
        implemented.
        """
        self._detect = params["detect"]
        self._gate_pitches = params["track"]["gate_pitches"]
        self._saliency_mm = params["contact"]["saliency_mm"]
        self._maps, self._q, self._r_left = self._prepared(geometry)
        self._tracks: list[Array] = []
        self._rest_px = np.empty((0, 2))
        self._rest_mm = np.empty((0, 3))
        self._pitch_px = 0.0

    @staticmethod
    def _prepared(geometry: StereoGeometry) -> tuple[list[dict[str, Any]], Array, Array]:
        """Arguments of cv2.undistortPoints for both views, Q, and the left rectifying rotation."""
        r_left, r_right, p_left, p_right, q = geometry.rectification()
        left = {"cameraMatrix": geometry.left_matrix, "distCoeffs": geometry.left_distortion}
        right = {"cameraMatrix": geometry.right_matrix, "distCoeffs": geometry.right_distortion}
        return [left | {"R": r_left, "P": p_left}, right | {"R": r_right, "P": p_right}], q, r_left

    def detect(self, image: Image) -> Array:
        """Centres (N, 2) of one view."""
        detect = self._detect
        kernel = detect["background_kernel_px"]
        smooth = cv2.GaussianBlur(image, (detect["smooth_kernel_px"],) * 2, 0)
        background = cv2.blur(image, (kernel, kernel))
        dark = detect["polarity"] == "dark"
        difference = cv2.subtract(background, smooth) if dark else cv2.subtract(smooth, background)
        mask = cv2.threshold(difference, detect["threshold_levels"] - 1, 1, cv2.THRESH_BINARY)[1]
        _, _, statistics, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=cv2.CV_16U)
        area = statistics[:, cv2.CC_STAT_AREA]
        inscribed = np.pi / 4.0 * statistics[:, cv2.CC_STAT_WIDTH] * statistics[:, cv2.CC_STAT_HEIGHT]
        good = (area >= detect["min_area_px2"]) & (area <= detect["max_area_px2"])
        good &= area >= detect["min_fill"] * inscribed
        good[0] = False  # the background
        return _refined(difference, centroids[good], area[good])

    def process(self, left: Image, right: Image, names: tuple[Array, Array] | None = None) -> BaselineFrame:
        """Run all stages; ``names``, the positions (N, 2) of all markers in order, restarts tracking."""
        found = [self.detect(image) for image in (left, right)]
        if names is not None:
            self._tracks = [at[cKDTree(at).query(place)[1]] for at, place in zip(found, names, strict=True)]
            self._pitch_px = float(np.median(cKDTree(names[0]).query(names[0], k=2)[0][:, 1]))
        seen = np.ones(len(self._tracks[0]), bool)
        gate_px = self._gate_pitches * self._pitch_px
        for view, detected in enumerate(found):
            self._tracks[view], here = nearest_within_gate(self._tracks[view], detected, gate_px)
            seen &= here
        left_px, right_px = self._tracks
        flat = [
            np.asarray(cv2.undistortPoints(pixels[:, None], **arguments), np.float64)[:, 0]
            for pixels, arguments in zip(self._tracks, self._maps, strict=True)
        ]
        points_mm = np.asarray(triangulate_q(self._q, flat[0], flat[1]) @ self._r_left, np.float64)
        if names is not None:
            self._rest_px, self._rest_mm = left_px.copy(), points_mm
        salient = seen & (indentation_mm(points_mm, self._rest_mm) > self._saliency_mm)
        moved_px = np.linalg.norm(left_px - self._rest_px, axis=1)
        motion_px = float(moved_px[seen].mean()) if seen.any() else 0.0
        return BaselineFrame(left_px, right_px, seen, points_mm, salient, motion_px)


def _refined(difference: Image, centres_px: Array, areas_px2: npt.NDArray[np.int32]) -> Array:
    """Centres weighted by contrast over square windows that hold the largest marker and its
    blurred border.
    """
    if len(centres_px) == 0:
        return centres_px
    reach = int(np.ceil(np.sqrt(np.median(areas_px2) / np.pi) + 2.0))
    offsets = np.arange(-reach, reach + 1)
    padded = cv2.copyMakeBorder(difference, *(reach + 1,) * 4, cv2.BORDER_CONSTANT, value=0)
    corner = np.rint(centres_px).astype(np.intp)
    flat = (corner[:, 1, None] + reach + 1 + offsets) * padded.shape[1]
    index = flat[:, :, None] + (corner[:, 0, None] + reach + 1 + offsets)[:, None, :]
    window = padded.ravel()[index].astype(np.float32)
    columns, rows = window.sum(axis=1), window.sum(axis=2)
    total = columns.sum(axis=1)
    along = offsets.astype(np.float32)
    return np.asarray(corner + np.column_stack([columns @ along / total, rows @ along / total]), np.float64)
