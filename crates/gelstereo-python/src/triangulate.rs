//! Triangulation of two views, in millimetres.

use crate::arrays::{self, Matrix, Numbers};
use crate::errors::{ShapeError, TriangulateError, raise};
use crate::params::Params;
use crate::rig::Rig;
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params as core;
use gelstereo_core::rig::{Disc, View};
use gelstereo_core::triangulate::{Centre, Centres, Triangulator};
use numpy::PyArray3;
use pyo3::prelude::*;

fn triangulator(rig: &Bound<'_, Rig>, params: &core::Params) -> PyResult<Triangulator> {
    Triangulator::new(&rig.get().inner, &params.triangulate).map_err(raise)
}

/// Isotropic covariance of a centre.
fn even(sigma_px: f64) -> Symmetric<2> {
    [[sigma_px * sigma_px, 0.0], [0.0, sigma_px * sigma_px]]
}

/// Triangulate corresponding pixels, with signed disparity.
///
/// ``triangulate.method`` selects the method: ``"q"`` (the paper's Eq. 3, without layers), ``"rays"``
/// (the most likely point of refracted rays) or ``"polynomial"`` (fitted to the rays around a rest
/// surface). Behind layers, q gives depths that are wrong by tens of percent.
///
/// Parameters
/// ----------
/// rig : Rig
/// left_px, right_px : (N, 2) array_like
///     The same markers in both images, in unrectified pixels.
/// params : Params, optional
///     Its ``triangulate`` part is used; both views have equal weight.
/// rest_mm : (M, 3) array_like, optional
///     Surface around which the polynomial is fitted. Without it, and beyond its reach, points are computed
///     from rays.
///
/// Returns
/// -------
/// (N, 3) float64
///     Sensor frame, mm.
///
/// Raises
/// ------
/// TriangulateError
///     If a disparity is not above ``triangulate.min_disparity_px`` (swapped views are named as such), or
///     a pixel has no ray.
///
/// Examples
/// --------
/// >>> from gelstereo import Rig
/// >>> rig = Rig.parallel(size_px=(640, 480), f_px=560.0, baseline_mm=8.0)
/// >>> print(triangulate(rig, [[319.5, 239.5]], [[159.5, 239.5]]))
/// [[ 0. 0. 28.]]
#[pyfunction]
#[pyo3(signature = (rig, left_px, right_px, params=None, *, rest_mm=None))]
pub fn triangulate(
    py: Python<'_>,
    rig: &Bound<'_, Rig>,
    left_px: &Bound<'_, PyAny>,
    right_px: &Bound<'_, PyAny>,
    params: Option<&Bound<'_, Params>>,
    rest_mm: Option<&Bound<'_, PyAny>>,
) -> PyResult<Matrix> {
    let params = Params::or_default(params);
    let mut stage = triangulator(rig, &params)?;
    if let Some(rest_mm) = rest_mm {
        stage.fit_map(Numbers::new(rest_mm, "rest_mm")?.rows::<DVec3, 3>()?);
    }
    let (left, right) = (Numbers::new(left_px, "left_px")?, Numbers::new(right_px, "right_px")?);
    let (left, right) = (left.rows::<DVec2, 2>()?, right.rows::<DVec2, 2>()?);
    let mut points = Vec::new();
    let covariances = vec![even(params.detect.centre_sigma_px); left.len().max(right.len())];
    let centres =
        |positions_px| Centres { positions_px, covariance_px2: &covariances[..<[DVec2]>::len(positions_px)] };
    py.detach(|| stage.run(centres(left), centres(right), &mut points)).map_err(raise)?;
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
    let params = Params::or_default(params);
    let stage = triangulator(rig, &params)?;
    let points = Numbers::new(points_mm, "points_mm")?;
    let points = points.rows::<DVec3, 3>()?;
    let sigma_px = sigma_px.unwrap_or(params.detect.centre_sigma_px);
    if !(sigma_px > 0.0 && sigma_px.is_finite()) {
        return Err(TriangulateError::new_err(format!(
            "sigma_px is {sigma_px}; valid is a finite number above 0"
        )));
    }
    let mut values = Vec::with_capacity(9 * points.len());
    for (index, &point) in points.iter().enumerate() {
        let (left, right) = rig
            .get()
            .inner
            .project(point)
            .map_err(|error| TriangulateError::new_err(format!("point {index}: {error}")))?;
        let centre = |at_px| Centre { at_px, covariance_px2: even(sigma_px) };
        let found = stage.point(index, &centre(left), &centre(right)).map_err(raise)?;
        values.extend(found.covariance_mm2.into_iter().flatten());
    }
    arrays::shaped(py, values, (points.len(), 3, 3))
}

/// Image centroids of discs minus the images of their centres, to second order in the discs' size.
///
/// The image centroid of a disc tilted by a is offset from the image of its centre by f r² sin a cos a /
/// z². Subtract this bias from measured centres; the pipeline does so with ``triangulate.disc_bias =
/// "corrected"``.
///
/// Parameters
/// ----------
/// rig : Rig
/// centres_mm : (N, 3) array_like
///     Centres of the discs, sensor frame.
/// along_mm, across_mm : (N, 3) array_like
///     Two conjugate half diameters of every disc, sensor frame.
///
/// Returns
/// -------
/// left_px, right_px : (N, 2) float64
///
/// Raises
/// ------
/// TriangulateError
///     If a disc is not in front of a camera.
///
/// Examples
/// --------
/// >>> from gelstereo import Rig
/// >>> rig = Rig.parallel(size_px=(640, 480), f_px=560.0, baseline_mm=8.0)
/// >>> left, right = disc_bias(rig, [[0, 0, 28.0]], [[0.2, 0, 0]], [[0, 0.14, 0.14]])
/// >>> print(left.round(4))
/// [[ 0.     -0.014]]
#[pyfunction]
pub fn disc_bias(
    py: Python<'_>,
    rig: &Bound<'_, Rig>,
    centres_mm: &Bound<'_, PyAny>,
    along_mm: &Bound<'_, PyAny>,
    across_mm: &Bound<'_, PyAny>,
) -> PyResult<(Matrix, Matrix)> {
    let lists = [
        Numbers::new(centres_mm, "centres_mm")?,
        Numbers::new(along_mm, "along_mm")?,
        Numbers::new(across_mm, "across_mm")?,
    ];
    let [centres, along, across] = &lists;
    let (centres, along, across) =
        (centres.rows::<DVec3, 3>()?, along.rows::<DVec3, 3>()?, across.rows::<DVec3, 3>()?);
    if along.len() != centres.len() || across.len() != centres.len() {
        return Err(ShapeError::new_err(format!(
            "{} centres but {} and {} half diameters; each disc has one and one",
            centres.len(),
            along.len(),
            across.len()
        )));
    }
    let side = |view| {
        let view = rig.get().inner.view(view);
        let bias = |(n, &centre_mm): (usize, &DVec3)| {
            let disc = Disc { centre_mm, half_mm: [along[n], across[n]] };
            view.disc_bias_px(&disc).map_err(|error| TriangulateError::new_err(format!("disc {n}: {error}")))
        };
        arrays::rows::<DVec2, 2>(py, centres.iter().enumerate().map(bias).collect::<PyResult<_>>()?)
    };
    Ok((side(View::Left)?, side(View::Right)?))
}
