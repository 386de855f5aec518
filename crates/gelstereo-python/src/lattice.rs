//! Assigns row and column to every marker.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::errors::{LabelError, raise};
use crate::params::Params;
use gelstereo_core::lattice as core;
use gelstereo_core::math::DVec2;
use pyo3::prelude::*;

/// Largest number of rows or columns, as in `LatticeParams`.
const MAX_MARKERS: usize = 1000;

/// The complete lattice of an undisturbed frame.
#[pyclass(frozen, module = "gelstereo")]
pub struct RestLattice {
    /// Number of markers from top to bottom, as found.
    #[pyo3(get)]
    rows: usize,
    /// Number of markers from left to right, as found.
    #[pyo3(get)]
    cols: usize,
    /// (rows * cols, 2) positions, pixels.
    #[pyo3(get)]
    positions_px: Matrix,
    /// (rows * cols,) whether a marker was filled in from its neighbours.
    #[pyo3(get)]
    filled: Array1<bool>,
    /// Median distance between neighbours, pixels.
    #[pyo3(get)]
    pitch_px: f64,
    /// (above, right, below, left) rows or columns with markers that were left out: those seen in part, and
    /// those beyond ``lattice.rows`` and ``lattice.cols``.
    #[pyo3(get)]
    left_out: (usize, usize, usize, usize),
}

#[pymethods]
impl RestLattice {
    fn __repr__(&self) -> String {
        format!("<RestLattice: {} rows, {} columns, {:.2} px apart>", self.rows, self.cols, self.pitch_px)
    }
}

/// Foresight sort (the paper's Algorithm 1): the order of markers row by row, left to right.
///
/// Parameters
/// ----------
/// positions_px : (rows * cols, 2) array_like
/// rows, cols : int
/// tolerance_px : float
///     l of the algorithm: markers of one row are at least this far apart in x.
///
/// Returns
/// -------
/// (rows * cols,) int64
///     Indices into `positions_px`.
///
/// Raises
/// ------
/// LabelError
///     If a row does not fill.
#[pyfunction]
pub fn foresight_sort(
    py: Python<'_>,
    positions_px: &Bound<'_, PyAny>,
    rows: Count,
    cols: Count,
    tolerance_px: f64,
) -> PyResult<Array1<i64>> {
    let positions = Numbers::new(positions_px, "positions_px")?;
    let positions = positions.rows::<DVec2, 2>()?;
    let (Count(rows), Count(cols)) = (rows, cols);
    if rows.max(cols) > MAX_MARKERS || !(tolerance_px > 0.0 && tolerance_px.is_finite()) {
        return Err(LabelError::new_err(format!(
            "rows is {rows}, cols {cols}, tolerance_px {tolerance_px}; valid is up to {MAX_MARKERS} rows and \
             columns, and a finite tolerance above 0"
        )));
    }
    let mut order = Vec::new();
    py.detach(|| core::foresight_sort(positions, rows, cols, tolerance_px, &mut order)).map_err(raise)?;
    Ok(arrays::list(py, order.into_iter().map(|i| i as i64).collect()))
}

/// Count the rows and columns of an undisturbed frame, label its markers, and fill in undetected ones, up
/// to the share ``lattice.max_missing_share``.
///
/// Parameters
/// ----------
/// detected_px : (N, 2) array_like
/// params : Params, optional
///
/// Returns
/// -------
/// RestLattice
///
/// Raises
/// ------
/// LabelError
///     With what was found.
#[pyfunction]
#[pyo3(signature = (detected_px, params=None))]
pub fn rest_lattice(
    py: Python<'_>,
    detected_px: &Bound<'_, PyAny>,
    params: Option<&Bound<'_, Params>>,
) -> PyResult<RestLattice> {
    let detected = Numbers::new(detected_px, "detected_px")?;
    let detected = detected.rows::<DVec2, 2>()?;
    let params = Params::or_default(params);
    let lattice = py
        .detach(|| core::rest_lattice(detected, &params.lattice, params.label.tolerance_pitches))
        .map_err(raise)?;
    Ok(RestLattice {
        positions_px: arrays::rows::<_, 2>(py, lattice.positions_px)?,
        rows: lattice.rows,
        cols: lattice.cols,
        filled: arrays::list(py, lattice.detection.iter().map(Option::is_none).collect()),
        pitch_px: lattice.pitch_px,
        left_out: lattice.left_out.into(),
    })
}
