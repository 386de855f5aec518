//! The paper's rung: Q of Eq. 3 on rectified pixels.

use super::error::TriangulateError;
use super::point::{Pair, StereoPoint, finite, sum_of_squares};
use crate::math::{DQuat, DVec3};
use crate::rig::Rectification;

/// The point of rectified pixels with signed disparity at the row of the left view, in the sensor frame.
///
/// Its covariance is to first order, for independent centres. Eq. 3 uses the row of the left view alone;
/// axes of image and rectified image are taken to be parallel.
pub(super) fn point(
    r: &Rectification,
    to_sensor: DQuat,
    index: usize,
    pair: &Pair<'_>,
) -> Result<StereoPoint, TriangulateError> {
    let (left, right) = (pair.rectified[0], pair.rectified[1]);
    let scale = r.baseline_mm / (left.x - right.x);
    let p = DVec3::new((left.x - r.c_px.x) * scale, (left.y - r.c_px.y) * scale, r.f_px * scale);
    // d(X, Y, Z) / d(x_left, y_left, x_right), with Z = f B / d.
    let s = p.z / r.f_px; // mm per pixel at this depth
    let dz = p.z / r.baseline_mm * s; // mm of depth per pixel of disparity
    let along = p / p.z;
    let [u, v, w] = [DVec3::X * s - along * dz, DVec3::Y * s, along * dz].map(|c| to_sensor * c);
    let [l, r] = &pair.roots;
    // The right row is unused, so only the column's variance remains of the right covariance, xx².
    let covariance_mm2 = sum_of_squares(&[u * l.xx + v * l.yx, v * l.yy, w * r.xx]);
    finite(index, StereoPoint { point_mm: to_sensor * p, covariance_mm2, epipolar_px: left.y - right.y })
}
