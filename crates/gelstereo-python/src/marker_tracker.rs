//! Tracking of markers of any layout in one camera.

use crate::arrays::{self, Array1, Image, Matrix, Numbers};
use crate::detect::{fixed_channel, region};
use crate::errors::raise;
use crate::params::Params;
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Channel, DetectParams};
use gelstereo_core::pipeline as core;
use gelstereo_core::track::{Certainty, MarkerState, ScatteredTracker};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Markers after an image, in the order of the rest image's markers.
#[pyclass(frozen, module = "gelstereo")]
pub struct TrackedMarkers {
    /// (N, 2) positions, pixels.
    #[pyo3(get)]
    positions_px: Matrix,
    /// (N, 2) positions in the rest image, pixels.
    #[pyo3(get)]
    rest_px: Matrix,
    /// (N, 2) displacements since the rest image, pixels.
    #[pyo3(get)]
    displacement_px: Matrix,
    /// (N, 2, 2) covariances of the positions, px². That of a held marker follows from the errors with which
    /// its neighbours are interpolated.
    #[pyo3(get)]
    covariance_px2: Py<PyArray3<f64>>,
    /// (N,) `MarkerState` of each marker.
    #[pyo3(get)]
    state: Array1<u8>,
    /// Whether the markers of this image were identified with certainty; otherwise all are held in place.
    #[pyo3(get)]
    is_certain: bool,
    /// Channel of a colour image in which markers are searched; ``"grey"`` for a grey image.
    #[pyo3(get)]
    channel: &'static str,
    count: usize,
    seen: usize,
}

#[pymethods]
impl TrackedMarkers {
    fn __len__(&self) -> usize {
        self.count
    }

    fn __repr__(&self) -> String {
        let doubt = if self.is_certain { "" } else { ", not certain" };
        format!("<{} tracked markers, {} seen{doubt}>", self.count, self.seen)
    }
}

/// Detects and tracks the markers of one camera, in any layout: random dots, hexagonal pins, rectangular
/// lattices, prints with gaps. It needs no rig; use `Pipeline` for stereo frames of a square lattice.
///
/// The first image is the rest image, and its markers keep their order. A match must agree with those of its
/// neighbours. If two common displacements explain an image about equally well, or none explains half of the
/// markers, nothing is identified. A regular print that reaches beyond the view looks the same after a step
/// of a whole pitch, so the frame rate must exclude such steps.
///
/// Parameters
/// ----------
/// params : Params, optional
///     Its ``detect`` and ``track`` parts are used; ``track.gate_pitches`` is in units of `spacing_px`.
/// view : {"left", "right"}, optional
///     View whose region of interest (``detect.roi``) is searched. Default: the whole image.
///
/// Examples
/// --------
/// >>> import numpy as np
/// >>> rng = np.random.default_rng(1)
/// >>> centres = [(x + rng.integers(-6, 7), y + rng.integers(-6, 7))
/// ...            for x in range(40, 300, 30) for y in range(40, 220, 30)]
/// >>> def image(shift_px):
/// ...     pixels = np.full((260, 340), 200, np.uint8)
/// ...     for x, y in centres:
/// ...         pixels[y - 4 : y + 5, x - 4 + shift_px : x + 5 + shift_px] = 60
/// ...     return pixels
/// >>> tracker = MarkerTracker()
/// >>> rest = tracker.process(image(0))
/// >>> moved = tracker.process(image(5))
/// >>> moved.is_certain, np.round(np.median(moved.displacement_px, axis=0), 2).tolist()
/// (True, [5.0, 0.0])
#[pyclass(frozen, module = "gelstereo")]
pub struct MarkerTracker {
    /// Boxed because its SIMD columns are aligned to 32 bytes, and Python aligns its objects to 16.
    stages: Box<Mutex<core::MarkerTracker>>,
    /// Channel of colour images; absent until an image determines it.
    channel: Mutex<Option<Channel>>,
    params: DetectParams,
}

impl MarkerTracker {
    fn lock(&self) -> MutexGuard<'_, core::MarkerTracker> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn locked_channel(&self) -> MutexGuard<'_, Option<Channel>> {
        self.channel.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl MarkerTracker {
    #[new]
    #[pyo3(signature = (params=None, view=None))]
    fn new(params: Option<&Bound<'_, Params>>, view: Option<&str>) -> PyResult<Self> {
        let params = Params::or_default(params);
        let stages = core::MarkerTracker::new(&params, region(&params.detect, view)?);
        let channel = Mutex::new(fixed_channel(&params.detect));
        Ok(Self { stages: Box::new(Mutex::new(stages)), channel, params: params.detect })
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let print =
            py.detach(|| self.lock().tracker().map(|print| (print.rest_px().len(), print.spacing_px())));
        match print {
            None => "<MarkerTracker: no rest image yet>".into(),
            Some((count, spacing_px)) => {
                format!("<MarkerTracker: {count} markers, {spacing_px:.1} px apart>")
            }
        }
    }

    /// Median distance of a marker from its nearest neighbour at rest, pixels; None before the rest image.
    #[getter]
    fn spacing_px(&self, py: Python<'_>) -> Option<f64> {
        py.detach(|| self.lock().tracker().map(ScatteredTracker::spacing_px))
    }

    /// Process the next image; the first one is the rest image.
    ///
    /// Parameters
    /// ----------
    /// image : (H, W) or (H, W, 3) uint8
    ///     Grey image, or colour image in OpenCV's order. With ``detect.channel = "auto"`` the rest image
    ///     determines the channel.
    ///
    /// Returns
    /// -------
    /// TrackedMarkers
    ///
    /// Raises
    /// ------
    /// ImageError
    ///     If the array is not an image, or of another size than the rest image.
    /// DetectError
    ///     If the image shows nothing that can be measured, or the rest image fewer than 5 markers. The next
    ///     image is processed as usual.
    fn process(&self, py: Python<'_>, image: &Bound<'_, PyAny>) -> PyResult<TrackedMarkers> {
        let (image, mut levels) = (Image::new(image, "image")?, Vec::new());
        let is_grey = matches!(image, Image::Grey(_));
        let known = *self.locked_channel();
        let channel = match known.filter(|_| !is_grey) {
            Some(channel) => channel,
            None => image.best_channel(&self.params)?,
        };
        let view = image.view(channel, &mut levels)?;
        let (certainty, tracks, rest_px) = py
            .detach(|| {
                let mut stages = self.lock();
                let certainty = stages.process(view)?;
                let rest_px = stages.tracker().map(|print| print.rest_px().to_vec()).unwrap_or_default();
                Ok((certainty, stages.tracks().clone(), rest_px))
            })
            .map_err(raise::<core::MarkerTrackerError>)?;
        if !is_grey {
            *self.locked_channel() = Some(channel);
        }
        let count = rest_px.len();
        let moved = tracks.positions_px.iter().zip(&rest_px).map(|(&now, &rest)| now - rest).collect();
        Ok(TrackedMarkers {
            displacement_px: arrays::rows::<_, 2>(py, moved)?,
            rest_px: arrays::rows::<_, 2>(py, rest_px)?,
            positions_px: arrays::rows::<_, 2>(py, tracks.positions_px)?,
            covariance_px2: arrays::shaped(
                py,
                tracks.covariance_px2.iter().flatten().flatten().copied().collect(),
                (count, 2, 2),
            )?,
            seen: tracks.state.iter().filter(|&&state| state == MarkerState::Seen).count(),
            state: arrays::list(py, tracks.state.iter().map(|&state| state as u8).collect()),
            is_certain: certainty == Certainty::Certain,
            channel: arrays::channel_name(channel),
            count,
        })
    }

    /// Forget the print: the next image is the rest image.
    fn reset(&self, py: Python<'_>) {
        py.detach(|| self.lock().reset());
        *self.locked_channel() = fixed_channel(&self.params);
    }
}

/// Pair the markers of two rectified views, in any layout.
///
/// Parameters
/// ----------
/// left_px, right_px : (N, 2), (M, 2) array_like
///     Rectified positions: a marker has about the same row in both, and a smaller column in the right view.
///
/// Returns
/// -------
/// (K, 2) int64 or None
///     Indices in the left and the right view. None if two disparities explain about as many markers, or none
///     explains half of them.
///
/// Raises
/// ------
/// ShapeError
///     If an array has another shape, or a position is not finite.
#[pyfunction]
pub fn pair_views(
    py: Python<'_>,
    left_px: &Bound<'_, PyAny>,
    right_px: &Bound<'_, PyAny>,
) -> PyResult<Option<Py<PyArray2<i64>>>> {
    let (left, right) = (Numbers::new(left_px, "left_px")?, Numbers::new(right_px, "right_px")?);
    let (left, right) = (left.rows::<DVec2, 2>()?, right.rows::<DVec2, 2>()?);
    let found = py.detach(|| gelstereo_core::track::pair_views(left, right));
    found
        .map(|pairs| {
            let count = pairs.len();
            let flat = pairs.into_iter().flat_map(|(n, m)| [i64::from(n), i64::from(m)]).collect();
            arrays::shaped(py, flat, (count, 2))
        })
        .transpose()
}
