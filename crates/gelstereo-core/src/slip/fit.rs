//! Robust rigid motion of markers with covariances.

use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, Factor, Pose, so3};

/// Standard deviations of the motion within one frame, about the last one: radians, and millimetres.
const FRAME_SIGMA: [f64; 2] = [0.02, 0.3];
/// Squared distance, in variances, at which a marker has half its weight (Cauchy's weights): the mean of
/// three components at three standard deviations.
const HALF: f64 = 9.0;
/// Rounds of reweighting; three to six are usual.
const MAX_ROUNDS: u32 = 12;
/// Largest last step, radians and millimetres: a thousandth of the noise of a marker.
const SETTLED: f64 = 1e-6;

/// A rigid motion with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RigidMotion {
    /// Moves points of the part from where they were at touch to where they are, sensor frame.
    pub pose: Pose,
    /// Centroid of the markers that stick, sensor frame, millimetres.
    pub about_mm: DVec3,
    /// Covariance of (omega, v), a small rotation about `about_mm` and a small translation, sensor frame:
    /// rad², rad mm and mm².
    pub covariance: Symmetric<6>,
}

/// A marker where it touched the part and where it is now.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    /// Part frame, which is the sensor frame at touch.
    pub anchor_mm: DVec3,
    /// Sensor frame.
    pub point_mm: DVec3,
    /// Sum of the covariances of both.
    pub factor: Factor<3>,
}

/// The most probable motion near `start`; `None` if the markers do not determine it.
pub(super) fn rigid(pairs: &[Pair], start: &Pose) -> Option<RigidMotion> {
    let about_mm = pairs.iter().map(|pair| pair.point_mm).sum::<DVec3>() / pairs.len() as f64;
    let mut pose = *start;
    let mut factor = None;
    for round in 0..MAX_ROUNDS {
        let (normal, right) = system(pairs, &pose, about_mm, round > 0);
        let solved = Factor::new(&normal)?;
        let [a, b, c, x, y, z] = solved.solve(&right);
        let (omega, v) = (DVec3::new(a, b, c), DVec3::new(x, y, z));
        let turn = Pose { rotation: so3::exp(omega), translation_mm: DVec3::ZERO };
        let to = |at: DVec3| Pose::from_translation_mm(at);
        pose = (to(about_mm + v) * turn * to(-about_mm) * pose).normalized().ok()?;
        factor = Some(solved);
        if round > 0 && omega.length().max(v.length()) < SETTLED {
            break;
        }
    }
    let factor = factor?;
    let column = |k: usize| factor.solve(&core::array::from_fn(|i| f64::from(u8::from(i == k))));
    Some(RigidMotion { pose, about_mm, covariance: core::array::from_fn(column) })
}

/// Normal equations of the next step, lower triangle. The first one has equal weights.
fn system(pairs: &[Pair], pose: &Pose, about_mm: DVec3, is_robust: bool) -> (Symmetric<6>, [f64; 6]) {
    let mut normal = [[0.0; 6]; 6];
    let mut right = [0.0; 6];
    let [turn, shift] = FRAME_SIGMA.map(|sigma| 1.0 / (sigma * sigma));
    for (k, row) in normal.iter_mut().enumerate() {
        row[k] = if k < 3 { turn } else { shift };
    }
    for pair in pairs {
        let at = pose.transform_point(pair.anchor_mm);
        let residual = (pair.point_mm - at).to_array();
        let weighted = pair.factor.solve(&residual);
        let squared: f64 = (0..3).map(|i| residual[i] * weighted[i]).sum();
        let weight = if is_robust { 1.0 / (1.0 + squared / HALF) } else { 1.0 };
        let jacobian = columns(at - about_mm);
        for (j, column) in jacobian.iter().enumerate() {
            let solved = pair.factor.solve(column);
            right[j] += weight * dot(column, &weighted);
            for (i, other) in jacobian.iter().enumerate().take(j + 1) {
                normal[j][i] += weight * dot(other, &solved);
            }
        }
    }
    (normal, right)
}

/// Motion of a point at `lever` by each component of (omega, v).
pub(super) fn columns(lever: DVec3) -> [[f64; 3]; 6] {
    let DMat3 { x_axis, y_axis, z_axis } = so3::hat(-lever);
    [x_axis, y_axis, z_axis, DVec3::X, DVec3::Y, DVec3::Z].map(|column| column.to_array())
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
