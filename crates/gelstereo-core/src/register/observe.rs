//! What the contact determines of the pose, and what it leaves free.
//!
//! A point x with surface normal n sees a motion z only through the displacement along n. With z = (ρ ω, v) about the
//! patch's centroid c, ρ the patch's rms radius, that is J z with J = ((x - c) × n / ρ, n), so the information of the
//! patch is H = Σ J Jᵀ / σ², σ the standard deviation of a point along the normal. Every rung uses this H, the
//! point-to-point ones too: the tangential distances that they minimise as well are distances to samples, not to
//! the surface, and on a smooth contact they know nothing of sliding.
//!
//! **When is a direction free?** x and n carry noise, so Σ J Jᵀ would not vanish even on a perfect sphere. Where
//! δn has variance τ² across n and δx has σ² per axis,
//!
//! ```text
//! E[Σ δJ δJᵀ] = N = Σ τ² B (I - n nᵀ) Bᵀ + σ²/ρ² (I - n nᵀ)ₒ,   B = ([x - c]ₓ / ρ ; I)
//! ```
//!
//! (the last term acts on rotations). τ² follows from the template around the point: for the evidence it is the spread
//! of the normals within half a spacing (`facet`), for a step the turn over the distance at which the normal was read
//! (`Template::step_variance`). An eigenvector u of Σ J Jᵀ with eigenvalue λ is free when λ is no larger than such
//! noise makes it by itself, or when it is known no better than to the patch's own size:
//!
//! ```text
//! λ <= (1 + 3 √(2/n)) uᵀ N u + σ²/ρ²
//! ```
//!
//! A sum of n squares scatters by √(2/n) of itself; three standard deviations are allowed for. A direction that
//! is determined keeps λ - uᵀ N u, the unbiased estimate, so that its variance grows smoothly until it is free.
//! For degenerate registration see J. Zhang, M. Kaess, S. Singh, "On Degeneracy of Optimization-based State
//! Estimation Problems" (2016); there the threshold is tuned, here it follows from the noise.

use crate::math::linalg::{self, Eigen, Symmetric, Triangle};
use crate::math::{DVec3, Pose, centroid, so3, sqrt};
use crate::params::GuessSigma;

/// A vector over (ρ ωx, ρ ωy, ρ ωz, vx, vy, vz).
pub(super) type Vector6 = [f64; 6];

/// Centroid and rms radius of a patch: the point that its rotations are about and the length that makes them
/// comparable to translations.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchFrame {
    pub centre_mm: DVec3,
    pub radius_mm: f64,
}

impl PatchFrame {
    /// Of these points; a patch smaller than `least_radius_mm` counts as that large.
    pub fn new(points_mm: &[DVec3], least_radius_mm: f64) -> Self {
        let centre_mm = centroid(points_mm);
        let sum: f64 = points_mm.iter().map(|p| p.distance_squared(centre_mm)).sum();
        let radius_mm = sqrt(sum / points_mm.len().max(1) as f64).max(least_radius_mm);
        Self { centre_mm, radius_mm }
    }

    /// The turn ω about the centre and the shift v of it that a motion is made of.
    pub fn twist(&self, motion: &Pose) -> (DVec3, DVec3) {
        (so3::log(motion.rotation), motion.transform_point(self.centre_mm) - self.centre_mm)
    }

    /// The twist (ω, v) about the centre that the motion is the exponential of: that of a motion, however far, along
    /// directions that go on for ever lies along these.
    pub fn log(&self, motion: &Pose) -> (DVec3, DVec3) {
        let (_, shift_mm) = self.twist(motion);
        Pose { rotation: motion.rotation, translation_mm: shift_mm }.log()
    }

    /// The motion that turns by ω about the centre and shifts by v.
    pub fn motion(&self, (omega, v_mm): (DVec3, DVec3)) -> Pose {
        let rotation = so3::exp(omega);
        Pose { rotation, translation_mm: self.centre_mm + v_mm - rotation * self.centre_mm }
    }
}

/// Least share of the prior's variance, so that round-off leaves a covariance positive definite: with a guess known to 2 mm,
/// a standard deviation of 20 nm.
const MIN_SHARE: f64 = 1e-10;

/// One point's line of the linear system: it sees a motion along `normal`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    /// From the patch's centroid to the point.
    pub lever: DVec3,
    /// Unit normal of the surface.
    pub normal: DVec3,
    /// Distance to the surface along the normal: how far the point should move along it.
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

/// The eigenvectors of a patch's information and which of them it determines.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Observability {
    /// Centroid c of the patch, which the rotations are about.
    pub centre_mm: DVec3,
    /// Rms radius ρ of the patch, which makes rotations comparable to translations.
    pub radius_mm: f64,
    /// Information along every direction, per mm²; exactly 0 along free ones.
    pub values: Vector6,
    /// Unit directions (ρ ω, v), one a row, in the order of what they would know if normals were exact.
    pub directions: [Vector6; 6],
}

impl System {
    /// Empty, for a patch of that rms radius whose points are known to `sigma_mm` along the normal.
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
        // (I - n nᵀ) = a aᵀ + b bᵀ for any a, b that complete the normal.
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

    /// Points' standard deviation along the normal.
    pub const fn sigma_mm(&self) -> f64 {
        self.sigma_mm
    }

    /// Another source knows the information, per mm²; the noise of the normals stays that of the points.
    pub fn replace_information(&mut self, information: &Symmetric<6>) {
        let sigma_squared = self.sigma_mm * self.sigma_mm;
        self.hessian = Triangle(information.map(|row| row.map(|x| x * sigma_squared)));
    }

    /// An answer that steps did not end at is short of the best one by about the step that was not taken: `left_mm` over the
    /// patch or, where that is not known, as far as [`Self::solve`] would go and at most as the patch is wide. Where the
    /// steps would end is not known before they are taken, and that one tells how far rather than whereto: an error as large
    /// in every direction, on its own, is added to the covariance, σ² / λ + left².
    pub fn blur(&mut self, left_mm: Option<f64>) {
        let spectrum = linalg::eigen(&self.hessian.whole());
        let left_mm = left_mm.unwrap_or_else(|| {
            let (omega, v_mm) = self.solve_along(&spectrum, self.radius_mm);
            sqrt((omega * self.radius_mm).length_squared() + v_mm.length_squared())
        });
        let blur = left_mm * left_mm / (self.sigma_mm * self.sigma_mm);
        self.hessian = Triangle::ZERO;
        for (value, u) in spectrum.values.iter().zip(&spectrum.vectors) {
            let value = value.max(0.0);
            self.hessian.add_outer(u, value / (1.0 + value * blur));
        }
    }

    /// The rule of this module, about a centroid.
    pub fn observe(&self, centre_mm: DVec3) -> Observability {
        self.observe_along(&linalg::eigen(&self.hessian.whole()), centre_mm)
    }

    /// The same, by the eigenvectors of Σ J Jᵀ.
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

    /// The motion (ω, v) about the centroid that brings the points closest to the surface, still along the free
    /// directions. It moves no more than `limit_mm` rms over the patch: the planes say nothing of places farther off
    /// than the correspondences, and a weak direction must not carry the patch there.
    pub fn solve(&self, limit_mm: f64) -> (DVec3, DVec3) {
        self.solve_along(&linalg::eigen(&self.hessian.whole()), limit_mm)
    }

    /// The same, by the eigenvectors of Σ J Jᵀ.
    fn solve_along(&self, eigen: &Eigen<6>, limit_mm: f64) -> (DVec3, DVec3) {
        let seen = self.observe_along(eigen, DVec3::ZERO);
        let hessian = self.hessian.whole();
        let mut z = [0.0; 6];
        for (u, value) in seen.directions.iter().zip(seen.values) {
            if value > 0.0 {
                // λ rather than the smaller unbiased value: the noise in J shortens the step, and never lengthens it.
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

    /// Where residuals are larger than the noise says, by `excess` in their squares, so are the errors of the pose (Birge
    /// 1932); smaller ones are chance.
    pub(super) fn widened(mut self, excess: f64) -> Self {
        self.values.iter_mut().for_each(|value| *value /= excess.max(1.0));
        self
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

    /// Covariance of the same perturbation, given how well the pose was known before: (Λ + P⁻¹)⁻¹, with P the prior's
    /// covariance of a turn about the centroid and a shift of it. It is positive definite; along free directions it has
    /// the prior's variance.
    #[must_use]
    pub fn covariance(&self, prior: &GuessSigma) -> Symmetric<6> {
        let sigma_mm = [prior.turn_rad * self.radius_mm, prior.shift_mm];
        let scaled = |u: &Vector6| -> Vector6 { core::array::from_fn(|i| sigma_mm[i / 3] * u[i]) };
        // In standard deviations of the prior: S Λ S + I, whatever their sizes.
        let mut known = [[0.0; 6]; 6];
        (0..6).for_each(|i| known[i][i] = 1.0);
        for (u, value) in self.directions.iter().zip(self.values) {
            add_outer(&mut known, &scaled(u), value);
        }
        let linalg::Eigen { values, vectors } = linalg::eigen(&known);
        let along = vectors.map(|w| scaled(&w));
        self.spread(along.iter().zip(values.map(|value| 1.0 / value.clamp(1.0, 1.0 / MIN_SHARE))))
    }

    /// Covariance over the determined directions alone, the pseudo-inverse of the information: zero along free ones.
    #[must_use]
    pub fn determined_covariance(&self) -> Symmetric<6> {
        let determined = self.directions.iter().zip(self.values).filter(|(_, value)| *value > 0.0);
        self.spread(determined.map(|(u, value)| (u, 1.0 / value)))
    }

    /// Covariance about the frame's origin of independent motions along directions, each with its variance, mm².
    fn spread<'a>(&self, along: impl Iterator<Item = (&'a Vector6, f64)>) -> Symmetric<6> {
        let mut sum = [[0.0; 6]; 6];
        for (u, variance) in along {
            let (omega, v) = self.motion(u);
            add_outer(&mut sum, &stack(omega, v - omega.cross(self.centre_mm)), variance);
        }
        sum
    }

    /// The same with the axes turned and about another name of the centroid.
    pub(super) fn turned(&self, pose: &Pose, centre_mm: DVec3) -> Self {
        let directions = self.directions.map(|u| {
            let (omega, v) = halves(&u);
            stack(pose.transform_vector(omega), pose.transform_vector(v))
        });
        Self { centre_mm, directions, ..*self }
    }

    /// A motion (ω, v) about the centroid in standard deviations, squared, over the determined directions.
    pub(super) fn squared(&self, (omega, v_mm): (DVec3, DVec3)) -> f64 {
        let z = stack(omega * self.radius_mm, v_mm);
        self.directions.iter().zip(self.values).map(|(u, value)| value * dot(u, &z) * dot(u, &z)).sum()
    }

    /// The part of a motion (ω, v) about the centroid that is along determined directions.
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
