//! Row and column of every marker.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::raise;
use crate::params::Params;
use gelstereo_core::label as core;
use gelstereo_core::math::DVec2;
use gelstereo_core::params::LatticeParams;
use pyo3::prelude::*;

/// The complete rest lattice.
#[pyclass(frozen, module = "gelstereo")]
pub struct RestLattice {
    #[pyo3(get)]
    positions_px: Matrix,
    #[pyo3(get)]
    filled: Array1<bool>,
    #[pyo3(get)]
    pitch_px: f64,
}

#[pyfunction]
pub fn foresight_sort(
    py: Python<'_>,
    positions_px: &Bound<'_, PyAny>,
    rows: usize,
    cols: usize,
    tolerance_px: f64,
) -> PyResult<Array1<i64>> {
    let positions = Numbers::new(positions_px, "positions_px")?;
    let positions = positions.rows::<DVec2, 2>()?;
    let lattice = LatticeParams { rows, cols, ..LatticeParams::default() };
    let mut order = Vec::new();
    py.detach(|| core::foresight_sort(positions, &lattice, tolerance_px, &mut order)).map_err(raise)?;
    Ok(arrays::list(py, order.into_iter().map(|i| i as i64).collect()))
}

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
        filled: arrays::list(py, lattice.filled),
        pitch_px: lattice.pitch_px,
    })
}
