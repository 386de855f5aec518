//! Robust rigid motion of markers with covariances.

use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, Factor, Pose, so3};

/// Standard deviations of the motion within one frame, about the last one: radians, and millimetres.
const FRAME_SIGMA: [f64; 2] = [0.02, 0.3];
/// Squared distance, in variances, at which a marker has half its weight (Cauchy's weights): the mean of
/// three components at three standard deviations.
const HALF: f64 = 9.0;
/// Squared distance from which a marker counts for nothing in the covariance: five standard deviations.
const OUTLIER: f64 = 25.0;
/// Rounds of reweighting; three to six are usual.
const MAX_ROUNDS: u32 = 12;
/// Largest last step, radians and millimetres: a thousandth of the noise of a marker.
const SETTLED: f64 = 1e-6;

/// A rigid motion with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RigidMotion {
    /// Moves points of the part from where they were when tracking began to where they are, sensor frame.
    pub pose: Pose,
    /// Centroid of the markers that stick, sensor frame, millimetres.
    pub about_mm: DVec3,
    /// Covariance of (omega, v), a small rotation about `about_mm` and a small translation, sensor frame:
    /// rad², rad mm and mm².
    pub covariance: Symmetric<6>,
}

/// Weights of the markers.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Weights {
    Equal,
    Cauchy,
    /// 1, or 0 for outliers.
    Inliers,
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
    let (mut pose, mut since_start) = (*start, [0.0; 6]);
    for round in 0..MAX_ROUNDS {
        let weights = if round > 0 { Weights::Cauchy } else { Weights::Equal };
        let (normal, right) = system(pairs, &pose, about_mm, weights, &since_start);
        let step = Factor::new(&normal)?.solve(&right);
        since_start = core::array::from_fn(|i| since_start[i] + step[i]);
        let [a, b, c, x, y, z] = step;
        let (omega, v) = (DVec3::new(a, b, c), DVec3::new(x, y, z));
        let turn = Pose { rotation: so3::exp(omega), translation_mm: DVec3::ZERO };
        let to = |at: DVec3| Pose::from_translation_mm(at);
        pose = (to(about_mm + v) * turn * to(-about_mm) * pose).normalized().ok()?;
        if round > 0 && omega.length().max(v.length()) < SETTLED {
            break;
        }
    }
    // Weights of Cauchy would state a fifth too much: markers without a fault have some of 0.8.
    let factor = Factor::new(&system(pairs, &pose, about_mm, Weights::Inliers, &since_start).0)?;
    let column = |k: usize| factor.solve(&core::array::from_fn(|i| f64::from(u8::from(i == k))));
    Some(RigidMotion { pose, about_mm, covariance: core::array::from_fn(column) })
}

/// Normal equations of the next step, lower triangle, after these steps since the start.
fn system(
    pairs: &[Pair],
    pose: &Pose,
    about_mm: DVec3,
    weights: Weights,
    since_start: &[f64; 6],
) -> (Symmetric<6>, [f64; 6]) {
    let mut normal = [[0.0; 6]; 6];
    let mut right = [0.0; 6];
    let [turn, shift] = FRAME_SIGMA.map(|sigma| 1.0 / (sigma * sigma));
    for (k, row) in normal.iter_mut().enumerate() {
        row[k] = if k < 3 { turn } else { shift };
        right[k] = -row[k] * since_start[k];
    }
    for pair in pairs {
        let at = pose.transform_point(pair.anchor_mm);
        let residual = (pair.point_mm - at).to_array();
        let weighted = pair.factor.solve(&residual);
        let squared: f64 = (0..3).map(|i| residual[i] * weighted[i]).sum();
        let weight = match weights {
            Weights::Equal => 1.0,
            Weights::Cauchy => 1.0 / (1.0 + squared / HALF),
            Weights::Inliers => f64::from(u8::from(squared < OUTLIER)),
        };
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
