//! Which directions of the pose a contact determines, and which it leaves free.
//!
//! A point x with surface normal n constrains a motion z only through the displacement along n. With
//! z = (ρ ω, v) about the patch's centroid c, ρ the patch's rms radius, that is J z with
//! J = ((x - c) × n / ρ, n). The information of the patch is H = Σ J Jᵀ / σ², σ the standard deviation of
//! a point along the normal. All rungs use this H, including the point-to-point ones: the tangential
//! distances in their cost are distances to samples, not to the surface, and carry no information about
//! sliding on a smooth contact.
//!
//! **When is a direction free?** x and n are noisy, so Σ J Jᵀ does not vanish even on a perfect sphere.
//! If δn has variance τ² across n and δx has σ² per axis,
//!
//! ```text
//! E[Σ δJ δJᵀ] = N = Σ τ² B (I - n nᵀ) Bᵀ + σ²/ρ² (I - n nᵀ)ₒ,   B = ([x - c]ₓ / ρ ; I)
//! ```
//!
//! (the last term acts on rotations). τ² follows from the template around the point. For the evidence it
//! is the spread of the normals within half a spacing (`facet`); for a step, the rotation of the normal
//! over the distance at which it was read (`Template::step_variance`). An eigenvector u of Σ J Jᵀ with
//! eigenvalue λ is free if λ is explained by such noise alone, or if it is known no better than to the
//! patch's size:
//!
//! ```text
//! λ <= (1 + 3 √(2/n)) uᵀ N u + σ²/ρ²
//! ```
//!
//! A sum of n squares has relative standard deviation √(2/n); three of them are allowed. A determined
//! direction keeps λ - uᵀ N u, the unbiased estimate, so its variance grows smoothly until it is free.
//! For degenerate registration see J. Zhang, M. Kaess, S. Singh, "On Degeneracy of Optimization-based
//! State Estimation Problems" (2016); there the threshold is tuned, here it follows from the noise.

use crate::math::linalg::{self, Eigen, Symmetric, Triangle};
use crate::math::{DVec3, Pose, centroid, so3, sqrt};
use crate::params::GuessSigma;

/// A vector over (ρ ωx, ρ ωy, ρ ωz, vx, vy, vz).
pub(super) type Vector6 = [f64; 6];

/// Centroid and rms radius of a patch: the centre of its rotations, and the length that makes rotations
/// comparable to translations.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchFrame {
    pub centre_mm: DVec3,
    pub radius_mm: f64,
}

impl PatchFrame {
    /// The frame of these points, with a radius of at least `min_radius_mm`.
    pub fn new(points_mm: &[DVec3], min_radius_mm: f64) -> Self {
        let centre_mm = centroid(points_mm);
        let sum: f64 = points_mm.iter().map(|p| p.distance_squared(centre_mm)).sum();
        let radius_mm = sqrt(sum / points_mm.len().max(1) as f64).max(min_radius_mm);
        Self { centre_mm, radius_mm }
    }

    /// The rotation ω about the centre and the translation v of the centre in a motion.
    pub fn twist(&self, motion: &Pose) -> (DVec3, DVec3) {
        (so3::log(motion.rotation), motion.transform_point(self.centre_mm) - self.centre_mm)
    }

    /// The twist (ω, v) about the centre whose exponential is the motion. For a slide, spin or screw of
    /// any length it lies along that direction.
    pub fn log(&self, motion: &Pose) -> (DVec3, DVec3) {
        let (_, shift_mm) = self.twist(motion);
        Pose { rotation: motion.rotation, translation_mm: shift_mm }.log()
    }

    /// The motion that rotates by ω about the centre and translates by v.
    pub fn motion(&self, (omega, v_mm): (DVec3, DVec3)) -> Pose {
        let rotation = so3::exp(omega);
        Pose { rotation, translation_mm: self.centre_mm + v_mm - rotation * self.centre_mm }
    }
}

/// Smallest share of the prior's variance, so that a covariance stays positive definite despite
/// round-off: a standard deviation of 20 nm for a guess known to 2 mm.
const MIN_SHARE: f64 = 1e-10;

/// One point's row of the linear system: it constrains motion along `normal`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    /// From the patch's centroid to the point.
    pub lever: DVec3,
    /// Unit normal of the surface.
    pub normal: DVec3,
    /// Signed distance that the point should move along the normal to reach the surface.
    pub residual: f64,
    /// Weight, 0 to 1.
    pub weight: f64,
    /// τ², variance of the normal along the axes across it, rad².
    pub normal_variance: f64,
}

/// Σ J Jᵀ, Σ J r and N over the points of a patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct System {
    radius_mm: f64,
    sigma_mm: f64,
    hessian: Triangle<6>,
    gradient: Vector6,
    noise: Triangle<6>,
    points: f64,
}

/// The eigenvectors of a patch's information, with zero values for undetermined ones.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Observability {
    /// Centroid c of the patch, the centre of rotations.
    pub centre_mm: DVec3,
    /// Rms radius ρ of the patch, which makes rotations comparable to translations.
    pub radius_mm: f64,
    /// Information along every direction, per mm²; exactly 0 along free ones.
    pub values: Vector6,
    /// Unit directions (ρ ω, v), one per row, by ascending information for exact normals.
    pub directions: [Vector6; 6],
}

impl System {
    /// Empty, for a patch of this rms radius whose points are known to `sigma_mm` along the normal.
    pub fn new(radius_mm: f64, sigma_mm: f64) -> Self {
        let (hessian, noise) = (Triangle::ZERO, Triangle::ZERO);
        Self { radius_mm, sigma_mm, hessian, gradient: [0.0; 6], noise, points: 0.0 }
    }

    pub fn add(&mut self, sighting: &Sighting) {
        let Sighting { lever, normal, residual, weight, normal_variance } = *sighting;
        let per_radius = 1.0 / self.radius_mm;
        let j = stack(lever.cross(normal) * per_radius, normal);
        self.hessian.add_outer(&j, weight);
        for (sum, j) in self.gradient.iter_mut().zip(j) {
            *sum += weight * residual * j;
        }
        // (I - n nᵀ) = a aᵀ + b bᵀ for any orthonormal a, b that complete the normal.
        let (a, b) = normal.any_orthonormal_pair();
        for across in [a, b] {
            let turned = stack(lever.cross(across) * per_radius, across);
            self.noise.add_outer(&turned, weight * normal_variance);
        }
        let shifted = self.sigma_mm * per_radius;
        let shifted = weight * shifted * shifted;
        for (i, row) in self.noise.0[..3].iter_mut().enumerate() {
            row[i] += shifted;
            (i..3).for_each(|k| row[k] -= shifted * normal[i] * normal[k]);
        }
        self.points += weight;
    }

    /// Standard deviation of the points along the normal.
    pub const fn sigma_mm(&self) -> f64 {
        self.sigma_mm
    }

    /// Replaces the information, per mm², by that of another source; the noise of the normals stays that
    /// of the points.
    pub fn replace_information(&mut self, information: &Symmetric<6>) {
        let sigma_squared = self.sigma_mm * self.sigma_mm;
        self.hessian = Triangle(information.map(|row| row.map(|x| x * sigma_squared)));
    }

    /// Inflates the covariance of a result that did not converge. The remaining error is about the next
    /// step: `left_mm` over the patch or, if unknown, that of [`Self::solve`], limited to the patch's
    /// radius. Only its size is reliable, so an independent error of that size is added in every
    /// direction: σ² / λ + left².
    pub fn blur(&mut self, left_mm: Option<f64>) {
        let spectrum = linalg::eigen(&self.hessian.whole());
        let left_mm = left_mm.unwrap_or_else(|| {
            let (omega, v_mm) = self.solve(&spectrum, self.radius_mm);
            sqrt((omega * self.radius_mm).length_squared() + v_mm.length_squared())
        });
        let blur = left_mm * left_mm / (self.sigma_mm * self.sigma_mm);
        self.hessian = Triangle::ZERO;
        for (value, u) in spectrum.values.iter().zip(&spectrum.vectors) {
            let value = value.max(0.0);
            self.hessian.add_outer(u, value / (1.0 + value * blur));
        }
    }

    /// Applies the criterion of this module, about a centroid.
    pub fn observe(&self, centre_mm: DVec3) -> Observability {
        self.observe_along(&linalg::eigen(&self.hessian.whole()), centre_mm)
    }

    /// As [`Self::observe`], with the eigenvectors of Σ J Jᵀ.
    fn observe_along(&self, eigen: &Eigen<6>, centre_mm: DVec3) -> Observability {
        let sigma_squared = self.sigma_mm * self.sigma_mm;
        let noise = self.noise.whole();
        let scatter = 1.0 + 3.0 * sqrt(2.0 / self.points.max(1.0));
        let values = core::array::from_fn(|k| {
            let noise = quadratic(&noise, &eigen.vectors[k]);
            let limit = scatter * noise + sigma_squared / (self.radius_mm * self.radius_mm);
            if eigen.values[k] > limit { (eigen.values[k] - noise) / sigma_squared } else { 0.0 }
        });
        Observability { centre_mm, radius_mm: self.radius_mm, values, directions: eigen.vectors }
    }

    /// The motion (ω, v) about the centroid that brings the points closest to the surface, zero along
    /// free directions, from the eigenvectors of Σ J Jᵀ. It is limited to `limit_mm` rms over the patch:
    /// a weak direction must not move the patch farther than tangent planes are valid.
    fn solve(&self, eigen: &Eigen<6>, limit_mm: f64) -> (DVec3, DVec3) {
        let seen = self.observe_along(eigen, DVec3::ZERO);
        let hessian = self.hessian.whole();
        let mut z = [0.0; 6];
        for (u, value) in seen.directions.iter().zip(seen.values) {
            if value > 0.0 {
                // λ instead of the smaller unbiased value: noise in J then shortens the step, and never
                // lengthens it.
                let step = dot(u, &self.gradient) / quadratic(&hessian, u);
                z.iter_mut().zip(u).for_each(|(z, u)| *z += step * u);
            }
        }
        let length = sqrt(dot(&z, &z));
        let share = if length > limit_mm { limit_mm / length } else { 1.0 };
        let (omega, v) = halves(&z.map(|z| z * share));
        (omega / self.radius_mm, v)
    }
}

impl Observability {
    /// Number of free directions.
    #[must_use]
    pub fn free_count(&self) -> usize {
        self.values.iter().filter(|&&value| value == 0.0).count()
    }

    /// Reduces the information by `excess`, the ratio of squared residuals to the noise (Birge 1932);
    /// ratios below 1 are chance.
    pub(super) fn widened(mut self, excess: f64) -> Self {
        self.values.iter_mut().for_each(|value| *value /= excess.max(1.0));
        self
    }

    /// Adds an error along a unit direction that all points share, of this standard deviation. Free
    /// directions stay as they are.
    pub(super) fn with_offset(&self, direction: DVec3, sigma_mm: f64) -> Self {
        let largest = self.values.iter().fold(0.0, |largest: f64, value| largest.max(*value));
        let mut information = [[0.0; 6]; 6];
        for (u, value) in self.directions.iter().zip(self.values) {
            // Free directions are set apart as the last ones.
            add_outer(&mut information, u, if value > 0.0 { value } else { 2.0 * largest });
        }
        let mut shift = stack(DVec3::ZERO, direction);
        for (u, _) in self.directions.iter().zip(self.values).filter(|(_, value)| *value == 0.0) {
            let along = dot(u, &shift);
            shift.iter_mut().zip(u).for_each(|(shift, u)| *shift -= along * u);
        }
        // (H⁻¹ + σ² w wᵀ)⁻¹ (Sherman and Morrison 1950).
        let weighted = information.map(|row| dot(&row, &shift));
        let variance = sigma_mm * sigma_mm;
        add_outer(&mut information, &weighted, -variance / (1.0 + variance * dot(&shift, &weighted)));
        let Eigen { values, vectors } = linalg::eigen(&information);
        let mut with = *self;
        let determined = (0..6).filter(|&k| self.values[k] > 0.0);
        for (k, (value, vector)) in determined.zip(values.into_iter().zip(vectors)) {
            (with.values[k], with.directions[k]) = (value, vector);
        }
        with
    }

    /// Information of a left perturbation (ω, v) about the frame's origin; singular along free directions.
    #[must_use]
    pub fn information(&self) -> Symmetric<6> {
        let mut sum = [[0.0; 6]; 6];
        for (u, value) in self.directions.iter().zip(self.values) {
            // z = (ρ ω, v + ω × c), so that zᵀ u = ωᵀ (ρ u_ω + c × u_v) + vᵀ u_v.
            let (omega, v) = halves(u);
            let row = stack(omega * self.radius_mm + self.centre_mm.cross(v), v);
            add_outer(&mut sum, &row, value);
        }
        sum
    }

    /// Covariance of the same perturbation, given the prior accuracy of the pose: (Λ + P⁻¹)⁻¹, P the
    /// prior's covariance of a rotation about the centroid and its translation. It is positive definite;
    /// along free directions it has the prior's variance.
    #[must_use]
    pub fn covariance(&self, prior: &GuessSigma) -> Symmetric<6> {
        let sigma_mm = [prior.turn_rad * self.radius_mm, prior.shift_mm];
        let scaled = |u: &Vector6| -> Vector6 { core::array::from_fn(|i| sigma_mm[i / 3] * u[i]) };
        // In standard deviations of the prior, S Λ S + I is well scaled whatever their sizes.
        let mut known = [[0.0; 6]; 6];
        (0..6).for_each(|i| known[i][i] = 1.0);
        for (u, value) in self.directions.iter().zip(self.values) {
            add_outer(&mut known, &scaled(u), value);
        }
        let linalg::Eigen { values, vectors } = linalg::eigen(&known);
        let along = vectors.map(|w| scaled(&w));
        self.spread(along.iter().zip(values.map(|value| 1.0 / value.clamp(1.0, 1.0 / MIN_SHARE))))
    }

    /// Covariance of the determined directions only, the pseudo-inverse of the information: zero along
    /// free ones.
    #[must_use]
    pub fn determined_covariance(&self) -> Symmetric<6> {
        let determined = self.directions.iter().zip(self.values).filter(|(_, value)| *value > 0.0);
        self.spread(determined.map(|(u, value)| (u, 1.0 / value)))
    }

    /// Covariance about the frame's origin of independent motions along directions, each with a variance
    /// in mm².
    fn spread<'a>(&self, along: impl Iterator<Item = (&'a Vector6, f64)>) -> Symmetric<6> {
        let mut sum = [[0.0; 6]; 6];
        for (u, variance) in along {
            let (omega, v) = self.motion(u);
            add_outer(&mut sum, &stack(omega, v - omega.cross(self.centre_mm)), variance);
        }
        sum
    }

    /// The same in another frame: directions rotated by `pose`, with the centroid's coordinates there.
    pub(super) fn turned(&self, pose: &Pose, centre_mm: DVec3) -> Self {
        let directions = self.directions.map(|u| {
            let (omega, v) = halves(&u);
            stack(pose.transform_vector(omega), pose.transform_vector(v))
        });
        Self { centre_mm, directions, ..*self }
    }

    /// Squared length of a motion (ω, v) about the centroid in standard deviations, over determined
    /// directions.
    pub(super) fn squared(&self, (omega, v_mm): (DVec3, DVec3)) -> f64 {
        let z = stack(omega * self.radius_mm, v_mm);
        self.directions.iter().zip(self.values).map(|(u, value)| value * dot(u, &z) * dot(u, &z)).sum()
    }

    /// The component of a motion (ω, v) about the centroid along determined directions.
    pub(super) fn determined(&self, (omega, v_mm): (DVec3, DVec3)) -> (DVec3, DVec3) {
        let z = stack(omega * self.radius_mm, v_mm);
        let mut kept = [0.0; 6];
        for (u, _) in self.directions.iter().zip(self.values).filter(|(_, value)| *value > 0.0) {
            let along = dot(u, &z);
            kept.iter_mut().zip(u).for_each(|(kept, u)| *kept += along * u);
        }
        self.motion(&kept)
    }

    /// (ω, v) about the centroid of a direction.
    fn motion(&self, u: &Vector6) -> (DVec3, DVec3) {
        let (omega, v) = halves(u);
        (omega / self.radius_mm, v)
    }
}

pub(super) const fn stack(a: DVec3, b: DVec3) -> Vector6 {
    [a.x, a.y, a.z, b.x, b.y, b.z]
}

pub(super) const fn halves(u: &Vector6) -> (DVec3, DVec3) {
    (DVec3::new(u[0], u[1], u[2]), DVec3::new(u[3], u[4], u[5]))
}

pub(super) fn dot(a: &Vector6, b: &Vector6) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn quadratic(matrix: &Symmetric<6>, u: &Vector6) -> f64 {
    matrix.iter().zip(u).map(|(row, ui)| ui * dot(row, u)).sum()
}

pub(super) fn add_outer(matrix: &mut Symmetric<6>, u: &Vector6, weight: f64) {
    for (row, ui) in matrix.iter_mut().zip(u) {
        row.iter_mut().zip(u).for_each(|(entry, uj)| *entry += weight * (ui * uj));
    }
}

#[cfg(test)]
mod tests;
