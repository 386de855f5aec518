//! Rotations, rigid motions, rigid fits and nearest neighbours.

use crate::arrays::{self, Array1, Matrix, Numbers};
use crate::errors::raise;
use gelstereo_core::math::{DMat3, DQuat, DVec3, Pose, so3};
use pyo3::prelude::*;

fn vector(object: &Bound<'_, PyAny>, name: &'static str) -> PyResult<DVec3> {
    Ok(DVec3::from_array(Numbers::new(object, name)?.vector::<3>()?))
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
    let [a, b, c, x, y, z] = Numbers::new(twist, "twist")?.vector::<6>()?;
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
