//! Products of uncertain motions.

use crate::math::linalg::Symmetric;
use crate::math::{DVec3, Pose};
use crate::slip::RigidMotion;

/// `first`, and then `second`, with independent errors. The covariance is about the point of `second`.
pub(super) fn product(second: &RigidMotion, first: &RigidMotion) -> RigidMotion {
    let pose = (second.pose * first.pose).normalized().unwrap_or(second.pose);
    let moved = carried(first, second);
    let entry = |i: usize, k: usize| second.covariance[i][k] + moved[i][k];
    let covariance = core::array::from_fn(|i| core::array::from_fn(|k| entry(i, k)));
    RigidMotion { pose, about_mm: second.about_mm, covariance }
}

/// Covariance of `first` after the motion `second`, about the point of `second`: A C Aᵀ, where A turns
/// (omega, v) and moves them to the other point (Barfoot 2017, section 7.3).
fn carried(first: &RigidMotion, second: &RigidMotion) -> Symmetric<6> {
    let turn = second.pose.matrix();
    let lever_mm = second.about_mm - second.pose.transform_point(first.about_mm);
    let column = |k: usize| {
        let unit = |i: usize| f64::from(u8::from(i == k));
        let (omega, v) =
            (turn * DVec3::new(unit(0), unit(1), unit(2)), DVec3::new(unit(3), unit(4), unit(5)));
        let v = turn * v + omega.cross(lever_mm);
        [omega.x, omega.y, omega.z, v.x, v.y, v.z]
    };
    let columns: [[f64; 6]; 6] = core::array::from_fn(column);
    let half: [[f64; 6]; 6] = core::array::from_fn(|i| {
        core::array::from_fn(|k| (0..6).map(|j| columns[j][i] * first.covariance[j][k]).sum())
    });
    core::array::from_fn(|i| core::array::from_fn(|k| (0..6).map(|j| half[i][j] * columns[j][k]).sum()))
}

/// Adjoint of a pose: what a small motion (omega, v) is in the frame that the pose maps to (Barfoot 2017,
/// section 7.1).
pub(super) fn adjoint(pose: &Pose) -> [[f64; 6]; 6] {
    let (turn, shift_mm) = (pose.matrix(), pose.translation_mm);
    let mut rows = [[0.0; 6]; 6];
    for k in 0..3 {
        let (omega, lever) = (turn.col(k), shift_mm.cross(turn.col(k)));
        for i in 0..3 {
            (rows[i][k], rows[3 + i][k], rows[3 + i][3 + k]) = (omega[i], lever[i], omega[i]);
        }
    }
    rows
}

/// A B.
pub(super) fn times(a: &[[f64; 6]; 6], b: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    core::array::from_fn(|i| core::array::from_fn(|k| (0..6).map(|j| a[i][j] * b[j][k]).sum()))
}

/// A Bᵀ.
pub(super) fn times_transposed(a: &[[f64; 6]; 6], b: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    core::array::from_fn(|i| core::array::from_fn(|k| (0..6).map(|j| a[i][j] * b[k][j]).sum()))
}

/// A C Aᵀ, symmetric to the last bit.
pub(super) fn moved(a: &[[f64; 6]; 6], c: &Symmetric<6>) -> Symmetric<6> {
    let full = times_transposed(&times(a, c), a);
    core::array::from_fn(|i| core::array::from_fn(|k| full[i.min(k)][i.max(k)]))
}
