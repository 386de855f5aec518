//! Marker detection.

use crate::arrays::{self, Array1, Image, Matrix};
use crate::errors::raise;
use crate::params::Params;
use gelstereo_core::detect as core;
use gelstereo_core::params::{Channel, DetectParams, Polarity, Region};
use gelstereo_core::rig::View;
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
    /// Channel of a colour image in which they were found: ``"grey"``, ``"red"``, ``"green"`` or ``"blue"``;
    /// ``"grey"`` for a grey image.
    #[pyo3(get)]
    channel: &'static str,
    /// Share of the markers with two opposite neighbours at equal distance, as in the rows of a print;
    /// ``None`` for fewer than nine markers. It is above 0.8 for most prints, and below 0.2 for clutter,
    /// noise and prints of random dots.
    #[pyo3(get)]
    share_in_rows: Option<f64>,
    is_in_rows: Option<bool>,
    count: usize,
}

impl Markers {
    fn new(py: Python<'_>, found: core::Markers, channel: Channel) -> PyResult<Self> {
        let (share_in_rows, is_in_rows) = (found.share_in_rows(), found.is_in_rows());
        let cut = &found.cut;
        let cut_covariances = cut.iter().flat_map(|c| c.covariance_px2).flatten().collect();
        Ok(Self {
            cut_centres_px: arrays::rows::<_, 2>(py, cut.iter().map(|c| c.centre_px).collect())?,
            cut_covariance_px2: arrays::shaped(py, cut_covariances, (cut.len(), 2, 2))?,
            channel: arrays::channel_name(channel),
            share_in_rows,
            is_in_rows,
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
        match (self.share_in_rows, self.is_in_rows) {
            (Some(share), Some(false)) => {
                format!("<{} markers, {:.0} % of them in rows: no print>", self.count, 100.0 * share)
            }
            _ => format!("<{} markers>", self.count),
        }
    }
}

/// Detects the markers of single images; `Pipeline` does this for stereo frames.
///
/// Parameters
/// ----------
/// params : Params, optional
///     Its ``detect`` part is used.
/// view : {"left", "right"}, optional
///     View whose region of interest (``detect.roi``) is searched. Default: the whole image.
#[pyclass(frozen, module = "gelstereo")]
pub struct Detector {
    /// Boxed because its SIMD columns are aligned to 32 bytes, and Python aligns its objects to 16.
    stage: Box<Mutex<(core::Detector, core::Folds)>>,
    params: DetectParams,
}

impl Detector {
    /// The channel of `detect.channel`, chosen by this image if that is ``"auto"``.
    fn channel(&self, image: &Image<'_>) -> PyResult<Channel> {
        match (image, fixed_channel(&self.params)) {
            (Image::Color(_), Some(channel)) => Ok(channel),
            _ => image.best_channel(&self.params),
        }
    }
}

/// The channel of the settings, unless the images determine it.
pub fn fixed_channel(params: &DetectParams) -> Option<Channel> {
    Some(params.channel).filter(|&channel| channel != Channel::Auto)
}

/// Region of interest of a view of the settings; the whole image without a view.
pub fn region<'a>(params: &'a DetectParams, view: Option<&str>) -> PyResult<Region<'a>> {
    match view {
        None => Ok(Region::default()),
        Some("left") => Ok(params.roi.of(View::Left)),
        Some("right") => Ok(params.roi.of(View::Right)),
        Some(other) => {
            Err(PyValueError::new_err(format!("the view is {other:?}; valid are 'left' and 'right'")))
        }
    }
}

#[pymethods]
impl Detector {
    #[new]
    #[pyo3(signature = (params=None, view=None))]
    fn new(params: Option<&Bound<'_, Params>>, view: Option<&str>) -> PyResult<Self> {
        let params = Params::or_default(params).detect;
        let stage = core::Detector::new(&params).within(region(&params, view)?);
        Ok(Self { stage: Box::new(Mutex::new((stage, core::Folds::default()))), params })
    }

    fn __repr__(&self) -> String {
        let [min_px2, max_px2] = self.params.areas_px2();
        let dots = match self.params.polarity {
            Polarity::Dark => "dark",
            Polarity::Bright => "bright",
        };
        format!("<Detector: {dots} dots of {min_px2} to {max_px2} px²>")
    }

    /// Detect the markers of an image.
    ///
    /// The covariances include the effect of gel that folds within the dots, as far as the markers' positions
    /// in this image show it.
    ///
    /// Parameters
    /// ----------
    /// image : (H, W) or (H, W, 3) uint8
    ///     Grey image, or colour image whose channels are blue, green and red, as OpenCV reads them;
    ///     ``detect.channel`` selects one, and ``"auto"`` chooses by the contrast of the print in this image.
    ///     It is borrowed when its memory is contiguous and copied otherwise (a crop of a wider image, a
    ///     flipped view).
    ///
    /// Returns
    /// -------
    /// Markers
    ///
    /// Raises
    /// ------
    /// ImageError
    ///     If the array is not an image.
    /// DetectError
    ///     If the image shows nothing that can be measured.
    fn detect(&self, py: Python<'_>, image: &Bound<'_, PyAny>) -> PyResult<Markers> {
        let image = Image::new(image, "image")?;
        let (channel, mut levels) = (self.channel(&image)?, Vec::new());
        let view = image.view(channel, &mut levels)?;
        let found = py.detach(|| {
            let mut out = core::Markers::default();
            let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
            let (detector, folds) = &mut *stage;
            detector.run(view, &mut out)?;
            folds.widen(&mut out);
            Ok::<_, core::DetectError>(out)
        });
        Markers::new(py, found.map_err(raise)?, channel)
    }

    /// Mask of the pixels with sufficient contrast to the local background, by ``detect.threshold`` and
    /// ``detect.polarity``, before blobs are filtered by size and shape.
    ///
    /// Parameters
    /// ----------
    /// image : (H, W) or (H, W, 3) uint8
    ///     Image, as in `detect`.
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
        let (channel, mut levels) = (self.channel(&image)?, Vec::new());
        let view = image.view(channel, &mut levels)?;
        let mask = py.detach(|| {
            let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
            let stage = &mut stage.0;
            stage.run(view, &mut core::Markers::default())?;
            let mut mask = Vec::new();
            stage.mask(&mut mask);
            Ok(mask.into_iter().map(|pixel| pixel != 0).collect::<Vec<_>>())
        });
        arrays::shaped(py, mask.map_err(raise::<core::DetectError>)?, (view.height(), view.width()))
    }
}
