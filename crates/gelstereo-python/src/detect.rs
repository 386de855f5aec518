//! Marker detection.

use crate::arrays::{self, Array1, Image, Matrix, Numbers};
use crate::errors::raise;
use crate::params::Params;
use gelstereo_core::detect as core;
use gelstereo_core::detect::{Found, WindowObservation};
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{DetectParams, Polarity};
use numpy::{PyArray2, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Markers found in one image, in the raster order of their first pixels.
#[pyclass(frozen, module = "gelstereo")]
pub struct Markers {
    /// (N, 2) centres, pixels.
    #[pyo3(get)]
    centres_px: Matrix,
    /// (N, 2, 2) covariances of the centres, px².
    #[pyo3(get)]
    covariance_px2: Py<PyArray3<f64>>,
    /// (N,) areas, square pixels.
    #[pyo3(get)]
    area_px2: Array1<u32>,
    /// Number of markers for which the model fit did not converge and the grey centroid was kept; 0 for
    /// other rungs.
    #[pyo3(get)]
    unfitted: usize,
    /// (K, 2) centres of the visible parts of markers cut by the image border, pixels; not contained in
    /// other lists.
    #[pyo3(get)]
    cut_centres_px: Matrix,
    /// (K, 2, 2) covariances of these as estimates of the whole markers' centres, px².
    #[pyo3(get)]
    cut_covariance_px2: Py<PyArray3<f64>>,
    count: usize,
}

impl Markers {
    fn new(py: Python<'_>, found: core::Markers) -> PyResult<Self> {
        let cut = &found.cut;
        let cut_covariances = cut.iter().flat_map(|c| c.covariance_px2).flatten().collect();
        Ok(Self {
            cut_centres_px: arrays::rows::<_, 2>(py, cut.iter().map(|c| c.centre_px).collect())?,
            cut_covariance_px2: arrays::shaped(py, cut_covariances, (cut.len(), 2, 2))?,
            count: found.centres_px.len(),
            unfitted: found.unfitted,
            covariance_px2: arrays::shaped(
                py,
                found.covariance_px2.iter().flatten().flatten().copied().collect(),
                (found.centres_px.len(), 2, 2),
            )?,
            centres_px: arrays::rows::<_, 2>(py, found.centres_px)?,
            area_px2: arrays::list(py, found.area_px2),
        })
    }
}

#[pymethods]
impl Markers {
    fn __len__(&self) -> usize {
        self.count
    }

    fn __repr__(&self) -> String {
        format!("<{} markers>", self.count)
    }
}

/// Detects the markers of single images; `Pipeline` does this for stereo frames.
///
/// Parameters
/// ----------
/// params : Params, optional
///     Its ``detect`` part is used.
/// view : {"left", "right"}, optional
///     Whose region of interest (``detect.roi``) is searched; without it the whole image is.
#[pyclass(frozen, module = "gelstereo")]
pub struct Detector {
    /// Boxed because its SIMD columns are aligned to 32 bytes, and Python aligns its objects to 16.
    stage: Box<Mutex<core::Detector>>,
    params: DetectParams,
}

#[pymethods]
impl Detector {
    #[new]
    #[pyo3(signature = (params=None, view=None))]
    fn new(params: Option<&Bound<'_, Params>>, view: Option<&str>) -> PyResult<Self> {
        let params = Params::or_default(params).detect;
        let roi_px = match view {
            None => None,
            Some("left") => params.roi.left_px,
            Some("right") => params.roi.right_px,
            Some(other) => {
                return Err(PyValueError::new_err(format!(
                    "the view is {other:?}; valid are 'left' and 'right'"
                )));
            }
        };
        Ok(Self { stage: Box::new(Mutex::new(core::Detector::new(&params).within(roi_px))), params })
    }

    fn __repr__(&self) -> String {
        let (least, most) = (self.params.min_area_px2, self.params.max_area_px2);
        let dots = match self.params.polarity {
            Polarity::Dark => "dark",
            Polarity::Bright => "bright",
        };
        format!("<Detector: {dots} dots of {least} to {most} px²>")
    }

    /// Detect the markers of an image.
    ///
    /// Parameters
    /// ----------
    /// image : (H, W) uint8
    ///     Grey image. It is borrowed when its memory is contiguous and copied otherwise (a crop of a
    ///     wider image, a flipped view).
    ///
    /// Returns
    /// -------
    /// Markers
    ///
    /// Raises
    /// ------
    /// ImageError
    ///     If the array is no grey image.
    /// DetectError
    ///     If the image shows nothing that could be measured.
    fn detect(&self, py: Python<'_>, image: &Bound<'_, PyAny>) -> PyResult<Markers> {
        let image = Image::new(image, "image")?;
        let view = image.view()?;
        let found = py.detach(|| {
            let mut out = core::Markers::default();
            self.stage.lock().unwrap_or_else(PoisonError::into_inner).run(view, &mut out).map(|()| out)
        });
        Markers::new(py, found.map_err(raise)?)
    }

    /// Detect one marker near each expected position.
    ///
    /// Parameters
    /// ----------
    /// image : (H, W) uint8
    ///     Grey image, as in `detect`.
    /// expected_px : (N, 2)
    ///     Where markers should be, pixels.
    /// reach_px : float
    ///     A marker is found when all of it lies within so many pixels, in both axes; at most 31.
    ///
    /// Returns
    /// -------
    /// markers : Markers
    ///     Those found, with the bits that `detect` gives them.
    /// sights : (N,) int64
    ///     Which of `markers` each position has, each at most once; -1: no marker is there, -2: several
    ///     are, -3: not decided (parts of markers, something else, or a window outside the image).
    ///
    /// Raises
    /// ------
    /// ImageError, DetectError
    ///     As `detect`.
    fn detect_near(
        &self,
        py: Python<'_>,
        image: &Bound<'_, PyAny>,
        expected_px: &Bound<'_, PyAny>,
        reach_px: f64,
    ) -> PyResult<(Markers, Array1<i64>)> {
        let image = Image::new(image, "image")?;
        let view = image.view()?;
        let expected_px = Numbers::new(expected_px, "expected_px")?.rows::<DVec2, 2>()?.to_vec();
        let found = py.detach(|| {
            let mut out = Found::default();
            let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
            stage.run_near(view, &expected_px, reach_px, &mut out).map(|()| out)
        });
        let found = found.map_err(raise::<core::DetectError>)?;
        let sights = found.sights.iter().map(|sight| match sight {
            WindowObservation::Marker(index) => i64::from(*index),
            WindowObservation::Nothing => -1,
            WindowObservation::Several => -2,
            WindowObservation::Unclear => -3,
        });
        let sights = arrays::list(py, sights.collect());
        Ok((Markers::new(py, found.markers)?, sights))
    }

    /// Mask of the pixels that differ enough from their background, by ``detect.threshold`` and
    /// ``detect.polarity``, before blobs are filtered by size and shape.
    ///
    /// Parameters
    /// ----------
    /// image : (H, W) uint8
    ///     Grey image, as in `detect`.
    ///
    /// Returns
    /// -------
    /// (H, W) bool
    ///
    /// Raises
    /// ------
    /// ImageError, DetectError
    ///     As `detect`.
    fn mask(&self, py: Python<'_>, image: &Bound<'_, PyAny>) -> PyResult<Py<PyArray2<bool>>> {
        let image = Image::new(image, "image")?;
        let view = image.view()?;
        let mask = py.detach(|| {
            let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
            stage.run(view, &mut core::Markers::default())?;
            let mut mask = Vec::new();
            stage.mask(&mut mask);
            Ok(mask.into_iter().map(|pixel| pixel != 0).collect::<Vec<_>>())
        });
        arrays::shaped(py, mask.map_err(raise::<core::DetectError>)?, (view.height(), view.width()))
    }
}
