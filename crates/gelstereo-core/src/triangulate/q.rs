//! The paper's rung: Q of Eq. 3 on rectified pixels.

use super::{Pair, StereoPoint};
use crate::math::linalg::Symmetric;
use crate::math::{DQuat, DVec3};
use crate::rig::Rectification;

/// The point of rectified pixels with the signed disparity of the row of the left view, in the sensor frame.
///
/// Its covariance is to first order, from centres that are independent; Eq. 3 takes the row of the left view alone;
/// axes of image and rectified image are taken to be parallel.
pub(super) fn point(r: &Rectification, to_sensor: DQuat, pair: &Pair<'_>) -> StereoPoint {
    let (left, right) = (pair.rectified[0], pair.rectified[1]);
    let scale = r.baseline_mm / (left.x - right.x);
    let p = DVec3::new((left.x - r.c_px.x) * scale, (left.y - r.c_px.y) * scale, r.f_px * scale);
    // d(X, Y, Z) / d(x_left, y_left, x_right), with Z = f B / d.
    let s = p.z / r.f_px; // mm per pixel at this depth
    let dz = p.z / r.baseline_mm * s; // mm of depth per pixel of disparity
    let along = p / p.z;
    let columns = [DVec3::X * s - along * dz, DVec3::Y * s, along * dz].map(|c| to_sensor * c);
    let [left_px2, right_px2] = pair.centres.map(|centre| centre.covariance_px2);
    let point_mm = to_sensor * p;
    let covariance_mm2 = propagate(&columns, &left_px2, right_px2[0][0]);
    StereoPoint { point_mm, covariance_mm2, epipolar_px: left.y - right.y }
}

fn propagate([u, v, w]: &[DVec3; 3], left_px2: &Symmetric<2>, ww: f64) -> Symmetric<3> {
    let [[uu, uv], [_, vv]] = *left_px2;
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            uu * u[i] * u[j] + uv * (u[i] * v[j] + v[i] * u[j]) + vv * v[i] * v[j] + ww * w[i] * w[j]
        })
    })
}
