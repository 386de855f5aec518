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
//! E[Σ δJ δJᵀ] = N = Σ τ² B (I - n nᵀ) Bᵀ + σ²/ρ² (I - n nᵀ)ₒ,   B = ([x - c]ₓ / ρ ; I),   τ² = κ² (σ² + t²/2)
//! ```
//!
//! (the last term acts on rotations), with κ the template's curvature at the point and t the tangential distance at
//! which its normal was read: the normal turns by κ per millimetre. An eigenvector u of Σ J Jᵀ with eigenvalue λ is
//! free when λ is no larger than such noise makes it by itself, or when it is known no better than to the patch's
//! own size:
//!
//! ```text
//! λ <= (1 + 3 √(2/n)) uᵀ N u + σ²/ρ²
//! ```
//!
//! A sum of n squares scatters by √(2/n) of itself; three standard deviations are allowed for. A direction that
//! is determined keeps λ - uᵀ N u, the unbiased estimate, so that its variance grows smoothly until it is free.
//! For degenerate registration see J. Zhang, M. Kaess, S. Singh, "On Degeneracy of Optimization-based State
//! Estimation Problems" (2016); there the threshold is tuned, here it follows from the noise.

use super::template::Template;
use crate::math::linalg::{self, Symmetric};
use crate::math::{DVec3, Pose, centroid, so3, sqrt};

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

    /// The motion that turns by ω about the centre and shifts by v.
    pub fn motion(&self, (omega, v_mm): (DVec3, DVec3)) -> Pose {
        let rotation = so3::exp(omega);
        Pose { rotation, translation_mm: self.centre_mm + v_mm - rotation * self.centre_mm }
    }
}

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
    /// κ of the surface there, rad/mm.
    pub curvature_per_mm: f64,
    /// t², the squared tangential distance from the point to where the normal was read.
    pub tangential_squared: f64,
}

impl Sighting {
    /// Of the plane of template point `nearest`, with weight 1.
    pub fn nearest(template: &Template, nearest: usize, point: DVec3, lever: DVec3) -> Self {
        let normal = template.normals()[nearest];
        let offset = template.points_mm()[nearest] - point;
        let residual = normal.dot(offset);
        Self {
            lever,
            normal,
            residual,
            weight: 1.0,
            curvature_per_mm: template.curvatures_per_mm()[nearest],
            tangential_squared: (offset - normal * residual).length_squared(),
        }
    }
}

/// Σ J Jᵀ, Σ J r and N over the points of a patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct System {
    radius_mm: f64,
    sigma_mm: f64,
    /// Curvature above which a normal counts as exact.
    edge_per_mm: f64,
    hessian: Symmetric<6>,
    gradient: Vector6,
    noise: Symmetric<6>,
    points: f64,
}

/// The eigenvectors of a patch's information and which of them it determines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observability {
    /// Centroid c of the patch, which the rotations are about.
    pub centre_mm: DVec3,
    /// Rms radius ρ of the patch, which makes rotations comparable to translations.
    pub radius_mm: f64,
    /// Information along every direction, per mm², ascending; exactly 0 along free ones.
    pub values: Vector6,
    /// Unit directions (ρ ω, v), one a row.
    pub directions: [Vector6; 6],
}

impl System {
    /// For what a patch of that rms radius knows of the pose, its points known to `sigma_mm` along the normal.
    pub fn evidence(radius_mm: f64, sigma_mm: f64) -> Self {
        let zero = [[0.0; 6]; 6];
        let (edge_per_mm, gradient) = (f64::INFINITY, [0.0; 6]);
        Self { radius_mm, sigma_mm, edge_per_mm, hessian: zero, gradient, noise: zero, points: 0.0 }
    }

    /// For a step towards the surface. Where it bends within a spacing, κ s > 1, the linear δn = κ t means nothing. Such
    /// an edge is no evidence of where the patch is, but a patch that overhangs it has to be able to slide back.
    pub fn step(radius_mm: f64, sigma_mm: f64, spacing_mm: f64) -> Self {
        Self { edge_per_mm: 1.0 / spacing_mm, ..Self::evidence(radius_mm, sigma_mm) }
    }

    pub fn add(&mut self, sighting: &Sighting) {
        let Sighting { lever, normal, residual, weight, curvature_per_mm, tangential_squared } = *sighting;
        let j = stack(lever.cross(normal) / self.radius_mm, normal);
        let sigma_squared = self.sigma_mm * self.sigma_mm;
        let turns = if curvature_per_mm > self.edge_per_mm { 0.0 } else { curvature_per_mm };
        let tau_squared = turns * turns * (sigma_squared + 0.5 * tangential_squared);
        add_outer(&mut self.hessian, &j, weight);
        for (sum, j) in self.gradient.iter_mut().zip(j) {
            *sum += weight * residual * j;
        }
        // (I - n nᵀ) = a aᵀ + b bᵀ for any a, b that complete the normal.
        let (a, b) = normal.any_orthonormal_pair();
        for across in [a, b] {
            let turned = stack(lever.cross(across) / self.radius_mm, across);
            add_outer(&mut self.noise, &turned, weight * tau_squared);
            let shifted = stack(across / self.radius_mm, DVec3::ZERO);
            add_outer(&mut self.noise, &shifted, weight * sigma_squared);
        }
        self.points += weight;
    }

    /// The rule of this module, about a centroid.
    pub fn observe(&self, centre_mm: DVec3) -> Observability {
        let eigen = linalg::eigen(&self.hessian);
        let sigma_squared = self.sigma_mm * self.sigma_mm;
        let scatter = 1.0 + 3.0 * sqrt(2.0 / self.points.max(1.0));
        let values = core::array::from_fn(|k| {
            let noise = quadratic(&self.noise, &eigen.vectors[k]);
            let limit = scatter * noise + sigma_squared / (self.radius_mm * self.radius_mm);
            if eigen.values[k] > limit { (eigen.values[k] - noise) / sigma_squared } else { 0.0 }
        });
        Observability { centre_mm, radius_mm: self.radius_mm, values, directions: eigen.vectors }
    }

    /// The motion (ω, v) about the centroid that brings the points closest to the surface, still along the free
    /// directions.
    pub fn solve(&self) -> (DVec3, DVec3) {
        let seen = self.observe(DVec3::ZERO);
        let mut z = [0.0; 6];
        for (u, value) in seen.directions.iter().zip(seen.values) {
            if value > 0.0 {
                // λ rather than the smaller unbiased value: the noise in J shortens the step, and never lengthens it.
                let step = dot(u, &self.gradient) / quadratic(&self.hessian, u);
                z.iter_mut().zip(u).for_each(|(z, u)| *z += step * u);
            }
        }
        (DVec3::new(z[0], z[1], z[2]) / self.radius_mm, DVec3::new(z[3], z[4], z[5]))
    }
}

impl Observability {
    /// Number of free directions.
    #[must_use]
    pub fn free_count(&self) -> usize {
        self.values.iter().filter(|&&value| value == 0.0).count()
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

    /// Covariance of the same perturbation over the determined directions; it is zero along free ones, where the
    /// variance has no bound.
    #[must_use]
    pub fn covariance(&self) -> Symmetric<6> {
        let mut sum = [[0.0; 6]; 6];
        for (u, value) in self.directions.iter().zip(self.values) {
            if value > 0.0 {
                let (omega, v) = self.motion(u);
                add_outer(&mut sum, &stack(omega, v - omega.cross(self.centre_mm)), 1.0 / value);
            }
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

fn dot(a: &Vector6, b: &Vector6) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn quadratic(matrix: &Symmetric<6>, u: &Vector6) -> f64 {
    matrix.iter().zip(u).map(|(row, ui)| ui * dot(row, u)).sum()
}

fn add_outer(matrix: &mut Symmetric<6>, u: &Vector6, weight: f64) {
    for (row, ui) in matrix.iter_mut().zip(u) {
        row.iter_mut().zip(u).for_each(|(entry, uj)| *entry += weight * (ui * uj));
    }
}
