//! Slip of the part along the gel.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::contact::RestSurface;
use crate::errors::raise;
use crate::force::Wrench;
use crate::moved::GivenMarkers;
use crate::names::name;
use crate::params::Params;
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::DVec3;
use gelstereo_core::slip as core;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Names and values of the states of sticking, repeated in `gelstereo.Stick` for typing.
#[pyfunction]
pub fn sticks() -> std::collections::BTreeMap<&'static str, u8> {
    core::Stick::ALL.map(|(name, stick)| (name, stick as u8)).into()
}

/// Names and values of the states of a contact, repeated in `gelstereo.SlipStatus` for typing.
#[pyfunction]
pub fn slip_statuses() -> std::collections::BTreeMap<&'static str, u8> {
    core::SlipStatus::ALL.map(|(name, status)| (name, status as u8)).into()
}

/// Names and values of what a margin follows from, repeated in `gelstereo.MarginSource` for typing.
#[pyfunction]
pub fn margin_sources() -> std::collections::BTreeMap<&'static str, u8> {
    core::MarginSource::ALL.map(|(name, source)| (name, source as u8)).into()
}

/// Share of the friction limit that is not used: 1 without tangential load, and 0 where the part slides.
#[pyclass(frozen, module = "gelstereo")]
pub struct SlipMargin {
    inner: core::Margin,
}

#[pymethods]
impl SlipMargin {
    /// The share, or the middle of its range where it follows from the stick ratio.
    #[getter]
    const fn share(&self) -> f64 {
        self.inner.share
    }

    /// Its range: of the stick range and of the law for thick and thin gels, or 95 % by the covariance of the
    /// wrench.
    #[getter]
    const fn range(&self) -> (f64, f64) {
        let [least, most] = self.inner.range;
        (least, most)
    }

    /// What it follows from: value of `MarginSource`.
    #[getter]
    const fn source(&self) -> u8 {
        self.inner.source as u8
    }

    fn __repr__(&self) -> String {
        let core::Margin { share, range: [least, most], source } = self.inner;
        let name = name(&core::MarginSource::ALL, source);
        format!("<SlipMargin: {share:.2} between {least:.2} and {most:.2}, by {name}>")
    }
}

/// Margin of a contact by its friction limit, as a `Pipeline` with ``force.friction`` states it.
///
/// Force Q along the gel and torque M about its normal share the limit as an ellipse (Howe and Cutkosky
/// 1996): the share in use is sqrt(Q² + (M/r)²) / (friction · P), where r is the mean distance of the
/// pressure from its centre.
///
/// Parameters
/// ----------
/// rest : RestSurface
/// wrench : Wrench
/// traction_kpa : (N, 3) array_like
///     Around each marker, as in `Frame.traction_kpa`.
/// points_mm : (N, 3) array_like
///     Markers in the sensor frame.
/// friction : float
///     Coulomb's coefficient.
/// friction_sigma : float
///     Its standard deviation.
///
/// Returns
/// -------
/// SlipMargin or None
///     None if the wrench is cut by the lattice's border, the part is not pressed by more than noise, the
///     coefficient is not above 0, or fewer than three markers have pressure.
///
/// Raises
/// ------
/// ContactError
///     If a list has another length than the rest markers.
#[pyfunction]
#[pyo3(signature = (rest, wrench, traction_kpa, points_mm, friction, friction_sigma=0.0))]
pub fn friction_margin(
    rest: &RestSurface,
    wrench: &Wrench,
    traction_kpa: &Bound<'_, PyAny>,
    points_mm: &Bound<'_, PyAny>,
    friction: f64,
    friction_sigma: f64,
) -> PyResult<Option<SlipMargin>> {
    let (tractions, points) =
        (Numbers::new(traction_kpa, "traction_kpa")?, Numbers::new(points_mm, "points_mm")?);
    let (traction_kpa, points_mm) = (tractions.rows::<DVec3, 3>()?, points.rows::<DVec3, 3>()?);
    let markers = rest.core().points_mm().len();
    if let Some(&found) = [traction_kpa.len(), points_mm.len()].iter().find(|&&found| found != markers) {
        return Err(raise(core::SlipError::Lengths { rest: markers, found }));
    }
    let (wrench, normal) = (wrench.core(), rest.core().normal());
    let loads = core::LoadedContact { wrench, traction_kpa, points_mm, normal, friction, friction_sigma };
    Ok(core::Margin::of_limit(&loads).map(|inner| SlipMargin { inner }))
}

/// Slip of a contact in one frame.
#[pyclass(frozen, module = "gelstereo")]
pub struct Slip {
    inner: core::Slip,
}

impl Slip {
    pub const fn from_core(inner: core::Slip) -> Self {
        Self { inner }
    }
}

#[pymethods]
impl Slip {
    /// Value of `SlipStatus`.
    #[getter]
    const fn status(&self) -> u8 {
        self.inner.status as u8
    }

    /// Markers that stick over those known to stick or slip; `None` while none is known.
    #[getter]
    const fn stick_ratio(&self) -> Option<f64> {
        self.inner.stick_ratio
    }

    /// Range of the ratio of areas: unknown markers stick or slip, and up to one pitch around the patch may
    /// slip unseen.
    #[getter]
    const fn stick_range(&self) -> (f64, f64) {
        let [least, most] = self.inner.stick_range;
        (least, most)
    }

    /// (4, 4) motion of the part since it touched the gel, or since three markers stick again, in the sensor
    /// frame; `None` if fewer do.
    #[getter]
    fn motion(&self, py: Python<'_>) -> PyResult<Option<Matrix>> {
        self.inner.motion.map(|motion| arrays::matrix(py, motion.pose.to_rows())).transpose()
    }

    /// (6, 6) covariance of a small rotation about `about_mm` and a small translation: rad², rad mm and mm²;
    /// `None` without `motion`.
    #[getter]
    fn motion_covariance(&self, py: Python<'_>) -> PyResult<Option<Matrix>> {
        self.inner.motion.map(|motion| arrays::matrix(py, motion.covariance)).transpose()
    }

    /// (3,) centroid of the markers that stick; `None` without `motion`.
    #[getter]
    fn about_mm(&self, py: Python<'_>) -> Option<Array1<f64>> {
        self.inner.motion.map(|motion| arrays::list(py, motion.about_mm.to_array().to_vec()))
    }

    /// Share of the friction limit that is not used: by the wrench with ``force.friction``, or else by the
    /// stick ratio with ``slip.shape``. `None` without these, and by the stick ratio for ``UNKNOWN`` and
    /// ``GROSS``.
    #[getter]
    fn margin(&self) -> Option<SlipMargin> {
        self.inner.margin.map(|inner| SlipMargin { inner })
    }

    fn __repr__(&self) -> String {
        let name = name(&core::SlipStatus::ALL, self.inner.status);
        let [least, most] = self.inner.stick_range;
        format!("<Slip: {name}, stick ratio between {least:.2} and {most:.2}>")
    }
}

/// Finds slip from frame to frame: markers in contact that do not move with the rigid motion of the others.
///
/// Parameters
/// ----------
/// rest : RestSurface
///     Row by row.
/// params : Params
///     Its table ``slip`` and ``lattice.layout`` are used.
/// cols : int
///     Markers in a row.
///
/// Raises
/// ------
/// ParamsError
///     If a setting is not valid.
/// ContactError
///     If the markers do not fill whole rows.
#[pyclass(frozen, module = "gelstereo")]
pub struct SlipTracker {
    inner: Mutex<core::SlipTracker>,
}

impl SlipTracker {
    fn inner(&self) -> std::sync::MutexGuard<'_, core::SlipTracker> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl SlipTracker {
    #[new]
    #[pyo3(signature = (rest, params, *, cols))]
    fn new(rest: &RestSurface, params: &Params, cols: Count) -> PyResult<Self> {
        let topology = Topology::of(params.inner.lattice.layout, cols.0, rest.core().points_mm());
        let made = core::SlipTracker::on(&params.inner.slip, rest.core(), topology);
        Ok(Self { inner: Mutex::new(made.map_err(raise)?) })
    }

    fn __repr__(&self) -> String {
        format!("<SlipTracker: {} markers>", self.inner().markers())
    }

    /// Forget the contact: the next frame is the first touch.
    fn restart(&self) {
        self.inner().restart();
    }

    /// Find slip from the markers of the next frame.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Sensor frame; NaN for a marker that is not seen.
    /// covariance_mm2 : (N, 3, 3) array_like
    ///     Their covariances.
    /// patch : (N,) array_like of bool
    ///     Whether the part touches the gel at the marker.
    ///
    /// Returns
    /// -------
    /// stick : (N,) uint8
    ///     Values of `Stick`.
    /// slip : Slip or None
    ///     None without contact.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If a list has another length than the rest markers.
    fn run(
        &self,
        py: Python<'_>,
        points_mm: &Bound<'_, PyAny>,
        covariance_mm2: &Bound<'_, PyAny>,
        patch: Vec<bool>,
    ) -> PyResult<(Array1<u8>, Option<Slip>)> {
        let markers = GivenMarkers::new(points_mm, covariance_mm2, patch)?;
        let mut stick = Vec::new();
        let slip = self.inner().run(&markers.moved()?, &mut stick).map_err(raise)?;
        let stick = arrays::list(py, stick.into_iter().map(|s| s as u8).collect());
        Ok((stick, slip.map(Slip::from_core)))
    }
}
