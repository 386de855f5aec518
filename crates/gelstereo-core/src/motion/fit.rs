//! Motion from points of the part and elements of its surface.

use super::cloud::Element;
use crate::math::linalg::{Symmetric, Triangle, eigen};
use crate::math::{DMat3, DVec3, Pose, so3, solve_definite};
use crate::slip::RigidMotion;
use alloc::vec::Vec;

/// Squared distance, in variances, at which a row has half its weight, as in `slip`.
const HALF: f64 = 9.0;
/// Squared distance from which a row counts for nothing in the covariance: five standard deviations.
const OUTLIER: f64 = 25.0;
/// Rounds of reweighting and matching; four to seven are usual.
const MAX_ROUNDS: u32 = 20;
/// Largest last step, radians and millimetres: a hundredth of the noise of a motion.
const SETTLED: f64 = 1e-5;
/// Elements are matched up to this tangential distance, in marker distances: half the diagonal of a square
/// of four markers is 0.71.
const REACH: f64 = 0.75;
/// Cosine of the largest angle between the normals of matched elements: 32 degrees, a crease.
const FACING: f64 = 0.85;
/// Information about a direction is that of the surface if it exceeds this many times what the noise of the
/// normals alone would give. Noise of 20 normals gives 1 with a standard deviation of 0.2 to 0.3. With 3, the
/// spin of a simulated ball counted as seen, 17 degrees off at a stated standard deviation of 1. Chosen on
/// the contacts of `gelstereo_bench.reports.motion`.
const NOISE_RATIO: f64 = 10.0;

/// A point of the part at the keyframe and now.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub anchor_mm: DVec3,
    pub point_mm: DVec3,
    /// Inverse of the sum of both covariances.
    pub weight: DMat3,
}

/// What a motion is fitted to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Problem<'a> {
    pub pairs: &'a [Pair],
    /// Surface elements now, and at the keyframe.
    pub now: &'a [Element],
    pub before: &'a [Element],
    pub about_mm: DVec3,
    pub pitch_mm: f64,
    pub surface_sigma_mm: f64,
    /// Standard deviations of one frame's motion: radians and millimetres.
    pub free: [f64; 2],
    /// Frames since the keyframe.
    pub frames: f64,
    /// Rounds in which elements are matched anew; later ones do not jump between two matches.
    pub matching_rounds: u32,
}

/// A motion since the keyframe.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fitted {
    pub motion: RigidMotion,
    /// Covariance of the motion since the last frame.
    pub step_covariance: Symmetric<6>,
    pub determined: u8,
    pub matched: u32,
    /// Sum of the squared residuals of matched elements over their variances, without outliers.
    pub chi2: f64,
    /// Squared distance from the expected motion, in its variances.
    pub prior_cost: f64,
}

impl Fitted {
    /// Mean of the squared residuals of matched elements over their variances.
    pub fn mean_square(&self) -> f64 {
        self.chi2 / f64::from(self.matched).max(1.0)
    }
}

/// Normal equations in units of the free motion of one frame.
#[derive(Clone, Copy, Debug)]
struct Sums {
    information: Symmetric<6>,
    right: [f64; 6],
    matched: u32,
    chi2: f64,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Weights {
    Cauchy,
    /// 1, or 0 for outliers.
    Inliers,
}

impl Weights {
    fn at(self, squared: f64) -> f64 {
        match self {
            Self::Cauchy => 1.0 / (1.0 + squared / HALF),
            Self::Inliers => f64::from(u8::from(squared < OUTLIER)),
        }
    }
}

impl Problem<'_> {
    /// The most probable motion near `start`; `None` if a number is not finite.
    pub fn fit(&self, start: &Pose, matches: &mut Vec<Option<usize>>) -> Option<Fitted> {
        self.fit_from(start, [0.0; 6], matches)
    }

    /// The most probable motion near the one that is this many free motions away from the expected one.
    pub fn fit_from(
        &self,
        expected: &Pose,
        offset: [f64; 6],
        matches: &mut Vec<Option<usize>>,
    ) -> Option<Fitted> {
        // The sum of unknown motions of a constant rate grows with the number of frames.
        let prior = 1.0 / (self.frames * self.frames);
        let (mut pose, mut since_start) = (self.moved(expected, &offset)?, offset);
        for round in 0..MAX_ROUNDS {
            if round < self.matching_rounds {
                self.match_elements(&pose, matches);
            }
            let Sums { mut information, mut right, .. } = self.sums(&pose, matches, Weights::Cauchy);
            for k in 0..6 {
                information[k][k] += prior;
                right[k] -= prior * since_start[k];
            }
            let step = solve_definite(&information, &right)?;
            since_start = core::array::from_fn(|k| since_start[k] + step[k]);
            pose = self.moved(&pose, &step)?;
            let (omega, v) = self.unscaled(&step);
            if omega.length().max(v.length()) < SETTLED {
                break;
            }
        }
        let sums = self.sums(&pose, matches, Weights::Inliers);
        let found = eigen(&sums.information);
        let determined = found.values.iter().filter(|&&value| value > 1.0).count() as u8;
        let covariance = |prior: f64| {
            core::array::from_fn(|i| {
                core::array::from_fn(|k| {
                    let share = |j: usize| found.vectors[j][i] * found.vectors[j][k];
                    let sum: f64 = (0..6).map(|j| share(j) / (found.values[j].max(0.0) + prior)).sum();
                    sum * self.free[i / 3] * self.free[k / 3]
                })
            })
        };
        let motion = RigidMotion { pose, about_mm: self.about_mm, covariance: covariance(prior) };
        let prior_cost = prior * since_start.iter().map(|x| x * x).sum::<f64>();
        let (step_covariance, Sums { matched, chi2, .. }) = (covariance(1.0), sums);
        Some(Fitted { motion, step_covariance, determined, matched, chi2, prior_cost })
    }

    /// The pose after a small motion about the point of reference.
    fn moved(&self, pose: &Pose, step: &[f64; 6]) -> Option<Pose> {
        let (omega, v) = self.unscaled(step);
        let turn = Pose { rotation: so3::exp(omega), translation_mm: DVec3::ZERO };
        let to = |at: DVec3| Pose::from_translation_mm(at);
        (to(self.about_mm + v) * turn * to(-self.about_mm) * *pose).normalized().ok()
    }

    fn unscaled(&self, step: &[f64; 6]) -> (DVec3, DVec3) {
        let [a, b, c, x, y, z] = *step;
        (DVec3::new(a, b, c) * self.free[0], DVec3::new(x, y, z) * self.free[1])
    }

    fn row(&self, omega: DVec3, v: DVec3) -> [f64; 6] {
        let (omega, v) = (omega * self.free[0], v * self.free[1]);
        [omega.x, omega.y, omega.z, v.x, v.y, v.z]
    }

    fn sums(&self, pose: &Pose, matches: &[Option<usize>], weights: Weights) -> Sums {
        let mut sums = self.surface_sums(pose, matches, weights);
        for pair in self.pairs {
            let at_mm = pose.transform_point(pair.anchor_mm);
            let residual_mm = pair.point_mm - at_mm;
            let weighted = pair.weight * residual_mm;
            let weight = weights.at(residual_mm.dot(weighted));
            let lever_mm = at_mm - self.about_mm;
            // Motion of the point by each component: e × lever, and e.
            let columns = [DVec3::X, DVec3::Y, DVec3::Z].map(|e| e.cross(lever_mm) * self.free[0]);
            let shifts = [DVec3::X, DVec3::Y, DVec3::Z].map(|e| e * self.free[1]);
            let jacobian = [columns[0], columns[1], columns[2], shifts[0], shifts[1], shifts[2]];
            for (i, column) in jacobian.iter().enumerate() {
                sums.right[i] += weight * column.dot(weighted);
                let along = pair.weight * *column;
                for (k, other) in jacobian.iter().enumerate() {
                    sums.information[i][k] += weight * other.dot(along);
                }
            }
        }
        sums
    }

    /// Each element is compared with the nearest one of the keyframe.
    fn match_elements(&self, pose: &Pose, matches: &mut Vec<Option<usize>>) {
        let back = pose.inverse();
        let limit = REACH * REACH * self.pitch_mm * self.pitch_mm;
        matches.clear();
        matches.extend(self.now.iter().map(|element| {
            let at_mm = back.transform_point(element.point_mm);
            let normal = back.transform_vector(element.normal);
            let mut best = (f64::INFINITY, 0);
            for (k, other) in self.before.iter().enumerate() {
                let squared = other.point_mm.distance_squared(at_mm);
                if squared < best.0 {
                    best = (squared, k);
                }
            }
            let other = self.before.get(best.1)?;
            let off = at_mm - other.point_mm;
            let away = off.dot(other.normal);
            let is_near = best.0 - away * away < limit && away * away < limit;
            (is_near && normal.dot(other.normal) > FACING).then_some(best.1)
        }));
    }

    /// Symmetric point-to-plane distances, which vanish for all points of a surface of constant curvature
    /// (Rusinkiewicz 2019, "A symmetric objective function for ICP"). Directions whose information is that of
    /// noise are left out (Zhang et al. 2016, "On degeneracy of optimization-based state estimation
    /// problems").
    fn surface_sums(&self, pose: &Pose, matches: &[Option<usize>], weights: Weights) -> Sums {
        let (mut signal, mut noise) = (Triangle::ZERO, Triangle::ZERO);
        let (mut right, mut matched, mut chi2) = ([0.0; 6], 0, 0.0);
        let turn = pose.matrix();
        for (element, other) in self.now.iter().zip(matches) {
            let Some(other) = other.and_then(|k| self.before.get(k)) else { continue };
            let off_mm = element.point_mm - pose.transform_point(other.point_mm);
            let Some(normal) = (element.normal + turn * other.normal).try_normalize() else { continue };
            let residual_mm = off_mm.dot(normal);
            let normal_variance = 0.25 * (element.normal_variance + other.normal_variance);
            let back = turn.transpose() * normal;
            let variance = normal.dot(element.covariance_mm2 * normal)
                + back.dot(other.covariance_mm2 * back)
                + self.surface_sigma_mm * self.surface_sigma_mm
                + normal_variance * off_mm.length_squared();
            let squared = residual_mm * residual_mm / variance;
            let weight = weights.at(squared) / variance;
            // The rotation of the keyframe's normal moves the lever to the middle of both points.
            let lever_mm = element.point_mm - off_mm * 0.5 - self.about_mm;
            let jacobian = self.row(lever_mm.cross(normal), normal);
            signal.add_outer(&jacobian, weight);
            (0..6).for_each(|i| right[i] += weight * residual_mm * jacobian[i]);
            let (a, b) = normal.any_orthonormal_pair();
            for tangent in [a, b] {
                noise.add_outer(&self.row(lever_mm.cross(tangent), tangent), weight * normal_variance);
            }
            if weight > 0.0 {
                matched += 1;
                chi2 += squared.min(OUTLIER);
            }
        }
        let found = eigen(&signal.whole());
        let noise = noise.whole();
        // Residuals larger than their noise: the surface is not what it was (Birge 1932).
        let ratio = (chi2 / (f64::from(matched) - 6.0).max(1.0)).max(1.0);
        let mut sums = Sums { information: [[0.0; 6]; 6], right: [0.0; 6], matched, chi2 };
        for (value, u) in found.values.iter().zip(&found.vectors) {
            let along: f64 = (0..36).map(|n| u[n / 6] * noise[n / 6][n % 6] * u[n % 6]).sum();
            if *value <= NOISE_RATIO * along || *value <= 0.0 {
                continue;
            }
            let share: f64 = (0..6).map(|i| u[i] * right[i]).sum();
            for i in 0..6 {
                sums.right[i] += u[i] * share / ratio;
                (0..6).for_each(|k| sums.information[i][k] += value * u[i] * u[k] / ratio);
            }
        }
        sums
    }
}

/// Inverse of a sum of covariances; `None` if it is singular to rounding.
pub(super) fn inverse(covariance_mm2: &DMat3) -> Option<DMat3> {
    let determinant = covariance_mm2.determinant();
    (determinant > 0.0 && determinant.is_finite()).then(|| covariance_mm2.inverse())
}
