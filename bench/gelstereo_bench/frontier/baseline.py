"""The paper's sensing pipeline in plain OpenCV, NumPy and SciPy: the baseline, and the tests' independent
reference.

It shares no code with the core. Every function takes its settings as arguments, so that defaults are defined
in one place (`gelstereo.Params`). `Baseline` combines the functions as in section III of the paper.
Registration is in `baseline_register`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo.extras import needs

with needs(__name__):
    from scipy.spatial import cKDTree

__all__ = [
    "Baseline",
    "BaselineFrame",
    "StereoGeometry",
    "binary_centroids",
    "darker_than_surround",
    "foresight_sort",
    "grey_centroids",
    "indentation_mm",
    "nearest_within_gate",
    "simple_blobs",
    "triangulate_q",
]

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]


# Detection (section III-A, Fig. 5)


def darker_than_surround(
    image: Image, *, smooth_kernel_px: int, background_kernel_px: int, bright: bool = False, box: bool = False
) -> Image:
    """Contrast of every pixel to its local background, 0 to 255: a difference of Gaussians.

    With ``box`` the background is the mean over a square instead.
    """
    smooth = cv2.GaussianBlur(image, (smooth_kernel_px, smooth_kernel_px), 0)
    kernel = (background_kernel_px, background_kernel_px)
    background = cv2.blur(image, kernel) if box else cv2.GaussianBlur(image, kernel, 0)
    difference = cv2.subtract(smooth, background) if bright else cv2.subtract(background, smooth)
    return np.asarray(difference, np.uint8)


def _marker_components(
    difference: Image,
    *,
    threshold_levels: int,
    morphology_kernel_px: int,
    min_area_px2: int,
    max_area_px2: int,
    min_fill: float,
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], Array, npt.NDArray[np.intp]]:
    """Label image, statistics and centroids of all components, and the labels of those that are markers."""
    mask = (difference >= threshold_levels).astype(np.uint8)
    if morphology_kernel_px > 1:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (morphology_kernel_px, morphology_kernel_px))
        mask = np.asarray(cv2.erode(cv2.dilate(mask, kernel), kernel), np.uint8)
    _, labels, statistics, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8)
    area = statistics[:, cv2.CC_STAT_AREA]
    inscribed = np.pi / 4.0 * statistics[:, cv2.CC_STAT_WIDTH] * statistics[:, cv2.CC_STAT_HEIGHT]
    marker = (area >= min_area_px2) & (area <= max_area_px2) & (area >= min_fill * inscribed)
    marker[0] = False  # the background
    return (
        np.asarray(labels, np.int32),
        np.asarray(statistics, np.int32),
        np.asarray(centroids, np.float64),
        np.flatnonzero(marker),
    )


def binary_centroids(difference: Image, **settings: Any) -> Array:
    """Centres (N, 2) as the mean positions of components' pixels.

    Settings: ``threshold_levels``, ``morphology_kernel_px``, ``min_area_px2``, ``max_area_px2``,
    ``min_fill``.
    """
    _, _, centroids, markers = _marker_components(difference, **settings)
    return np.asarray(centroids[markers], np.float64)


def grey_centroids(difference: Image, *, border_px: int = 2, **settings: Any) -> Array:
    """Centres (N, 2) weighted by contrast over each component and a border around it.

    Pixels of other components have no weight. Settings as `binary_centroids`.
    """
    labels, _, _, markers = _marker_components(difference, **settings)
    # Every component is dilated by the border; dots are far enough apart that components do not merge.
    kernel = np.ones((2 * border_px + 1, 2 * border_px + 1), np.uint8)
    grown = np.asarray(cv2.dilate(labels.astype(np.float32), kernel))
    y, x = np.nonzero(grown)
    owner = grown[y, x].astype(np.intp)
    weight = np.where((labels[y, x] == 0) | (labels[y, x] == owner), difference[y, x], 0).astype(float)
    total, of_x, of_y = (np.bincount(owner, weight * values) for values in (1.0, x, y))
    return np.column_stack([of_x[markers] / total[markers], of_y[markers] / total[markers]])


def simple_blobs(difference: Image, *, threshold_levels: int, min_area_px2: int, max_area_px2: int) -> Array:
    """Centres (N, 2) by OpenCV's SimpleBlobDetector on the thresholded difference."""
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 100.0, 200.0, 50.0
    parameters.minRepeatability = 1
    parameters.minDistBetweenBlobs = 3.0
    parameters.filterByArea, parameters.minArea, parameters.maxArea = (
        True,
        float(min_area_px2),
        float(max_area_px2),
    )
    parameters.filterByColor, parameters.blobColor = True, 255
    parameters.filterByCircularity = parameters.filterByInertia = parameters.filterByConvexity = False
    mask = (difference >= threshold_levels).astype(np.uint8) * 255
    points = cv2.SimpleBlobDetector_create(parameters).detect(mask)
    return np.array([point.pt for point in points], np.float64).reshape(-1, 2)


# Tracking (Eq. 2)


def nearest_within_gate(
    tracks_px: Array, detected_px: Array, gate_px: float
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Eq. 2: every track (N, 2) takes its nearest detection if that lies within the gate.

    Returns the updated tracks and a mask of those seen. A detection claimed by several tracks goes to the
    nearest one.
    """
    if len(detected_px) == 0:
        return tracks_px.copy(), np.zeros(len(tracks_px), bool)
    distance, nearest = cKDTree(detected_px).query(tracks_px)
    claimed_by = cKDTree(tracks_px).query(detected_px)[1]
    seen = (distance < gate_px) & (claimed_by[nearest] == np.arange(len(tracks_px)))
    updated = np.where(seen[:, None], detected_px[nearest], tracks_px)
    return updated, seen


# Labels (Algorithm 1)


def foresight_sort(positions_px: Array, cols: int, tolerance_px: float) -> npt.NDArray[np.intp] | None:
    """Algorithm 1: the permutation that sorts markers (N, 2) row by row from left to right.

    Errors in the printed algorithm are corrected by its text: loops start at the first element, and every
    row, including the last, is ordered by abscissa. ``None`` if a row does not fill, where the printed
    algorithm continues silently.
    """
    x = positions_px[:, 0].tolist()
    remaining = np.lexsort((positions_px[:, 0], positions_px[:, 1])).tolist()
    order: list[int] = []
    while len(remaining) > cols:
        row: list[int] = []
        for index in remaining[: 2 * cols]:
            if all(abs(x[index] - x[other]) >= tolerance_px for other in row):
                row.append(index)
                if len(row) == cols:
                    break
        if len(row) < cols:
            return None
        taken = set(row)
        remaining = [index for index in remaining if index not in taken]
        order += sorted(row, key=x.__getitem__)
    if len(remaining) != cols:
        return None
    return np.array(order + sorted(remaining, key=x.__getitem__), np.intp)


# Triangulation (Eq. 3)


@dataclass(frozen=True)
class StereoGeometry:
    """A rig in OpenCV's terms."""

    left_matrix: Array
    left_distortion: Array
    right_matrix: Array
    right_distortion: Array
    r_right_left: Array
    t_right_left_mm: Array
    size_px: tuple[int, int]

    @classmethod
    def from_rig_table(cls, rig: Mapping[str, Any]) -> StereoGeometry:
        """Create from the parsed TOML of a rig file."""

        def camera(table: Mapping[str, Any]) -> tuple[Array, Array]:
            matrix = np.array(
                [
                    [table["fx_px"], 0.0, table["cx_px"]],
                    [0.0, table["fy_px"], table["cy_px"]],
                    [0.0, 0.0, 1.0],
                ]
            )
            return matrix, np.array(table.get("distortion", [0.0] * 5), float)

        t_right_left = np.array(rig["t_right_left"], float)
        return cls(
            *camera(rig["left"]),
            *camera(rig["right"]),
            t_right_left[:3, :3],
            t_right_left[:3, 3],
            (int(rig["left"]["width_px"]), int(rig["left"]["height_px"])),
        )

    def rectification(self) -> tuple[Array, Array, Array, Array, Array]:
        """OpenCV's rotations and projections of both views, and Q."""
        result = cv2.stereoRectify(
            self.left_matrix,
            self.left_distortion,
            self.right_matrix,
            self.right_distortion,
            self.size_px,
            self.r_right_left,
            self.t_right_left_mm.reshape(3, 1),
        )[:5]
        r_left, r_right, p_left, p_right, q = (np.asarray(a, np.float64) for a in result)
        return r_left, r_right, p_left, p_right, q


def triangulate_q(q: Array, left_px: Array, right_px: Array) -> Array:
    """Eq. 3: points (N, 3) of rectified pixels (N, 2), with the signed disparity x_left - x_right."""
    disparity = left_px[:, 0] - right_px[:, 0]
    homogeneous = np.column_stack([left_px, disparity, np.ones(len(left_px))]) @ q.T
    return np.asarray(homogeneous[:, :3] / homogeneous[:, 3:], np.float64)


# Contact (Eq. 4)


def indentation_mm(points_mm: Array, rest_mm: Array) -> Array:
    """Height (N,) of points (N, 3) above their rest positions, along the rest plane's normal towards the
    camera.
    """
    normal = np.linalg.svd(rest_mm - rest_mm.mean(axis=0), full_matrices=False)[2][2]
    normal = normal if normal[2] < 0.0 else -normal
    return np.asarray((points_mm - rest_mm) @ normal, np.float64)


# The pipeline


@dataclass(frozen=True)
class BaselineFrame:
    """Results of one stereo frame; marker ``row * cols + col`` has that index."""

    left_px: Array
    right_px: Array
    seen: npt.NDArray[np.bool_]
    points_mm: Array
    salient: npt.NDArray[np.bool_]
    motion_px: float


class Baseline:
    """Sections III and IV-A of the paper; the first frame must show all markers untouched."""

    def __init__(
        self,
        geometry: StereoGeometry,
        params: Mapping[str, Any],
        lattice: tuple[int, int] = (25, 25),
        box: bool = False,
    ) -> None:
        """Create the pipeline.

        ``params``: the parsed TOML of `gelstereo.Params`; ``lattice``: rows and columns; ``box``: whether the
        local background is the mean over a square.
        """
        self._box = box
        self._rows, self._cols = lattice
        self._geometry = geometry
        self._params = params
        self._r_left, self._r_right, self._p_left, self._p_right, self._q = geometry.rectification()
        self._tracks: dict[str, Array] = {}
        self._rest_px = np.empty((0, 2))
        self._rest_mm = np.empty((0, 3))

    def detect(self, image: Image) -> Array:
        """Centres of one view."""
        detect = self._params["detect"]
        difference = darker_than_surround(
            image,
            smooth_kernel_px=detect["smooth_kernel_px"],
            background_kernel_px=detect["background_kernel_px"],
            bright=detect["polarity"] == "bright",
            box=self._box,
        )
        names = ("threshold_levels", "morphology_kernel_px", "min_area_px2", "max_area_px2", "min_fill")
        centroids = grey_centroids if detect["centre"] == "grey" else binary_centroids
        return centroids(difference, **{name: detect[name] for name in names})

    def process(self, left: Image, right: Image) -> BaselineFrame:
        """Run all stages on one stereo frame.

        Raises
        ------
        ValueError
            The first frame does not show all markers, or a row cannot be sorted.
        """
        first = not self._tracks
        views = {"left": left, "right": right}
        seen = np.ones(self._markers(), bool)
        for view, image in views.items():
            detected = self.detect(image)
            if len(detected) == self._markers():
                self._tracks[view] = detected[self._sort(detected, view)]
            elif first:
                raise ValueError(
                    f"{len(detected)} of {self._markers()} markers in the {view} view's first frame"
                )
            else:
                gate_px = self._params["track"]["gate_pitches"] * _pitch_px(self._tracks[view])
                tracks, seen_here = nearest_within_gate(self._tracks[view], detected, gate_px)
                order = self._sort(tracks, view)
                self._tracks[view], seen = tracks[order], seen & seen_here[order]
        points_mm = self.triangulate(self._tracks["left"], self._tracks["right"])
        if first:
            self._rest_px, self._rest_mm = self._tracks["left"].copy(), points_mm
        salient = indentation_mm(points_mm, self._rest_mm) > self._params["contact"]["saliency_mm"]
        motion_px = np.linalg.norm(self._tracks["left"] - self._rest_px, axis=1)
        return BaselineFrame(
            self._tracks["left"],
            self._tracks["right"],
            seen,
            points_mm,
            salient & seen,
            float(motion_px[seen].mean()) if seen.any() else 0.0,
        )

    def _markers(self) -> int:
        return self._rows * self._cols

    def _sort(self, positions_px: Array, view: str) -> npt.NDArray[np.intp]:
        tolerance_px = self._params["label"]["tolerance_pitches"] * _pitch_px(positions_px)
        order = foresight_sort(positions_px, self._cols, tolerance_px)
        if order is None:
            raise ValueError(f"a row of the {view} view does not fill")
        return order

    def triangulate(self, left_px: Array, right_px: Array) -> Array:
        """Points in the left camera's frame: undistort, rectify, apply Q, and undo the left rectifying
        rotation.
        """
        geometry = self._geometry
        left = cv2.undistortPoints(
            left_px[:, None], geometry.left_matrix, geometry.left_distortion, R=self._r_left, P=self._p_left
        )
        right = cv2.undistortPoints(
            right_px[:, None],
            geometry.right_matrix,
            geometry.right_distortion,
            R=self._r_right,
            P=self._p_right,
        )
        points = triangulate_q(self._q, np.asarray(left, float)[:, 0], np.asarray(right, float)[:, 0])
        return np.asarray(points @ self._r_left, np.float64)


def _pitch_px(positions_px: Array) -> float:
    """Median distance of nearest neighbours."""
    return float(np.median(cKDTree(positions_px).query(positions_px, k=2)[0][:, 1]))
