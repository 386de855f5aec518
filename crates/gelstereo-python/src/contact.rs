//! The rest surface and what rises above it.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::raise;
use gelstereo_core::contact as core;
use gelstereo_core::math::DVec3;
use pyo3::prelude::*;

/// The markers when nothing touches the gel, and the plane through them.
///
/// Parameters
/// ----------
/// points_mm : (N, 3) array_like
///     Sensor frame.
///
/// Raises
/// ------
/// ContactError
///     If the points span no plane.
#[pyclass(frozen, module = "gelstereo")]
pub struct RestSurface {
    inner: core::RestSurface,
}

impl RestSurface {
    pub const fn from_core(inner: core::RestSurface) -> Self {
        Self { inner }
    }
}

#[pymethods]
impl RestSurface {
    #[new]
    fn new(points_mm: &Bound<'_, PyAny>) -> PyResult<Self> {
        let points = Numbers::new(points_mm, "points_mm")?;
        Ok(Self { inner: core::RestSurface::new(points.rows::<DVec3, 3>()?).map_err(raise)? })
    }

    /// (N, 3) the rest markers, sensor frame.
    #[getter]
    fn points_mm(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::rows::<_, 3>(py, self.inner.points_mm().to_vec())
    }

    /// (3,) unit normal of the rest plane, towards the camera.
    #[getter]
    fn normal(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.normal().to_array().to_vec())
    }

    /// (3,) centroid of the rest markers, sensor frame.
    #[getter]
    fn centre_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, self.inner.centre_mm().to_array().to_vec())
    }

    /// Height of every marker above its rest height; positive towards the camera.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     The same markers now, sensor frame.
    ///
    /// Returns
    /// -------
    /// (N,) float64
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If the number of markers differs or a coordinate is not finite.
    fn indentation_mm(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<Array1<f64>> {
        let points = Numbers::new(points_mm, "points_mm")?;
        let mut out = Vec::new();
        self.inner.indentation_mm(points.rows::<DVec3, 3>()?, &mut out).map_err(raise)?;
        Ok(arrays::list(py, out))
    }

    fn __len__(&self) -> usize {
        self.inner.points_mm().len()
    }
}
