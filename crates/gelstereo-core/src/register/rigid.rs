//! The rigid motion between two sets of corresponding points (Horn 1987).

use crate::math::linalg::{self, Symmetric};
use crate::math::{DQuat, DVec3, Pose, so3};

/// The best motion, and how far the points determine it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidFit {
    /// Least squares motion, source to target; among equally good ones, that with the smallest rotation.
    pub t_target_source: Pose,
    /// Rotations that change the sum of squares by less than round-off: 0 for points that span a plane, 1 for
    /// collinear points (spin about their line), 3 for a single or identical points.
    pub free_rotations: usize,
}

/// Why points have no rigid motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RigidFitError {
    /// No points.
    Empty,
    /// The numbers of sources, targets and weights differ.
    Lengths {
        /// Source points found.
        source: usize,
        /// Target points found.
        target: usize,
        /// Weights found.
        weights: usize,
    },
    /// A coordinate is NaN, infinite or beyond 1e150.
    NotFinite {
        /// Which pair.
        index: usize,
    },
    /// A weight is negative, NaN or infinite.
    Weight {
        /// Which pair.
        index: usize,
        /// The weight found.
        found: f64,
    },
    /// All weights are zero.
    ZeroWeight,
}

impl core::fmt::Display for RigidFitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Empty => write!(f, "no points to align; a rigid fit needs at least one pair"),
            Self::Lengths { source, target, weights } => write!(
                f,
                "{source} source points, {target} target points and {weights} weights; they must be equally \
                many"
            ),
            Self::NotFinite { index } => {
                write!(f, "pair {index} has a coordinate that is NaN, infinite or beyond 1e150; remove it")
            }
            Self::Weight { index, found } => {
                write!(f, "weight {index} is {found}; weights are finite and at least 0")
            }
            Self::ZeroWeight => write!(f, "all weights are zero; at least one pair must count"),
        }
    }
}

impl core::error::Error for RigidFitError {}

/// Sums over pairs, in units of the largest weight, source radius and target radius. Nothing overflows,
/// and the result does not depend on the units of the input.
struct Moments {
    source_mean: DVec3,
    target_mean: DVec3,
    /// Rows of Σ w a bᵀ, with a and b relative to the means.
    correlation: [DVec3; 3],
    /// Largest difference of two eigenvalues of Horn's matrix due to round-off, including that of the input.
    round_off: f64,
}

/// The rotation and translation with the least weighted sum of squared distances R aᵢ + t to bᵢ. Never a
/// reflection.
///
/// Empty `weights` means equal weights; a weight of zero omits a pair. Sums are relative to the means, so
/// an offset of the clouds costs only the precision already lost in the input.
///
/// # Errors
/// [`RigidFitError`].
pub fn rigid_fit(source: &[DVec3], target: &[DVec3], weights: &[f64]) -> Result<RigidFit, RigidFitError> {
    check(source, target, weights)?;
    let moments = moments(source, target, weights)?;
    let (rotation, free_rotations) = best_rotation(&moments);
    let translation_mm = moments.target_mean - rotation * moments.source_mean;
    Ok(RigidFit { t_target_source: Pose { rotation, translation_mm }, free_rotations })
}

fn check(source: &[DVec3], target: &[DVec3], weights: &[f64]) -> Result<(), RigidFitError> {
    if source.len() != target.len() || !(weights.is_empty() || weights.len() == source.len()) {
        let (source, target, weights) = (source.len(), target.len(), weights.len());
        return Err(RigidFitError::Lengths { source, target, weights });
    }
    if source.is_empty() {
        return Err(RigidFitError::Empty);
    }
    let good = |p: &DVec3| p.abs().max_element() <= 1e150;
    // max_element may mask a NaN, hence is_finite as well.
    let bad = |(a, b): (&DVec3, &DVec3)| !(a.is_finite() && b.is_finite() && good(a) && good(b));
    if let Some(index) = source.iter().zip(target).position(bad) {
        return Err(RigidFitError::NotFinite { index });
    }
    match weights.iter().position(|w| !(w.is_finite() && *w >= 0.0)) {
        Some(index) => Err(RigidFitError::Weight { index, found: weights[index] }),
        None => Ok(()),
    }
}

fn moments(source: &[DVec3], target: &[DVec3], weights: &[f64]) -> Result<Moments, RigidFitError> {
    let heaviest = if weights.is_empty() { 1.0 } else { weights.iter().fold(0.0_f64, |m, &w| m.max(w)) };
    if heaviest == 0.0 {
        return Err(RigidFitError::ZeroWeight);
    }
    let weight = |i: usize| if weights.is_empty() { 1.0 } else { weights[i] / heaviest };
    let total: f64 = (0..source.len()).map(weight).sum();
    let (source_mean, source_radius) = mean_and_radius(source, &weight, total);
    let (target_mean, target_radius) = mean_and_radius(target, &weight, total);
    let (mut correlation, mut lost) = ([DVec3::ZERO; 3], 0.0);
    for (i, (&from, &to)) in source.iter().zip(target).enumerate().filter(|&(i, _)| weight(i) > 0.0) {
        let (a, b) = ((from - source_mean) / source_radius, (to - target_mean) / target_radius);
        let wa = a * weight(i);
        for (axis, row) in correlation.iter_mut().enumerate() {
            *row += b * wa[axis];
        }
        // The rounding of a point x is eps/2 |x|, including the offset of its cloud; each product and sum
        // adds another. Two eigenvalues differ by at most twice the sum of singular values of the
        // correlation's error.
        let offset = from.length() / source_radius * weight(i) * b.length()
            + to.length() / target_radius * wa.length();
        lost += offset + 8.0 * wa.length() * b.length();
    }
    Ok(Moments { source_mean, target_mean, correlation, round_off: f64::EPSILON * lost })
}

/// Weighted mean, and the largest distance along an axis from it (1 if all points coincide).
fn mean_and_radius(points: &[DVec3], weight: &impl Fn(usize) -> f64, total: f64) -> (DVec3, f64) {
    // Relative to a point of largest weight: a zero-weight point may be so far away that the mean loses
    // all digits.
    let heaviest = (0..points.len()).find(|&i| weight(i) == 1.0).unwrap_or(0);
    let origin = points[heaviest];
    // Twice, because the first mean of distant points is itself rounded.
    let mean = (0..2).fold(origin, |about, _| {
        let sum = points.iter().enumerate().fold(DVec3::ZERO, |sum, (i, &p)| sum + (p - about) * weight(i));
        about + sum / total
    });
    let radius = points
        .iter()
        .enumerate()
        .filter(|&(i, _)| weight(i) > 0.0)
        .fold(0.0_f64, |r, (_, &p)| r.max((p - mean).abs().max_element()));
    (mean, if radius > 0.0 { radius } else { 1.0 })
}

/// Unit quaternion with the largest qᵀ N q, and the number of further directions of q that are equally good.
fn best_rotation(moments: &Moments) -> (DQuat, usize) {
    let [x, y, z] = moments.correlation;
    // Horn's N for the order (x, y, z, w).
    let n: Symmetric<4> = [
        [x.x - y.y - z.z, x.y + y.x, z.x + x.z, y.z - z.y],
        [x.y + y.x, y.y - x.x - z.z, y.z + z.y, z.x - x.z],
        [z.x + x.z, y.z + z.y, z.z - x.x - y.y, x.y - y.x],
        [y.z - z.y, z.x - x.z, x.y - y.x, x.x + y.y + z.z],
    ];
    let eigen = linalg::eigen(&n);
    // The negated form counts a NaN bound as a tie.
    let tied = |k: &usize| !(eigen.values[3] - eigen.values[*k] > moments.round_off);
    let free = (0..3).filter(tied).count();
    // The projection of the identity onto the space of best quaternions is the best rotation of smallest
    // angle.
    let nearest = (0..4).filter(tied).fold([0.0; 4], |sum: [f64; 4], k| {
        core::array::from_fn(|i| sum[i] + eigen.vectors[k][3] * eigen.vectors[k][i])
    });
    let quaternion = |q: [f64; 4]| so3::canonical(DQuat::from_array(q));
    // A nearly zero projection is round-off; then all half turns are equally good.
    let share = nearest.iter().fold(0.0_f64, |m, q| m.max(q.abs()));
    let rotation = if free > 0 && share > 1e-8 { quaternion(nearest) } else { quaternion(eigen.vectors[3]) };
    (rotation.unwrap_or(DQuat::IDENTITY), free)
}
