//! Tractions and wrenches.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::compliance::Compliance;
use crate::contact::RestSurface;
use crate::errors::raise;
use crate::moved::GivenMarkers;
use crate::params::Params;
use gelstereo_core::force as core;
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::DVec3;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Force and torque that the part exerts on the gel, in the sensor frame.
#[pyclass(frozen, module = "gelstereo")]
pub struct Wrench {
    inner: core::Wrench,
}

impl Wrench {
    pub const fn from_core(inner: core::Wrench) -> Self {
        Self { inner }
    }

    pub const fn core(&self) -> &core::Wrench {
        &self.inner
    }
}

#[pymethods]
impl Wrench {
    /// (3,) force, newtons.
    #[getter]
    fn force_n(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.force_n.to_array().to_vec())
    }

    /// (3,) torque about `about_mm`, newton millimetres.
    #[getter]
    fn torque_nmm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.torque_nmm.to_array().to_vec())
    }

    /// (3,) point of reference: the centroid of the rest markers, unless moved by `about`.
    #[getter]
    fn about_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.about_mm.to_array().to_vec())
    }

    /// (6, 6) covariance of force and torque: N², N² mm and N² mm².
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.covariance)
    }

    /// Mean square of the motion that the elastic layer does not explain, over its variance: 1 where it
    /// explains all but noise. Above 1, the covariance is that much wider.
    #[getter]
    const fn misfit(&self) -> f64 {
        self.inner.misfit
    }

    /// Number of cells with unknown tractions.
    #[getter]
    const fn cells(&self) -> usize {
        self.inner.cells
    }

    /// Number of markers whose motion was used.
    #[getter]
    const fn markers(&self) -> usize {
        self.inner.markers
    }

    /// Whether the contact reaches the lattice's border; forces beyond it are missing.
    #[getter]
    const fn is_cut(&self) -> bool {
        self.inner.is_cut
    }

    /// The same wrench about another point.
    ///
    /// Parameters
    /// ----------
    /// point_mm : (3,) array_like
    ///     Sensor frame.
    fn about(&self, point_mm: &Bound<'_, PyAny>) -> PyResult<Self> {
        let point_mm = DVec3::from_array(Numbers::new(point_mm, "point_mm")?.vector::<3>()?);
        Ok(Self { inner: self.inner.about(point_mm) })
    }

    fn __repr__(&self) -> String {
        let [[x, y, z], [a, b, c]] = [self.inner.force_n, self.inner.torque_nmm].map(|v| v.to_array());
        format!("<Wrench: force ({x:.3}, {y:.3}, {z:.3}) N, torque ({a:.2}, {b:.2}, {c:.2}) N mm>")
    }
}

/// Estimates the tractions on a gel and their wrench from the motion of its markers.
///
/// The gel is an elastic layer: linear elasticity, bonded to its plate, unbounded sideways.
///
/// Parameters
/// ----------
/// rest : RestSurface
///     Of a square or hexagonal lattice (``lattice.layout``), row by row.
/// params : Params
///     Its table ``force`` is used: ``method`` ``"ridge"`` or ``"bounded"``, ``thickness_mm`` and
///     ``young_kpa``.
/// cols : int
///     Markers in a row.
/// covariance_mm2 : (N, 3, 3) array_like
///     Covariances of the rest positions.
/// compliance : Compliance, optional
///     Of the same gel and lattice, in place of the layer.
///
/// Raises
/// ------
/// ParamsError
///     If a setting is missing or not valid.
/// ContactError
///     If the markers are not such a lattice, a list has another length, or the compliance is of another
///     gel or lattice.
#[pyclass(frozen, module = "gelstereo")]
pub struct ForceEstimator {
    inner: Mutex<core::ForceEstimator>,
}

#[pymethods]
impl ForceEstimator {
    #[new]
    #[pyo3(signature = (rest, params, *, cols, covariance_mm2, compliance=None))]
    fn new(
        rest: &RestSurface,
        params: &Params,
        cols: Count,
        covariance_mm2: &Bound<'_, PyAny>,
        compliance: Option<&Compliance>,
    ) -> PyResult<Self> {
        let covariance_mm2 = Numbers::new(covariance_mm2, "covariance_mm2")?;
        let covariance_mm2 = covariance_mm2.matrices()?;
        let topology = Topology::of(params.inner.lattice.layout, cols.0, rest.core().points_mm());
        let made = core::ForceEstimator::on(
            &params.inner.force,
            rest.core(),
            topology,
            covariance_mm2,
            compliance.map(|compliance| compliance.core().clone()),
        );
        Ok(Self { inner: Mutex::new(made.map_err(raise)?) })
    }

    fn __repr__(&self) -> String {
        let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let (markers, pitch_mm) = (inner.markers(), inner.pitch_mm());
        format!("<ForceEstimator: {markers} markers, pitch {pitch_mm:.3} mm>")
    }

    /// Estimate tractions and wrench from the markers of one frame.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Sensor frame; NaN for a marker that is not seen.
    /// covariance_mm2 : (N, 3, 3) array_like
    ///     Their covariances, without those of the rest positions.
    /// patch : (N,) array_like of bool
    ///     Whether the part touches the gel at the marker.
    ///
    /// Returns
    /// -------
    /// traction_kpa : (N, 3) float64
    ///     Exerted by the part on the gel around each marker, along the sensor's axes.
    /// wrench : Wrench or None
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
    ) -> PyResult<(Matrix, Option<Wrench>)> {
        let markers = GivenMarkers::new(points_mm, covariance_mm2, patch)?;
        let mut traction_kpa = Vec::new();
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let wrench = inner.run(&markers.moved()?, &mut traction_kpa).map_err(raise)?;
        Ok((arrays::rows::<_, 3>(py, traction_kpa)?, wrench.map(Wrench::from_core)))
    }

    /// The patch of the last frame with its neighbours that the part presses.
    ///
    /// Patches from heights leave out a fifth of a round contact, which is hardly pressed and slips first.
    /// Give this wider patch to a `SlipTracker`.
    ///
    /// Parameters
    /// ----------
    /// traction_kpa : (N, 3) array_like
    ///     As `run` returned them.
    /// patch : (N,) array_like of bool
    ///     As it was given to `run`.
    ///
    /// Returns
    /// -------
    /// touching : (N,) bool
    ///     The patch itself where it has more than 64 cells.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If a list has another length than the rest markers.
    fn touching(
        &self,
        py: Python<'_>,
        traction_kpa: &Bound<'_, PyAny>,
        patch: Vec<bool>,
    ) -> PyResult<Array1<bool>> {
        let traction_kpa = Numbers::new(traction_kpa, "traction_kpa")?;
        let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let mut touching = Vec::new();
        inner.touching(traction_kpa.rows::<DVec3, 3>()?, &patch, &mut touching).map_err(raise)?;
        Ok(arrays::list(py, touching))
    }
}
