//! Refinement and judgement of a pose by distances from the part, without the gel's model.

use super::candidate::{Candidate, End};
use super::distances::Distances;
use super::gel::rest::GelDecay;
use super::halving::{SAME_MM, keep};
use super::mixture::{Likelihood, MIN_OUTLIERS, STRAY_MM};
use super::objective::{FINALISTS, HOPELESS, Objective, Odds, Stage};
use super::refine::{Reading, RefineScratch, Refinement};
use super::state::{Limits, Problem, Search};
use crate::math::{DVec3, exp, ln, sqrt};
use crate::register::Observability;
use crate::register::observe::{Sighting, System, dot, stack};
use crate::register::verdict::MeanSquare;
use alloc::vec::Vec;

/// Steps on the field before candidates are compared.
const FIELD_STEPS: u32 = 4;
/// Steps of all finalists on the exact surface.
const FIRST_STEPS: u32 = 3;
/// Extent of the gel's salient shoulder beside the part, in decay lengths: there it has sunk to a seventh.
const BESIDE: f64 = 2.0;
/// Iterations of the contact share, which is estimated from the points; it starts close and converges at
/// once.
const SHARE_STEPS: u32 = 2;
/// Least share of the information that remains after the missing information; with less, the quadratic
/// approximation is not valid.
const MIN_CURVED: f64 = 0.5;

/// Distances from the part.
pub(super) struct DistanceObjective<'b> {
    pub scratch: &'b mut RefineScratch,
}

impl DistanceObjective<'_> {
    /// Ranks the candidates, best first, and reads the best one. Returns how it ended.
    pub fn rank(&mut self, search: &mut Search<'_>, candidates: &mut Vec<Candidate>) -> End {
        let problem = search.problem;
        let (on_field, exact) =
            (Refinement::new(problem, problem.field), Refinement::new(problem, problem.faces));
        self.refine_all(&on_field, search, candidates, FIELD_STEPS);
        keep(candidates, FINALISTS, problem.samples.radius_mm, problem.params.scaled(SAME_MM));
        if candidates.len() > 1 {
            self.refine_all(&exact, search, candidates, FIRST_STEPS);
            keep(candidates, FINALISTS, 0.0, 0.0);
            let hopeless = candidates[0].cost + HOPELESS;
            let near = candidates.iter().take_while(|c| c.cost < hopeless).count();
            candidates.truncate(near.max(1));
        }
        let end = self.refine_all(&exact, search, candidates, problem.max_steps());
        keep(candidates, FINALISTS, 0.0, 0.0);
        search.work += exact.compare(&candidates[0].placement, self.scratch).1;
        end
    }

    /// Drops those for which no budget is left. Returns how the best one ended.
    fn refine_all<D: Distances>(
        &mut self,
        refinement: &Refinement<'_, D>,
        search: &mut Search<'_>,
        candidates: &mut Vec<Candidate>,
        max_steps: u32,
    ) -> End {
        let (taken, end) = search.refine_each(candidates, |search, one| {
            self.refine_one(refinement, one, search.limits(max_steps))
        });
        candidates.truncate(taken);
        end
    }

    /// Steps, and the cost where they end. Returns how they ended.
    fn refine_one<D: Distances>(
        &mut self,
        refinement: &Refinement<'_, D>,
        one: &mut Candidate,
        limits: Limits,
    ) -> End {
        let end = refinement.run(one, limits, self.scratch);
        let (cost, work) = refinement.compare(&one.placement, self.scratch);
        one.cost = cost;
        End { work: end.work + work, ..end }
    }
}

impl Objective for DistanceObjective<'_> {
    fn refine(&mut self, search: &mut Search<'_>, one: &mut Candidate, stage: Stage) -> End {
        let (problem, limits) = (search.problem, |max_steps| search.limits(max_steps));
        let exact = Refinement::new(problem, problem.faces);
        let end = match stage {
            Stage::Field => {
                Refinement::new(problem, problem.field).run(one, limits(FIELD_STEPS), self.scratch)
            }
            Stage::First => self.refine_one(&exact, one, limits(FIRST_STEPS)),
            Stage::Last => self.refine_one(&exact, one, limits(problem.max_steps())),
        };
        search.work += end.work;
        end
    }

    fn read(&mut self, search: &mut Search<'_>, one: &mut Candidate) {
        let exact = Refinement::new(search.problem, search.problem.faces);
        let (cost, work) = exact.compare(&one.placement, self.scratch);
        one.cost = cost;
        search.work += work;
    }

    fn distances(&self) -> &RefineScratch {
        self.scratch
    }

    /// A salient point is in contact within its noise, or an outlier, or free: up to the patch's height
    /// over the part, and as far beside it as the gel takes to sink. Any other marker is not inside the
    /// part.
    fn odds(&self, problem: &Problem<'_>) -> Odds {
        let (samples, outliers) = (problem.samples, problem.params.advanced.outlier_share);
        let (pressed, others) = self.scratch.here.all.split_at(samples.pressed.len());
        let good = 1.0 - outliers;
        let (stray, stray_mm) = (outliers.max(MIN_OUTLIERS), STRAY_MM * samples.gel_scale);
        let count = pressed.len() as f64;
        let mut share = (self.scratch.touches.iter().take(pressed.len()).sum::<f64>() + 1.0) / (count + 2.0);
        let beside_mm = BESIDE * samples.decay_mm;
        let hangs_mm = 0.0..sqrt(samples.height_mm * samples.height_mm + beside_mm * beside_mm);
        let densities = |r: &Reading, share: f64| {
            let touch = share * good * r.bell.density;
            let hangs = hangs_mm.contains(&r.distance_mm);
            let free = if hangs { (1.0 - share) * good / samples.height_mm } else { 0.0 };
            (touch, touch + free + stray / stray_mm)
        };
        for _ in 0..SHARE_STEPS {
            let believed = |r| {
                let (touch, all) = densities(r, share);
                touch / all
            };
            share = (pressed.iter().map(believed).sum::<f64>() + 1.0) / (count + 2.0);
        }
        let mut salient = Likelihood::after(0.0);
        pressed.iter().for_each(|r| salient.times(densities(r, share).1 * samples.height_mm));
        let within = others.iter().filter(|r| r.distance_mm < 0.0);
        let deviations = |r: &Reading| r.distance_mm / r.sigma_mm;
        let log = -salient.cost()
            + within.map(|r| ln(good * exp(-0.5 * deviations(r) * deviations(r)) + stray)).sum::<f64>();
        Odds { log, is_law_kept: true }
    }

    fn observe(&mut self, problem: &Problem<'_>, read: &Candidate, converged: bool) -> Observability {
        let (samples, sigma_mm) = (problem.samples, problem.params.point_sigma_mm);
        let (placement, scratch) = (&read.placement, &*self.scratch);
        // Only these were in contact during the steps. Others pushed at most, which bounds one side alone.
        let touching = || {
            let points = samples.pressed.iter().zip(&scratch.here.all).zip(&scratch.touches);
            points.filter(|(_, touches)| **touches > 0.0)
        };
        let mut system = System::new(samples.radius_mm, sigma_mm);
        for ((sample, r), touches) in touching() {
            system.add(&Sighting {
                lever: placement.object_direction(sample.p_mm),
                normal: placement.object_direction(r.normal),
                residual: r.distance_mm,
                weight: touches * sigma_mm * sigma_mm / r.variance_mm2,
                normal_variance: r.curvature_per_mm * r.curvature_per_mm * r.variance_mm2,
            });
        }
        if !converged {
            system.blur(None);
        }
        // About the salient points' centroid, in the object's axes.
        let mut seen = system.observe(placement.object_point(DVec3::ZERO));
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
        seen
    }

    fn excess(&self, _: &Problem<'_>) -> f64 {
        1.0
    }

    /// If the gel is known, its model explains too little, and the test fails.
    fn misfit(&self, problem: &Problem<'_>) -> Option<MeanSquare> {
        problem.samples.gel.is_known().then_some(MeanSquare { mean: f64::INFINITY, count: 0.0 })
    }

    fn gel_decay(&self, _: &Problem<'_>, _: &Candidate) -> Option<GelDecay> {
        None
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::register::surface::mixture::{Bell, Loose, Mixture};

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
        let mixture = Loose::new(0.8, 1.0, STRAY_MM).with(1.0);
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
