//! Compliance matrices of finite gels.

use crate::arrays::{self, Count, Numbers};
use crate::errors::raise;
use crate::{pickle, tree};
use gelstereo_core::force as core;
use gelstereo_core::layer::Layer;
use numpy::PyArray4;
use pyo3::prelude::*;
use pyo3::types::PyType;
use std::path::PathBuf;

/// Motion of every marker of a finite gel under unit tractions on the cells around the markers.
///
/// `gelstereo.force.compute_compliance` makes one. The gel is a rectangular block, bonded at its back, with
/// the lattice in its middle. By symmetry, the markers of one quarter are enough.
///
/// Parameters
/// ----------
/// motion_mm : array_like
///     For a Young's modulus of 1: (ceil(R / 2), ceil(C / 2), R, C, 3, 3) for markers of the first quarter;
///     cells; motion into the layer, along rows and along columns; pressure, and traction along rows and
///     along columns. Stored as float32.
/// rows, cols : int
///     R and C, of the markers; 2 to 64.
/// pitch_mm : float
///     Distance of neighbours.
/// thickness_mm, poisson_ratio : float
///     Of the gel.
/// rim_mm : (2,) array_like
///     Gel beyond the outermost markers, along rows and along columns.
///
/// Raises
/// ------
/// ContactError
///     If a number is out of its range, or the array has another size.
#[pyclass(frozen, module = "gelstereo")]
pub struct Compliance {
    inner: core::Compliance,
}

impl Compliance {
    pub const fn core(&self) -> &core::Compliance {
        &self.inner
    }
}

#[pymethods]
impl Compliance {
    #[new]
    #[pyo3(signature = (motion_mm, *, rows, cols, pitch_mm, thickness_mm, poisson_ratio, rim_mm))]
    fn new(
        motion_mm: &Bound<'_, PyAny>,
        rows: Count,
        cols: Count,
        pitch_mm: f64,
        thickness_mm: f64,
        poisson_ratio: f64,
        rim_mm: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let values = Numbers::new(motion_mm, "motion_mm")?.flat()?.iter().map(|&mm| mm as f32).collect();
        let gel = core::ComplianceGel {
            rows: rows.0,
            cols: cols.0,
            pitch_mm,
            layer: Layer { thickness_mm, poisson_ratio },
            rim_mm: Numbers::new(rim_mm, "rim_mm")?.vector::<2>()?,
        };
        Ok(Self { inner: core::Compliance::new(gel, values).map_err(raise)? })
    }

    /// Markers from top to bottom.
    #[getter]
    const fn rows(&self) -> usize {
        self.inner.gel().rows
    }

    /// Markers from left to right.
    #[getter]
    const fn cols(&self) -> usize {
        self.inner.gel().cols
    }

    /// Distance of neighbours.
    #[getter]
    const fn pitch_mm(&self) -> f64 {
        self.inner.gel().pitch_mm
    }

    /// Thickness of the gel.
    #[getter]
    const fn thickness_mm(&self) -> f64 {
        self.inner.gel().layer.thickness_mm
    }

    /// Poisson's ratio of the gel.
    #[getter]
    const fn poisson_ratio(&self) -> f64 {
        self.inner.gel().layer.poisson_ratio
    }

    /// Gel beyond the outermost markers, along rows and along columns.
    #[getter]
    fn rim_mm(&self) -> (f64, f64) {
        self.inner.gel().rim_mm.into()
    }

    /// The whole matrix.
    ///
    /// Returns
    /// -------
    /// matrix : (N, 3, N, 3) float64
    ///     Motion of every marker into the layer, along rows and along columns, mm; under a pressure and
    ///     tractions along rows and along columns of every cell, in units of Young's modulus. Its rows and
    ///     columns have the order of the markers.
    fn matrix(&self, py: Python<'_>) -> PyResult<Py<PyArray4<f64>>> {
        let (cols, count) = (self.cols(), self.rows() * self.cols());
        let place = |n: usize| (n / cols, n % cols);
        let mut values = vec![0.0; 9 * count * count];
        for (i, row) in values.chunks_exact_mut(9 * count).enumerate() {
            for n in 0..count {
                for (k, effects) in self.inner.effect(place(i), place(n)).into_iter().enumerate() {
                    row[3 * (k * count + n)..][..3].copy_from_slice(&effects);
                }
            }
        }
        arrays::shaped(py, values, (count, 3, count, 3))
    }

    /// Write the matrix to a file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        tree::write(py, path, self.inner.to_bytes())
    }

    /// A matrix from a file written by `save`.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     If the file is not a compliance matrix, has another version, or is damaged.
    #[classmethod]
    fn load(cls: &Bound<'_, PyType>, path: PathBuf) -> PyResult<Self> {
        let py = cls.py();
        let bytes = tree::read_bytes(py, path.clone())?;
        let read = core::Compliance::from_bytes(&bytes).map_err(raise);
        Ok(Self { inner: read.map_err(|error| tree::in_file(py, &error, &path))? })
    }

    /// A matrix from the bytes of a file, such as the attachment `gel.compliance` of a recording.
    ///
    /// Raises
    /// ------
    /// ContactError
    ///     As `load`.
    #[classmethod]
    fn from_bytes(_cls: &Bound<'_, PyType>, data: &[u8]) -> PyResult<Self> {
        Ok(Self { inner: core::Compliance::from_bytes(data).map_err(raise)? })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<pickle::Reduced<'py>> {
        pickle::reduce(slf, "from_bytes", &slf.get().inner.to_bytes())
    }

    fn __repr__(&self) -> String {
        let core::ComplianceGel { rows, cols, pitch_mm, layer, .. } = self.inner.gel();
        format!(
            "<Compliance: {rows} x {cols} markers, pitch {pitch_mm} mm, gel {} mm thick>",
            layer.thickness_mm
        )
    }
}
