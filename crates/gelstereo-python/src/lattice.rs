//! Assigns row and column to every marker.

use crate::arrays::{self, Array1, Count, Matrix, Numbers};
use crate::errors::{LabelError, raise};
use crate::params::Params;
use gelstereo_core::lattice as core;
use gelstereo_core::math::DVec2;
use numpy::{PyArray1, PyArray2, PyArrayMethods as _};
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

/// How the markers in an image are laid out.
#[pyclass(frozen, module = "gelstereo")]
pub struct PrintDescription {
    /// ``"square"``, ``"rectangular"``, ``"hexagonal"`` or ``"irregular"``.
    #[pyo3(get)]
    kind: &'static str,
    /// (2, 2) mean steps along a row, and to the next row, pixels.
    #[pyo3(get)]
    steps_px: Matrix,
    /// Angle between both steps, from 0 to 90 degrees.
    #[pyo3(get)]
    angle_deg: f64,
    /// Share of the markers that are on the lattice.
    #[pyo3(get)]
    on_lattice: f64,
    /// Rows that are seen; 0 if none are known.
    #[pyo3(get)]
    rows: usize,
    /// Columns that are seen.
    #[pyo3(get)]
    cols: usize,
    /// Share of the places of these rows and columns that show a marker.
    #[pyo3(get)]
    filled: f64,
    /// The same of the upper row, the lower row, the left column and the right column.
    #[pyo3(get)]
    borders: (f64, f64, f64, f64),
    /// (N, 2) row and column of every marker; -1 off the lattice.
    #[pyo3(get)]
    places: Py<PyArray2<i64>>,
}

#[pymethods]
impl PrintDescription {
    fn __repr__(&self) -> String {
        format!("<PrintDescription: {}, {} rows, {} columns>", self.kind, self.rows, self.cols)
    }
}

/// Describe how the markers in an image are laid out, whatever `lattice.layout` is.
///
/// Neighbouring markers are compared with those beside them, so perspective, a bent gel and a turned camera
/// do not matter.
///
/// Parameters
/// ----------
/// detected_px : (N, 2) array_like
///
/// Returns
/// -------
/// PrintDescription
#[pyfunction]
pub fn describe_print(py: Python<'_>, detected_px: &Bound<'_, PyAny>) -> PyResult<PrintDescription> {
    let detected = Numbers::new(detected_px, "detected_px")?;
    let detected = detected.rows::<DVec2, 2>()?;
    let found = py.detach(|| core::PrintDescription::of(detected));
    let place = |place: &Option<core::Place>| {
        place.map_or([-1, -1], |core::Place { row, col }| [i64::from(row), i64::from(col)])
    };
    let places: Vec<i64> = found.places.iter().flat_map(place).collect();
    let count = found.places.len();
    Ok(PrintDescription {
        kind: match found.kind {
            core::LayoutKind::Square => "square",
            core::LayoutKind::Rectangular => "rectangular",
            core::LayoutKind::Hexagonal => "hexagonal",
            core::LayoutKind::Irregular => "irregular",
        },
        angle_deg: found.angle_deg(),
        steps_px: arrays::rows::<_, 2>(py, found.steps_px.to_vec())?,
        on_lattice: found.on_lattice,
        rows: found.rows,
        cols: found.cols,
        filled: found.filled,
        borders: found.borders.into(),
        places: PyArray1::from_vec(py, places).reshape([count, 2])?.unbind(),
    })
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
