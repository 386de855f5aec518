//! Assessment of the found pose: information matrix, free directions, and alternatives.

use super::candidate::{Candidate, End};
use super::contact::Samples;
use super::evidence_ratio::{odds, searched};
use super::gel::prediction::GelFitScratch;
use super::refine::RefineScratch;
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, Pose, sqrt};
use crate::params::{RegisterMethod, RegisterParams};
use crate::register::observe::{Sighting, System, dot, stack};
use crate::register::{Alternative, Alternatives, FreeDirections, Observability, Registration, Verdict};
use core::f64::consts::PI;

/// Least share of the information that remains after the missing information; with less, the quadratic
/// approximation is not valid.
const MIN_CURVED: f64 = 0.5;

/// Information of the gel about a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    pub press_direction: DVec3,
    /// Of (ρ ω, v) about the centroid.
    pub information: Symmetric<6>,
    /// Length of the step that was not taken, over the patch.
    pub left_mm: f64,
}

/// Readings at a pose: distances, gel heights, and the gel's information if its model was used.
pub(super) type AtBest<'a> = (&'a RefineScratch, &'a GelFitScratch, Option<Told>);

/// Result for the best candidate, from the readings there, or where the part looks the same.
pub(super) fn registration(
    params: &RegisterParams,
    samples: &Samples,
    (candidates, read): (&[Candidate], &Candidate),
    readings: AtBest<'_>,
    end: End,
) -> Registration {
    let (best, scratch) = (&candidates[0], readings.0);
    let t_sensor_object = pose(samples, best);
    let back = t_sensor_object.inverse();
    let (mut sum_squared, mut total, mut inliers) = (0.0, 0.0, 0);
    for (r, touches) in scratch.here.all[..samples.pressed.len()].iter().zip(&scratch.touches) {
        inliers += usize::from(r.distance_mm.abs() <= params.advanced.max_distance_mm);
        sum_squared += touches * r.distance_mm * r.distance_mm;
        total += touches;
    }
    let asked = readings.2.is_some().then_some(readings.1);
    let mut in_object = observe(params, samples, read, readings, end.converged);
    if let Some(settled) = asked {
        let touching = settled.here.touching_misfit(params.advanced.outlier_share, |_| false);
        in_object = in_object.widened(law_excess(samples, touching));
    }
    // Salient markers carry pressure and should be in contact. If the gel is known but its model explains
    // too little, the test fails.
    let is_salient = |k: usize| samples.gel.nodes[k].index < samples.pressed.len();
    let tested = match asked {
        Some(settled) => Some(settled.here.touching_misfit(params.advanced.outlier_share, is_salient)),
        None if params.method == RegisterMethod::SurfaceSearch && samples.gel.is_known() => {
            Some((f64::INFINITY, 0.0))
        }
        None => None,
    };
    let at_pose = odds(params, samples, (scratch, asked)).log;
    // A single start searches nowhere else.
    let has_searched = params.method == RegisterMethod::SurfaceSearch;
    let elsewhere = if has_searched { searched(params, &in_object, candidates) } else { 0.0 };
    let observability = in_object.turned(&pose(samples, read), samples.centre_mm);
    let information = observability.information();
    Registration {
        t_sensor_object,
        information,
        observability,
        guess_sigma: params.guess_sigma(),
        converged: end.converged,
        iterations: end.iterations,
        inliers,
        points: samples.pressed.len(),
        rmse_mm: sqrt(sum_squared / total.max(f64::MIN_POSITIVE)),
        free: FreeDirections::new(
            &observability.turned(&back, back.transform_point(samples.centre_mm)),
            params.point_sigma_mm,
            &[],
        ),
        log_likelihood: Some(-best.cost),
        log_odds: Some(at_pose - elsewhere),
        verdict: Verdict::new(at_pose - elsewhere, tested, end.converged),
        gel_decay: None,
        alternatives: Alternatives::NONE,
    }
}

/// Ratio of the variances to those of independent noise, from the mean squared deviation of the markers
/// in contact, and their number.
///
/// Errors of the gel model are common to neighbours within a decay length l, i.e. to n = π l² / pitch²
/// markers. Of the mean square χ², 1 is noise and the rest is that error. A sum over n markers has the
/// variance n + n² (χ² - 1) instead of n.
fn law_excess(samples: &Samples, (squared, touching): (f64, f64)) -> f64 {
    let shared = (PI * samples.gel.stiffness(0.0)).min(touching);
    1.0 + shared * (squared - 1.0).max(0.0)
}

/// Determined and free directions of a pose in the object's frame, from the readings there, and whether
/// its steps converged.
pub(super) fn observe(
    params: &RegisterParams,
    samples: &Samples,
    best: &Candidate,
    (scratch, settled, told): AtBest<'_>,
    converged: bool,
) -> Observability {
    let placement = &best.placement;
    let sigma_mm = params.point_sigma_mm;
    // Only these were in contact during the steps. Others pushed at most, which bounds one side alone.
    let touching = || {
        let points = samples.pressed.iter().zip(&scratch.here.all).zip(&scratch.touches);
        points.filter(|(_, touches)| **touches > 0.0)
    };
    let mut system = System::new(samples.radius_mm, sigma_mm);
    if let Some(told) = &told {
        add_settled(&mut system, samples, settled, best, told);
    } else {
        for ((sample, r), touches) in touching() {
            system.add(&Sighting {
                lever: placement.object_direction(sample.p_mm),
                normal: placement.object_direction(r.normal),
                residual: r.distance_mm,
                weight: touches * sigma_mm * sigma_mm / r.variance_mm2,
                normal_variance: r.curvature_per_mm * r.curvature_per_mm * r.variance_mm2,
            });
        }
    }
    if !converged {
        system.blur(told.map(|told| told.left_mm));
    }
    // About the salient points' centroid, in the object's axes.
    let mut seen = system.observe(placement.object_point(DVec3::ZERO));
    if told.is_none() {
        let per_radius = 1.0 / samples.radius_mm;
        let mut doubts = [Doubt::default(); 6];
        for ((sample, r), touches) in touching() {
            let precision = 1.0 / r.variance_mm2;
            let r_squared = r.distance_mm * r.distance_mm * precision;
            let normal = placement.object_direction(r.normal);
            let j = stack(placement.object_direction(sample.p_mm).cross(normal) * per_radius, normal);
            for (doubt, u) in doubts.iter_mut().zip(&seen.directions) {
                let along = dot(u, &j);
                doubt.add(*touches, along * along * precision, r_squared);
            }
        }
        for (value, doubt) in seen.values.iter_mut().zip(&doubts).filter(|(value, _)| **value > 0.0) {
            *value /= 1.0 + *value * doubt.variance();
        }
    }
    seen
}

/// Additional variance along a direction, since the points in contact are uncertain.
///
/// For known weights the information is Σ w t. But they change with the pose, and the curvature of the
/// likelihood is only Σ w t (1 - (1 - w) r²) (Louis 1982). Where the gradients of the points, w r each,
/// scatter more than that curvature implies, the variance is Σ w² t r² over the curvature squared (White
/// 1982).
#[derive(Clone, Copy, Debug, Default)]
struct Doubt {
    told: f64,
    missing: f64,
    pulls: f64,
}

impl Doubt {
    /// Adds a point: its contact probability w, its information t = J² / σ², and its squared distance
    /// r² / σ².
    fn add(&mut self, w: f64, t: f64, r_squared: f64) {
        let pulls = w * t * r_squared;
        self.told += w * t;
        self.missing += (1.0 - w) * pulls;
        self.pulls += w * pulls;
    }

    fn variance(&self) -> f64 {
        let Self { told, missing, pulls } = *self;
        if !(told > 0.0) {
            return 0.0;
        }
        let curved = (told - missing).max(MIN_CURVED * told);
        (1.0 / curved).max(pulls / (curved * curved)) - 1.0 / told
    }
}

/// Adds the information of the gel heights, with the noise of their normals.
fn add_settled(
    system: &mut System,
    samples: &Samples,
    settled: &GelFitScratch,
    best: &Candidate,
    told: &Told,
) {
    let back = best.placement.pose.rotation.conjugate();
    let press = back * told.press_direction;
    let nodes = samples.gel.nodes.iter().zip(&settled.here.sights).zip(&settled.counts_per_mm2);
    for ((node, sight), count_per_mm2) in nodes.filter(|(_, count)| **count > 0.0) {
        let Some(foot) = sight.foot.as_ref() else { continue };
        let variance_mm2 = node.sample.variance(best.placement.sensor_direction(foot.normal));
        // A height is the distance along the normal over the cosine.
        let cosine = foot.normal.dot(press);
        system.add(&Sighting {
            lever: back * node.sample.p_mm,
            normal: foot.normal,
            residual: 0.0,
            weight: count_per_mm2 * system.sigma_mm() * system.sigma_mm() / (cosine * cosine),
            normal_variance: foot.curvature_per_mm * foot.curvature_per_mm * variance_mm2,
        });
    }
    // Rotates both halves of (ρ ω, v) to the object's axes.
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

/// The candidates after the best one.
pub(super) fn alternatives(samples: &Samples, candidates: &[Candidate], is_cut: bool) -> Alternatives {
    let mut out = Alternatives::none_of(is_cut);
    for one in &candidates[1..] {
        out.push(Alternative { t_sensor_object: pose(samples, one), log_likelihood: -one.cost });
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::ln;
    use crate::register::surface::mixture::{Bell, Loose, Mixture, STRAY_MM};

    const SIGMA_MM: f64 = 0.03;

    fn at(mixture: &Mixture, d_mm: f64) -> (f64, f64) {
        mixture.at(d_mm, Bell::at(d_mm, SIGMA_MM))
    }

    fn doubt(points: impl Iterator<Item = (f64, f64, f64)>) -> f64 {
        let mut doubt = Doubt::default();
        points.for_each(|(w, t, r_squared)| doubt.add(w, t, r_squared));
        doubt.variance()
    }

    fn doubt_of(mixture: &Mixture, all_mm: &[f64]) -> f64 {
        doubt(all_mm.iter().map(|d_mm| {
            let r = d_mm / SIGMA_MM;
            (at(mixture, *d_mm).0, 1.0 / (SIGMA_MM * SIGMA_MM), r * r)
        }))
    }

    #[test]
    fn what_is_missing_is_what_the_likelihood_is_not_curved_by() {
        // Contact and uniform outliers: no free gel, whose density has slopes of its own.
        let mixture = Loose::new(0.8, (1.0, STRAY_MM)).with(1.0);
        let all_mm = [-0.03, -0.02, 0.0, 0.01, 0.04];
        let cost =
            |shift_mm: f64| -> f64 { all_mm.iter().map(|d_mm| -ln(at(&mixture, d_mm + shift_mm).1)).sum() };
        let h = 1e-4;
        let curved = (cost(h) - 2.0 * cost(0.0) + cost(-h)) / (h * h);
        let told: f64 = all_mm.iter().map(|d_mm| at(&mixture, *d_mm).0).sum::<f64>() / (SIGMA_MM * SIGMA_MM);
        let variance = 1.0 / told + doubt_of(&mixture, &all_mm);
        // The error is (h / σ)² of a fourth derivative that is a few times the second.
        assert!((variance * curved - 1.0).abs() < 1e-4, "{}", variance * curved);
        assert!(told > 1.02 * curved);
    }

    #[test]
    fn points_that_scatter_more_than_their_noise_tell_as_much_less() {
        // If all points are in contact, this is the variance of the mean: 4 σ² over their number at two
        // standard deviations.
        let sure = |r: f64| core::iter::repeat_n((1.0, 1.0, r * r), 10);
        assert!((0.1 + doubt(sure(2.0)) - 0.4).abs() < 1e-15);
        assert_eq!(doubt(sure(0.5)), 0.0);
    }
}
