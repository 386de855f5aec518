//! What the contact says about the pose that was found: information, free directions, and other poses as likely.

use super::contact::Samples;
use super::odds::log_odds;
use super::polish::PolishScratch;
use super::search::Candidate;
use super::settled::SettledScratch;
use super::step::Placement;
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, Pose, sqrt};
use crate::params::RegisterParams;
use crate::register::observe::{PatchFrame, Sighting, System};
use crate::register::{FreeDirections, Registration};

/// Another pose that explains the contact about as well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alternative {
    /// Maps object coordinates to sensor coordinates.
    pub t_sensor_object: Pose,
    /// As [`Registration::log_likelihood`].
    pub log_likelihood: f64,
}

/// Up to two other poses, the likelier one first, without allocation; it reads, and prints, as a slice.
#[derive(Clone, Copy, PartialEq)]
pub struct Alternatives {
    all: [Alternative; 2],
    count: usize,
}

impl Alternatives {
    /// None.
    pub const NONE: Self =
        Self { all: [Alternative { t_sensor_object: Pose::IDENTITY, log_likelihood: 0.0 }; 2], count: 0 };

    pub(in crate::register) fn push(&mut self, one: Alternative) {
        if let Some(place) = self.all.get_mut(self.count) {
            *place = one;
            self.count += 1;
        }
    }
}

impl core::ops::Deref for Alternatives {
    type Target = [Alternative];

    fn deref(&self) -> &[Alternative] {
        &self.all[..self.count]
    }
}

impl core::fmt::Debug for Alternatives {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

/// A pose is an alternative when it is at least this likely, e^-4.6 = 1 %, and its difference is this many standard
/// deviations over the determined directions.
const LEAST_LOG: f64 = -4.6;
const APART: f64 = 5.0;

/// What the gel tells of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    pub press_direction: DVec3,
    /// About (ρ ω, v) about the centroid.
    pub information: Symmetric<6>,
    /// How far the step is that was not taken, over the patch.
    pub left_mm: f64,
}

/// Of the candidates, best first, from the readings at the best one.
pub(super) fn registration(
    params: &RegisterParams,
    samples: &Samples,
    candidates: &[Candidate],
    (scratch, settled, told): (&PolishScratch, &SettledScratch, Option<Told>),
    (converged, iterations): (bool, u32),
) -> Registration {
    let best = &candidates[0];
    let t_sensor_object = pose(samples, best);
    let back = t_sensor_object.rotation.conjugate();
    let sigma_mm = params.point_sigma_mm;
    // About the salient points' centroid, in the object's axes.
    let centre_mm = best.placement.object_point(DVec3::ZERO);
    let frame = PatchFrame { centre_mm, radius_mm: samples.radius_mm };
    let mut system = System::new(frame.radius_mm, sigma_mm);
    let (mut sum_squared, mut total, mut inliers) = (0.0, 0.0, 0);
    let points = samples.pressed.iter().chain(&samples.unpressed);
    for (k, ((sample, r), &touches)) in points.zip(&scratch.here.all).zip(&scratch.touches).enumerate() {
        if k < samples.pressed.len() {
            inliers += usize::from(r.distance_mm.abs() <= params.max_distance_mm);
            sum_squared += touches * r.distance_mm * r.distance_mm;
            total += touches;
        }
        if touches > 0.0 && told.is_none() {
            system.add(&Sighting {
                lever: back * sample.p_mm,
                normal: back * r.normal,
                residual: r.distance_mm,
                weight: touches * sigma_mm * sigma_mm / r.variance_mm2,
                normal_variance: r.curvature_per_mm * r.curvature_per_mm * r.variance_mm2,
            });
        }
    }
    if let Some(told) = &told {
        add_settled(&mut system, samples, settled, best, told);
    }
    if !converged {
        system.blur(told.map_or_else(|| system.left_mm(), |told| told.left_mm));
    }
    let in_object = system.observe(centre_mm);
    let observability = in_object.turned(&t_sensor_object, samples.centre_mm);
    let information = observability.information();
    Registration {
        t_sensor_object,
        information,
        observability,
        converged,
        iterations,
        inliers,
        points: samples.pressed.len(),
        rmse_mm: sqrt(sum_squared / total.max(f64::MIN_POSITIVE)),
        free: FreeDirections::new(&in_object, sigma_mm, &[]),
        log_likelihood: Some(-best.cost),
        log_odds: Some(log_odds(samples, &scratch.here, &scratch.touches, params.outlier_share)),
        gel_decay: None,
        alternatives: alternatives(samples, candidates, &about_centre(&observability)),
    }
}

/// What the heights of the gel tell, with the noise of the normals that they are told by.
fn add_settled(
    system: &mut System,
    samples: &Samples,
    settled: &SettledScratch,
    best: &Candidate,
    told: &Told,
) {
    let back = best.placement.pose.rotation.conjugate();
    let press = back * told.press_direction;
    let nodes = samples.gel.nodes.iter().zip(&settled.here.sights).zip(&settled.counts_per_mm2);
    for ((node, sight), count_per_mm2) in nodes.filter(|(_, count)| **count > 0.0) {
        let Some(foot) = sight.foot.as_ref() else { continue };
        let variance_mm2 = node.sample.variance(best.placement.sensor_direction(foot.normal));
        // A height is the distance along the normal over this.
        let cosine = foot.normal.dot(press);
        system.add(&Sighting {
            lever: back * node.sample.p_mm,
            normal: foot.normal,
            residual: 0.0,
            weight: count_per_mm2 * system.sigma_mm() * system.sigma_mm() / (cosine * cosine),
            normal_variance: foot.curvature_per_mm * foot.curvature_per_mm * variance_mm2,
        });
    }
    // (ρ ω, v) in the object's axes: both halves turned.
    let turn = crate::math::DMat3::from_quat(back);
    let turned = |x: [f64; 3]| (turn * DVec3::from_array(x)).to_array();
    let halves = |row: [f64; 6]| {
        let [a, b] = [turned([row[0], row[1], row[2]]), turned([row[3], row[4], row[5]])];
        [a[0], a[1], a[2], b[0], b[1], b[2]]
    };
    let rows = told.information.map(halves);
    let columns: [[f64; 6]; 6] = core::array::from_fn(|k| halves(core::array::from_fn(|i| rows[i][k])));
    system.replace_information(&columns);
}

fn pose(samples: &Samples, candidate: &Candidate) -> Pose {
    let pose = candidate.placement.pose;
    Pose { translation_mm: pose.translation_mm + samples.centre_mm, ..pose }
}

/// Information about (ω, v) about the patch's centroid.
fn about_centre(seen: &crate::register::Observability) -> Symmetric<6> {
    let origin = crate::register::Observability { centre_mm: DVec3::ZERO, ..*seen };
    origin.information()
}

fn alternatives(samples: &Samples, candidates: &[Candidate], information: &Symmetric<6>) -> Alternatives {
    let mut out = Alternatives::NONE;
    let Some((best, others)) = candidates.split_first() else { return out };
    let apart = |a: &Placement, b: &Placement| {
        let (omega, v) = a.since(b);
        let z = [omega.x, omega.y, omega.z, v.x, v.y, v.z];
        let squared: f64 = information
            .iter()
            .zip(z)
            .map(|(row, zi)| zi * row.iter().zip(z).map(|(h, zj)| h * zj).sum::<f64>())
            .sum();
        squared > APART * APART
    };
    for (k, one) in others.iter().enumerate() {
        let is_new = candidates[..=k].iter().all(|other| apart(&one.placement, &other.placement));
        if best.cost - one.cost >= LEAST_LOG && is_new {
            out.push(Alternative { t_sensor_object: pose(samples, one), log_likelihood: -one.cost });
        }
    }
    out
}
