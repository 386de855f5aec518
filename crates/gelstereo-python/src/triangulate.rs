//! From two views to millimetres.

use crate::arrays::{self, Matrix, Numbers};
use crate::errors::{TriangulateError, raise};
use crate::params::Params;
use crate::rig::Rig;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::triangulate::Triangulator;
use numpy::PyArray3;
use pyo3::prelude::*;

fn triangulator(rig: &Bound<'_, Rig>, params: Option<&Bound<'_, Params>>) -> PyResult<Triangulator> {
    Triangulator::new(&rig.get().inner, &Params::or_default(params).triangulate).map_err(raise)
}

#[pyfunction]
#[pyo3(signature = (rig, left_px, right_px, params=None))]
pub fn triangulate(
    py: Python<'_>,
    rig: &Bound<'_, Rig>,
    left_px: &Bound<'_, PyAny>,
    right_px: &Bound<'_, PyAny>,
    params: Option<&Bound<'_, Params>>,
) -> PyResult<Matrix> {
    let stage = triangulator(rig, params)?;
    let (left, right) = (Numbers::new(left_px, "left_px")?, Numbers::new(right_px, "right_px")?);
    let (left, right) = (left.rows::<DVec2, 2>()?, right.rows::<DVec2, 2>()?);
    let mut points = Vec::new();
    py.detach(|| stage.run(left, right, &mut points)).map_err(raise)?;
    arrays::rows::<DVec3, 3>(py, points.iter().map(|p| p.point_mm).collect())
}

#[pyfunction]
#[pyo3(signature = (rig, points_mm, sigma_px=None, params=None))]
pub fn triangulate_covariance(
    py: Python<'_>,
    rig: &Bound<'_, Rig>,
    points_mm: &Bound<'_, PyAny>,
    sigma_px: Option<f64>,
    params: Option<&Bound<'_, Params>>,
) -> PyResult<Py<PyArray3<f64>>> {
    let stage = triangulator(rig, params)?;
    let points = Numbers::new(points_mm, "points_mm")?;
    let points = points.rows::<DVec3, 3>()?;
    let sigma_px = sigma_px.unwrap_or(Params::or_default(params).triangulate.centre_sigma_px);
    if !(sigma_px > 0.0 && sigma_px.is_finite()) {
        return Err(TriangulateError::new_err(format!(
            "sigma_px is {sigma_px}; valid is a finite number above 0"
        )));
    }
    let values = points.iter().flat_map(|&p| stage.covariance_mm2(p, sigma_px)).flatten().collect();
    arrays::shaped(py, values, (points.len(), 3, 3))
}
