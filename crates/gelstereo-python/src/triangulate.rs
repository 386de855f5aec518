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

/// Points of corresponding pixels by the Q matrix (the paper's Eq. 3), with signed disparity.
///
/// Parameters
/// ----------
/// rig : Rig
/// left_px, right_px : (N, 2) array_like
///     The same markers in both images, as the cameras saw them (not rectified).
/// params : Params, optional
///     Its ``triangulate`` part is used.
///
/// Returns
/// -------
/// (N, 3) float64
///     Sensor frame, mm.
///
/// Raises
/// ------
/// TriangulateError
///     If a disparity is not above ``triangulate.min_disparity_px`` (swapped views are named as such), or a pixel has
///     no ray.
///
/// Examples
/// --------
/// >>> from gelstereo import Rig
/// >>> rig = Rig.parallel(size_px=(640, 480), f_px=560.0, baseline_mm=8.0)
/// >>> print(triangulate(rig, [[319.5, 239.5]], [[159.5, 239.5]]))
/// [[ 0. 0. 28.]]
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

/// Covariances of triangulated points, to first order.
///
/// Parameters
/// ----------
/// rig : Rig
/// points_mm : (N, 3) array_like
///     Sensor frame.
/// sigma_px : float, optional
///     Standard deviation of a centre per axis, in both views; ``detect.centre_sigma_px`` if left out.
/// params : Params, optional
///
/// Returns
/// -------
/// (N, 3, 3) float64
///     mm².
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
    let sigma_px = sigma_px.unwrap_or(Params::or_default(params).detect.centre_sigma_px);
    if !(sigma_px > 0.0 && sigma_px.is_finite()) {
        return Err(TriangulateError::new_err(format!(
            "sigma_px is {sigma_px}; valid is a finite number above 0"
        )));
    }
    if let Some(index) = points.iter().position(|p| !(p.is_finite() && p.z > 0.0)) {
        return Err(TriangulateError::new_err(format!(
            "point {index} is {} mm, which no camera can see; valid is z > 0, all finite",
            points[index]
        )));
    }
    let variance = sigma_px * sigma_px;
    let centre = [[variance, 0.0], [0.0, variance]];
    let covariances = points.iter().flat_map(|&p| stage.covariance_mm2(p, &centre, &centre));
    let values: Vec<f64> = covariances.flatten().collect();
    if !values.iter().all(|value| value.is_finite()) {
        return Err(TriangulateError::new_err(format!(
            "sigma_px is {sigma_px} and the points are as far as they are: the covariance has no finite value; valid \
             is a noise of a few pixels and points within metres"
        )));
    }
    arrays::shaped(py, values, (points.len(), 3, 3))
}
