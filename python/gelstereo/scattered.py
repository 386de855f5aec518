"""Stereo sensing with prints of any layout: random dots, hexagonal pins, rectangular lattices, gaps.

`StereoMarkerTracker` gives points in millimetres with covariances, and those in contact, for `localize`.
For a lattice use `Pipeline`, which is faster and names rows and columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import (
    DenseSurface,
    Error,
    MarkerTracker,
    Params,
    RestSurface,
    Rig,
    TrackedMarkers,
    TriangulateError,
    adaptive_saliency,
    pair_views,
    pressure_saliency,
    triangulate,
)
from gelstereo.states import MarkerState

__all__ = ["PairingError", "ScatteredFrame", "StereoMarkerTracker"]

Array = npt.NDArray[np.float64]

#: Step of the numerical derivatives of a point by its pixels, px. Steps from 0.01 to 1 px change no
#: covariance by more than 0.1 % at 560 px of focal length, 8 mm of baseline and 28 mm of depth.
_STEP_PX = 0.1
#: Heights below this many standard deviations are noise.
_SALIENT_SIGMAS = 3.0
#: Step of the grid for contact by pressure, in mean spacings of the markers. On eight drawn prints of 300
#: random dots under a ball, with 183 markers on it, 1.0, 0.7 and 0.5 miss 0, 0 and 2 of them, and take 59, 19
#: and 1 that are more than half a spacing away.
_GRID_SPACINGS = 0.5


class PairingError(Error):
    """The markers of both views at rest could not be paired."""


@dataclass(frozen=True)
class ScatteredFrame:
    """Markers of one stereo frame, in the order of the left view at rest.

    Attributes
    ----------
    points_mm
        (N, 3) in the sensor frame.
    covariance_mm2
        (N, 3, 3), from the covariances of both centres.
    indentation_mm
        (N,) height above the rest surface; positive towards the camera.
    salient
        (N,) whether the marker is in contact, by the settings of `contact`.
    state
        (N,) `MarkerState`: seen only if both views show the marker.
    left_px, right_px
        (N, 2) centres.
    is_certain
        Whether both views were identified with certainty; otherwise the points are of an earlier frame.
    """

    points_mm: Array
    covariance_mm2: Array
    indentation_mm: Array
    salient: npt.NDArray[np.bool_]
    state: npt.NDArray[np.uint8]
    left_px: Array
    right_px: Array
    is_certain: bool

    def __len__(self) -> int:
        return len(self.points_mm)

    def __repr__(self) -> str:
        doubt = "" if self.is_certain else ", not certain"
        return f"<ScatteredFrame: {len(self)} markers, {int(self.salient.sum())} in contact{doubt}>"


class StereoMarkerTracker:
    """Tracks a print of any layout in both views. The first frame is the rest frame.

    At rest, the markers of both views are paired by their rectified rows and a disparity that varies
    smoothly. Each view is then tracked on its own.

    Parameters
    ----------
    rig : Rig
        Cameras, and layers if plate and gel bend the light.
    params : Params, optional
        Its ``detect``, ``track`` and ``triangulate`` parts are used, and of ``contact`` the ``saliency``,
        ``saliency_mm`` and ``decay_mm``. The decay length is not learned: ``adaptive`` needs none.
    """

    def __init__(self, rig: Rig, params: Params | None = None) -> None:
        self._rig, self._params = rig, params if params is not None else Params()
        self._views = (MarkerTracker(self._params, "left"), MarkerTracker(self._params, "right"))
        self._pairs: npt.NDArray[np.int64] | None = None
        self._rest: RestSurface | None = None
        self._contact = self._params.to_dict()["contact"]
        self._gel: _Gel | None = None

    @property
    def rig(self) -> Rig:
        """The rig."""
        return self._rig

    @property
    def rest(self) -> RestSurface | None:
        """Surface of the gel at rest; None before the rest frame."""
        return self._rest

    def reset(self) -> None:
        """Forget the print: the next frame is the rest frame."""
        for view in self._views:
            view.reset()
        self._pairs = self._rest = self._gel = None

    def process(self, left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8]) -> ScatteredFrame:
        """Process the next frame.

        Parameters
        ----------
        left, right : (H, W) or (H, W, 3) uint8
            Images of both views.

        Raises
        ------
        ImageError, DetectError
            As `MarkerTracker.process`.
        PairingError
            If the markers at rest cannot be paired. The next frame is then the rest frame.
        TriangulateError
            If a pair of pixels has no point.
        """
        views = (self._views[0].process(left), self._views[1].process(right))
        if self._pairs is None:
            try:
                self._pairs = self._paired(*views)
                rest_mm = self._points(
                    views[0].rest_px[self._pairs[:, 0]], views[1].rest_px[self._pairs[:, 1]]
                )
                self._rest = RestSurface(rest_mm)
                self._gel = _Gel(rest_mm, self._rest)
            except Error:
                self.reset()
                raise
        return self._frame(*views)

    def _paired(self, left: TrackedMarkers, right: TrackedMarkers) -> npt.NDArray[np.int64]:
        pairs = pair_views(self._rectified(left.rest_px, "left"), self._rectified(right.rest_px, "right"))
        if pairs is None:
            raise PairingError(
                f"the {len(left)} markers of the left view and the {len(right)} of the right one cannot be "
                "paired: check that the rig belongs to these cameras, and that both show most of the print"
            )
        return pairs

    def _rectified(self, pixels_px: Array, view: Literal["left", "right"]) -> Array:
        rectification = self._rig.rectification()
        straight = np.asarray(self._rig.undistort(pixels_px, view))
        rays = np.column_stack([straight, np.ones(len(straight))])
        turned = rays @ np.asarray(rectification.r_left if view == "left" else rectification.r_right).T
        return np.asarray(rectification.f_px * turned[:, :2] / turned[:, 2:] + rectification.c_px)

    def _points(self, left_px: Array, right_px: Array) -> Array:
        return np.asarray(triangulate(self._rig, left_px, right_px, self._params))

    def _frame(self, left: TrackedMarkers, right: TrackedMarkers) -> ScatteredFrame:
        if self._pairs is None or self._rest is None or self._gel is None:
            raise TriangulateError("there was no rest frame")
        n, m = self._pairs.T
        left_px, right_px = left.positions_px[n], right.positions_px[m]
        points_mm = self._points(left_px, right_px)
        covariance_mm2 = self._covariance(left_px, right_px, left.covariance_px2[n], right.covariance_px2[m])
        normal = np.asarray(self._rest.normal)
        sigma_mm = np.sqrt(np.einsum("i,nij,j->n", normal, covariance_mm2, normal))
        indentation_mm = np.asarray(self._rest.indentation_mm(points_mm))
        state = np.maximum(left.state[n], right.state[m])
        is_certain = left.is_certain and right.is_certain
        if self._contact["saliency"] == "depth":
            touches = indentation_mm >= np.maximum(self._contact["saliency_mm"], _SALIENT_SIGMAS * sigma_mm)
        else:
            touches = self._gel.touches(indentation_mm, sigma_mm**2, self._contact)
        salient = touches & (state == MarkerState.SEEN)
        return ScatteredFrame(
            points_mm, covariance_mm2, indentation_mm, salient, state, left_px, right_px, is_certain
        )

    def _covariance(self, left_px: Array, right_px: Array, left_px2: Array, right_px2: Array) -> Array:
        """Covariances of the points, to first order in the errors of the centres."""
        columns = []
        for step in np.eye(4) * _STEP_PX:
            ahead = self._points(left_px + step[:2], right_px + step[2:])
            behind = self._points(left_px - step[:2], right_px - step[2:])
            columns.append((ahead - behind) / (2.0 * _STEP_PX))
        jacobian = np.stack(columns, axis=-1)
        return np.asarray(
            jacobian[:, :, :2] @ left_px2 @ jacobian[:, :, :2].transpose(0, 2, 1)
            + jacobian[:, :, 2:] @ right_px2 @ jacobian[:, :, 2:].transpose(0, 2, 1)
        )


class _Gel:
    """The gel's surface on a square grid.

    The rules of contact by pressure need a grid. Heights between markers are interpolated by natural
    neighbours; nodes outside the markers' convex hull are not measured.
    """

    def __init__(self, rest_mm: Array, rest: RestSurface) -> None:
        low_mm, high_mm = rest_mm[:, :2].min(axis=0), rest_mm[:, :2].max(axis=0)
        step_mm = _GRID_SPACINGS * float(np.sqrt(np.prod(high_mm - low_mm) / len(rest_mm)))
        self._surface = DenseSurface(rest_mm[:, :2], step_mm)
        self._shape = self._surface.shape
        inside = np.asarray(self._surface.mask)
        x_mm, y_mm = np.meshgrid(self._surface.x_mm, self._surface.y_mm)
        # The plane of the rest surface, with the measured surface where there is one.
        normal, centre_mm = np.asarray(rest.normal), np.asarray(rest.centre_mm)
        aside = normal[0] * (x_mm - centre_mm[0]) + normal[1] * (y_mm - centre_mm[1])
        z_mm = np.where(inside, self._surface.sample(rest_mm[:, 2]), centre_mm[2] - aside / normal[2])
        self._rest = RestSurface(np.stack([x_mm, y_mm, z_mm], axis=-1).reshape(-1, 3))
        self._outside = ~inside
        x, y = np.asarray(self._surface.x_mm), np.asarray(self._surface.y_mm)
        nearest = [
            np.abs(axis - at[:, None]).argmin(axis=1) for axis, at in ((y, rest_mm[:, 1]), (x, rest_mm[:, 0]))
        ]
        #: Node nearest to each marker at rest.
        self._node = np.ravel_multi_index((nearest[0], nearest[1]), self._shape)

    def touches(
        self, indentation_mm: Array, variance_mm2: Array, contact: Mapping[str, Any]
    ) -> npt.NDArray[np.bool_]:
        """Whether each marker is in contact, by the node nearest to it."""
        heights_mm = np.where(self._outside, np.nan, self._surface.sample(indentation_mm)).ravel()
        variances_mm2 = np.where(self._outside, 1.0, self._surface.sample(variance_mm2)).ravel()
        rows, cols = self._shape
        if contact["saliency"] == "pressure":
            salient, _ = pressure_saliency(
                self._rest, heights_mm, variances_mm2, rows=rows, cols=cols, decay_mm=contact["decay_mm"]
            )
        else:
            salient, _ = adaptive_saliency(
                self._rest, heights_mm, variances_mm2, rows=rows, cols=cols, max_decay_mm=contact["decay_mm"]
            )
        return np.asarray(np.asarray(salient)[self._node], bool)
