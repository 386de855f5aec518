//! The gel's surface between the markers.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::raise;
use crate::interrupt::stoppable;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::surface as core;
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;

/// (H, W, 3).
type Cells = Py<PyArray3<f64>>;

/// The gel's surface on a regular grid, by natural-neighbour interpolation between the markers (Sibson 1981).
///
/// Weights are computed once, from the markers' rest positions: a cell is a material point of the gel,
/// which moves sideways with the surrounding markers. Planes are reproduced exactly; the surface passes
/// through the markers.
///
/// Parameters
/// ----------
/// rest_mm : (N, 2) array_like
///     Rest positions in the gel's plane, sensor x and y: ``pipeline.rest.points_mm[:, :2]``.
/// step_mm : float
///     Distance between cells.
///
/// Raises
/// ------
/// MeshError
///     If the markers have no triangulation, or the step is not valid or gives more than 4 194 304 cells.
#[pyclass(frozen, module = "gelstereo")]
pub struct DenseSurface {
    inner: core::DenseSurface,
}

#[pymethods]
impl DenseSurface {
    #[new]
    fn new(py: Python<'_>, rest_mm: &Bound<'_, PyAny>, step_mm: f64) -> PyResult<Self> {
        let rest = Numbers::new(rest_mm, "rest_mm")?;
        let rest = rest.rows::<DVec2, 2>()?;
        let made = stoppable(py, |stop| core::DenseSurface::new_unless(rest, step_mm, stop))?;
        Ok(Self { inner: made.map_err(raise)? })
    }

    fn __repr__(&self) -> String {
        let (rows, cols) = self.shape();
        format!("<DenseSurface: {rows} x {cols} cells, {} mm apart>", self.inner.step_mm())
    }

    /// (H, W) of the grid.
    #[getter]
    const fn shape(&self) -> (usize, usize) {
        (self.inner.rows(), self.inner.cols())
    }

    /// (W,) sensor x of the columns at rest.
    #[getter]
    fn x_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, (0..self.inner.cols()).map(|col| self.inner.rest_mm(0, col).x).collect())
    }

    /// (H,) sensor y of the rows at rest.
    #[getter]
    fn y_mm(&self, py: Python<'_>) -> Array1<f64> {
        arrays::list(py, (0..self.inner.rows()).map(|row| self.inner.rest_mm(row, 0).y).collect())
    }

    /// (H, W) bool, whether a cell lies within the markers' hull; the surface is known only there.
    #[getter]
    fn mask(&self, py: Python<'_>) -> PyResult<Py<PyArray2<bool>>> {
        let cells = self.inner.rows() * self.inner.cols();
        arrays::shaped(py, (0..cells).map(|cell| self.inner.is_known(cell)).collect(), self.shape())
    }

    /// Interpolate a quantity of the markers, for example their indentation.
    ///
    /// Parameters
    /// ----------
    /// values : (N,) array_like
    ///
    /// Returns
    /// -------
    /// (H, W) float64
    ///     0 where the surface is not known.
    ///
    /// Raises
    /// ------
    /// MeshError
    ///     If the number of values differs from the number of markers, or a value is not finite.
    fn sample(&self, py: Python<'_>, values: &Bound<'_, PyAny>) -> PyResult<Matrix> {
        let values = Numbers::new(values, "values")?;
        let mut out = Vec::new();
        self.inner.sample(values.list()?, &mut out).map_err(raise)?;
        arrays::shaped(py, out, self.shape())
    }

    /// The interpolated surface of a point cloud.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     The markers now, sensor frame.
    ///
    /// Returns
    /// -------
    /// points_mm, normals : (H, W, 3) float64
    ///     Points, and unit normals towards the camera; 0 where the surface is not known.
    ///
    /// Raises
    /// ------
    /// MeshError
    ///     If the number of markers differs, a coordinate is not finite, or there is no normal.
    fn points(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<(Cells, Cells)> {
        let points = Numbers::new(points_mm, "points_mm")?;
        let mut frame = core::DenseFrame::default();
        self.inner.clone().run(points.rows::<DVec3, 3>()?, &mut frame).map_err(raise)?;
        let (rows, cols) = self.shape();
        let array = |list: Vec<DVec3>| {
            arrays::shaped(py, bytemuck::allocation::cast_vec::<DVec3, f64>(list), (rows, cols, 3))
        };
        Ok((array(frame.points_mm)?, array(frame.normals)?))
    }
}
