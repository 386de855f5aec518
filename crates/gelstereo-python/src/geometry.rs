//! Rotations, rigid motions, rigid fits and nearest neighbours.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::{PoseError, RegisterError, raise};
use crate::interrupt::{stoppable, stoppable_each};
use gelstereo_core::math::{DMat3, DQuat, DVec3, Pose, so3, sqrt};
use gelstereo_core::register::{self, FusedPose, PlaneContact, PoseEstimate};
use gelstereo_core::spatial::KdTree;
use pyo3::prelude::*;

fn vector(object: &Bound<'_, PyAny>, name: &'static str) -> PyResult<DVec3> {
    Ok(DVec3::from_array(within_reach(Numbers::new(object, name)?.vector::<3>()?, name)?))
}

/// Checks that sums and products of the numbers stay finite.
fn within_reach<const N: usize>(values: [f64; N], name: &str) -> PyResult<[f64; N]> {
    match values.iter().find(|x| !(x.abs() <= 1e12)) {
        Some(found) => {
            Err(PoseError::new_err(format!("{name} has a component {found}; valid is finite, up to 1e12")))
        }
        None => Ok(values),
    }
}

fn matrix3(py: Python<'_>, m: &DMat3) -> PyResult<Matrix> {
    arrays::matrix(py, m.transpose().to_cols_array_2d())
}

/// (4,) quaternion (x, y, z, w) of the rotation by ``|omega|`` radians about `omega`, (3,).
#[pyfunction]
pub fn so3_exp(py: Python<'_>, omega: &Bound<'_, PyAny>) -> PyResult<Array1<f64>> {
    Ok(arrays::list(py, so3::exp(vector(omega, "omega")?).to_array().to_vec()))
}

/// (3,) rotation vector, of length at most π, of a quaternion (x, y, z, w) that need not be normalised.
///
/// Raises
/// ------
/// PoseError
///     If the quaternion has no direction.
#[pyfunction]
pub fn so3_log(py: Python<'_>, q: &Bound<'_, PyAny>) -> PyResult<Array1<f64>> {
    let q = DQuat::from_array(Numbers::new(q, "q")?.vector::<4>()?);
    let omega = so3::log(so3::canonical(q).map_err(raise)?);
    Ok(arrays::list(py, omega.to_array().to_vec()))
}

/// (4,) quaternion (x, y, z, w), w >= 0, of a (3, 3) rotation matrix.
///
/// Raises
/// ------
/// PoseError
///     If the matrix is no rotation.
#[pyfunction]
pub fn so3_from_matrix(py: Python<'_>, matrix: &Bound<'_, PyAny>) -> PyResult<Array1<f64>> {
    let rows = Numbers::new(matrix, "matrix")?.matrix::<3, 3>()?;
    let q = so3::from_matrix(&DMat3::from_cols_array_2d(&rows).transpose()).map_err(raise)?;
    Ok(arrays::list(py, q.to_array().to_vec()))
}

/// (3, 3) left Jacobian V of SO(3) at `omega`, (3,).
#[pyfunction]
pub fn so3_left_jacobian(py: Python<'_>, omega: &Bound<'_, PyAny>) -> PyResult<Matrix> {
    matrix3(py, &so3::left_jacobian(vector(omega, "omega")?))
}

/// (3, 3) inverse of the left Jacobian at `omega`, (3,), for ``|omega| < 2π``.
#[pyfunction]
pub fn so3_left_jacobian_inverse(py: Python<'_>, omega: &Bound<'_, PyAny>) -> PyResult<Matrix> {
    matrix3(py, &so3::left_jacobian_inverse(vector(omega, "omega")?))
}

/// (4, 4) rigid motion of a twist (ωx ωy ωz vx vy vz), (6,).
#[pyfunction]
pub fn se3_exp(py: Python<'_>, twist: &Bound<'_, PyAny>) -> PyResult<Matrix> {
    let [a, b, c, x, y, z] = within_reach(Numbers::new(twist, "twist")?.vector::<6>()?, "twist")?;
    arrays::pose_matrix(py, &Pose::exp(DVec3::new(a, b, c), DVec3::new(x, y, z)))
}

/// (6,) twist (ωx ωy ωz vx vy vz) of a (4, 4) rigid motion.
///
/// Raises
/// ------
/// PoseError
///     If the matrix is no rigid motion.
#[pyfunction]
pub fn se3_log(py: Python<'_>, pose: &Bound<'_, PyAny>) -> PyResult<Array1<f64>> {
    let (omega, v) = arrays::pose(pose, "pose")?.log();
    Ok(arrays::list(py, [omega.to_array(), v.to_array()].concat()))
}

/// (4, 4) rigid motion from source to target points by weighted least squares; never a reflection.
///
/// Parameters
/// ----------
/// source, target : (N, 3) array_like
/// weights : (N,) array_like, optional
///     Not negative. Default: all equal.
///
/// Raises
/// ------
/// RegisterError
///     If points and weights do not determine a rigid motion.
#[pyfunction]
#[pyo3(signature = (source, target, weights=None))]
pub fn rigid_fit(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    weights: Option<&Bound<'_, PyAny>>,
) -> PyResult<Matrix> {
    let (source, target) = (Numbers::new(source, "source")?, Numbers::new(target, "target")?);
    let (source, target) = (source.rows::<DVec3, 3>()?, target.rows::<DVec3, 3>()?);
    let weights = match weights {
        Some(weights) => Numbers::new(weights, "weights")?.list()?.to_vec(),
        None => Vec::new(),
    };
    let fit = py.detach(|| register::rigid_fit(source, target, &weights)).map_err(raise)?;
    arrays::pose_matrix(py, &fit.t_target_source)
}

/// Fuse two estimates of one pose by their information.
///
/// Parameters
/// ----------
/// first, second : (4, 4) array_like
///     Poses between the same frames, mm.
/// first_information, second_information : (6, 6) array_like
///     Information of a left perturbation (ωx ωy ωz vx vy vz), rad and mm, as a localization has it. It may
///     be singular: along directions that one estimate does not determine, only the other one counts.
///
/// Returns
/// -------
/// pose : (4, 4) float64
///     The fused pose; equal to the first along directions that neither estimate determines.
/// information : (6, 6) float64
///     Of the fused pose.
/// squared_distance : float
///     Squared Mahalanobis distance of the estimates. For two correct estimates that determine all six
///     directions it is chi-squared distributed with six degrees of freedom.
///
/// Raises
/// ------
/// PoseError
///     If a matrix is no rigid motion.
/// RegisterError
///     If an information is not symmetric and positive semidefinite, or the poses differ by more than 0.5
///     rad.
#[pyfunction]
pub fn fuse_poses(
    py: Python<'_>,
    first: &Bound<'_, PyAny>,
    first_information: &Bound<'_, PyAny>,
    second: &Bound<'_, PyAny>,
    second_information: &Bound<'_, PyAny>,
) -> PyResult<(Matrix, Matrix, f64)> {
    let first = estimate(first, "first", first_information, "first_information")?;
    let second = estimate(second, "second", second_information, "second_information")?;
    fused_parts(py, &register::fuse_poses(&first, &second).map_err(raise)?)
}

/// Fuse an estimate of a pose with a plane that a point of the part touches.
///
/// Parameters
/// ----------
/// pose : (4, 4) array_like
///     Maps coordinates of frame b to frame a, mm.
/// information : (6, 6) array_like
///     As for :func:`fuse_poses`.
/// point_mm : (3,) array_like
///     The point, frame b.
/// normal : (3,) array_like
///     Unit normal of the plane, frame a.
/// offset_mm : float
///     Distance of the plane from the origin of frame a along the normal.
/// sigma_mm : float
///     Standard deviation of the point's distance from the plane.
///
/// Returns
/// -------
/// pose : (4, 4) float64
///     The fused pose; equal to the given one along directions that neither source determines.
/// information : (6, 6) float64
///     Of the fused pose.
/// squared_distance : float
///     Squared Mahalanobis distance of plane and estimate. If both are correct, and the estimate determines
///     the constrained direction, it is chi-squared distributed with one degree of freedom.
///
/// Raises
/// ------
/// PoseError
///     If the matrix is no rigid motion.
/// RegisterError
///     If the information is not symmetric and positive semidefinite, or a number of the plane is not valid.
#[pyfunction]
pub fn fuse_plane(
    py: Python<'_>,
    pose: &Bound<'_, PyAny>,
    information: &Bound<'_, PyAny>,
    point_mm: &Bound<'_, PyAny>,
    normal: &Bound<'_, PyAny>,
    offset_mm: f64,
    sigma_mm: f64,
) -> PyResult<(Matrix, Matrix, f64)> {
    let estimate = estimate(pose, "pose", information, "information")?;
    let (point_mm, normal) = (vector(point_mm, "point_mm")?, vector(normal, "normal")?);
    let contact = PlaneContact { point_mm, normal, offset_mm, sigma_mm };
    fused_parts(py, &register::fuse_plane(&estimate, &contact).map_err(raise)?)
}

fn estimate(
    pose: &Bound<'_, PyAny>,
    pose_name: &'static str,
    information: &Bound<'_, PyAny>,
    information_name: &'static str,
) -> PyResult<PoseEstimate> {
    Ok(PoseEstimate {
        pose: arrays::pose(pose, pose_name)?,
        information: Numbers::new(information, information_name)?.matrix::<6, 6>()?,
    })
}

fn fused_parts(py: Python<'_>, fused: &FusedPose) -> PyResult<(Matrix, Matrix, f64)> {
    let pose = arrays::pose_matrix(py, &fused.estimate.pose)?;
    Ok((pose, arrays::matrix(py, fused.estimate.information)?, fused.squared_distance))
}

/// The nearest point to every query; on ties, the one with the smallest index.
///
/// Parameters
/// ----------
/// points : (N, 3) array_like
///     At least one.
/// queries : (M, 3) array_like
///
/// Returns
/// -------
/// indices : (M,) int64
/// distances : (M,) float64
///
/// Raises
/// ------
/// RegisterError
///     If there are no points, or a coordinate is not finite.
#[pyfunction]
pub fn nearest(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    queries: &Bound<'_, PyAny>,
) -> PyResult<(Array1<i64>, Array1<f64>)> {
    let (points, queries) = (Numbers::new(points, "points")?, Numbers::new(queries, "queries")?);
    let (points, queries) = (points.rows::<DVec3, 3>()?, queries.rows::<DVec3, 3>()?);
    if let Some(index) = points.iter().chain(queries).position(|p| !p.is_finite()) {
        let (name, index) =
            if index < points.len() { ("points", index) } else { ("queries", index - points.len()) };
        return Err(RegisterError::new_err(format!(
            "row {index} of {name} has a coordinate that is NaN or infinite"
        )));
    }
    let tree = stoppable(py, |stop| KdTree::new_unless(points, stop))?.map_err(raise)?;
    let found = stoppable_each(py, queries, |&query| tree.nearest(query))?;
    let found = found.into_iter().collect::<Option<Vec<_>>>();
    let found =
        found.ok_or_else(|| RegisterError::new_err("there are no points; nearest needs at least one"))?;
    let (indices, squares): (Vec<i64>, Vec<f64>) = found.into_iter().map(|(i, d)| (i as i64, d)).unzip();
    Ok((arrays::list(py, indices), arrays::list(py, squares.into_iter().map(sqrt).collect())))
}
