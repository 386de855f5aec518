//! Recorded rest frames.

use crate::arrays::{self, Array1, Matrix};
use crate::contact::RestSurface;
use crate::errors::{ContactError, raise};
use crate::rig::Rig;
use crate::tree;
use gelstereo_core::contact::RestSurface as Surface;
use gelstereo_core::pipeline as core;
use pyo3::prelude::*;
use pyo3::types::PyType;
use std::path::PathBuf;

/// A sensor's rest state, from which a `Pipeline` can start under contact; immutable.
///
/// Created by `Pipeline.rest_record`, used by `Pipeline.resume`. It stays valid as long as gel and
/// cameras do not move in the sensor.
#[pyclass(frozen, module = "gelstereo", eq)]
#[derive(PartialEq)]
pub struct RestRecord {
    pub inner: core::RestRecord,
}

impl RestRecord {
    fn checked(inner: core::RestRecord) -> PyResult<Self> {
        inner.validate().map_err(raise)?;
        Ok(Self { inner })
    }
}

#[pymethods]
impl RestRecord {
    /// Number of markers from top to bottom.
    #[getter]
    const fn rows(&self) -> usize {
        self.inner.rows
    }

    /// Number of markers from left to right.
    #[getter]
    const fn cols(&self) -> usize {
        self.inner.cols
    }

    /// The rest surface of the markers. With ``lattice.depth_mm``, `Pipeline.rest` is that of the skin over
    /// them.
    #[getter]
    fn rest(&self) -> PyResult<RestSurface> {
        Ok(RestSurface::from_core(Surface::new(&self.inner.points_mm).map_err(raise)?))
    }

    /// The rig of the measurement.
    #[getter]
    fn rig(&self) -> Rig {
        Rig { inner: self.inner.rig.clone() }
    }

    /// (N, 2) positions in the left image.
    #[getter]
    fn left_px(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::rows::<_, 2>(py, self.inner.left.positions_px.clone())
    }

    /// (N, 2) positions in the right image.
    #[getter]
    fn right_px(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::rows::<_, 2>(py, self.inner.right.positions_px.clone())
    }

    /// (N,) bool, whether the marker was visible in both views of the rest frame.
    #[getter]
    fn shown(&self, py: Python<'_>) -> Array1<bool> {
        let both = self.inner.left.shown.iter().zip(&self.inner.right.shown).map(|(&l, &r)| l && r);
        arrays::list(py, both.collect())
    }

    /// A record from TOML text.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If the text is not a record; the message names the line, or the damaged list.
    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::checked(tree::from_toml(text).map_err(ContactError::new_err)?)
    }

    /// The record as TOML text; `from_toml` restores an equal value.
    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(ContactError::new_err)
    }

    /// A record from a TOML file; see `from_toml`.
    #[classmethod]
    fn load<'py>(cls: &Bound<'py, PyType>, path: PathBuf) -> PyResult<Bound<'py, PyAny>> {
        tree::load(cls, path)
    }

    /// Write the record to a TOML file.
    fn save(slf: &Bound<'_, Self>, path: PathBuf) -> PyResult<()> {
        tree::save(slf, path)
    }

    fn __repr__(&self) -> String {
        let markers = self.inner.rows * self.inner.cols;
        format!("<RestRecord: {} rows x {} columns, {markers} markers>", self.inner.rows, self.inner.cols)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<tree::Reduced<'py>> {
        tree::reduce(slf)
    }
}
