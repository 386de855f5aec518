//! Refinement and judgement of a pose by the gel that it predicts.

use super::fit::GelFit;
use super::prediction::{GelFitScratch, KEPT, LIFTED};
use super::rest::{GelDecay, Rest};
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, exp, ln, sqrt};
use crate::register::Observability;
use crate::register::observe::{Sighting, System};
use crate::register::surface::candidate::{Candidate, End};
use crate::register::surface::contact::Samples;
use crate::register::surface::halving::{SAME_MM, keep};
use crate::register::surface::mixture::{MIN_OUTLIERS, STRAY_MM};
use crate::register::surface::objective::{FINALISTS, Objective, Odds, Stage};
use crate::register::surface::refine::{RefineScratch, Refinement};
use crate::register::surface::state::{Problem, Search};
use crate::register::verdict::MeanSquare;
use alloc::vec::Vec;
use core::f64::consts::{PI, TAU};

/// Smallest inlier share of the markers at the part. With less the gel differs from the given one, and
/// its model is not used.
const EXPLAINED: f64 = 0.75;
/// Widths of the steps with the gel model on the field, and how many candidates continue from each: for
/// the first few, and for all others if the first few do not fit.
const BLURRED: [(f64, usize); 3] = [(0.3, 3), (0.2, 2), (0.1, 1)];
const BLURRED_ON: [(f64, usize); 3] = [(0.3, 5), (0.2, 3), (0.1, 2)];
/// If the first few have taken more than this share of the budget, fewer of the others continue. These
/// stop at the second share of the budget; the rest lets the best candidate converge.
const SHORT: f64 = 0.45;
const SEARCHED: f64 = 0.8;
const BLURRED_SHORT: [(f64, usize); 3] = [(0.3, 4), (0.2, 2), (0.1, 1)];
const FIRST_FEW: usize = 4;
/// A pose fits if the mean squared residual at the part is at most this share of its variance. The limit
/// is conservative, since the variance includes the error between markers: 67 % of correct and < 50 % of
/// wrong poses pass. Continuing from a correct one costs only time.
const FITS: f64 = 0.8;
/// Width of the first step on the exact surface.
const SHARP_MM: f64 = 0.05;
/// Width on the field for poses after the best one, which are near convergence.
const FIELD_MM: f64 = 0.1;
/// Standard deviations below the likelihood expected from noise at which the markers beside the part do
/// not follow the gel model.
const LAW_BROKEN: f64 = 3.0;

/// Heights of the gel over the part.
pub(in crate::register::surface) struct GelObjective<'b> {
    /// Distances at the pose read last.
    pub distances: &'b mut RefineScratch,
    pub gel: &'b mut GelFitScratch,
}

impl GelObjective<'_> {
    /// Ranks the candidates by the gel model, best first, and reads the best one. Returns how it ended, or
    /// `None` if the model does not explain the contact: the candidates are then as before.
    pub fn rank(&mut self, search: &mut Search<'_>, candidates: &mut Vec<Candidate>) -> Option<End> {
        let exact = Refinement::new(search.problem, search.problem.faces);
        let before: [Option<Candidate>; KEPT] = core::array::from_fn(|k| candidates.get(k).copied());
        let end = self.settle_few(search, candidates);
        let is_spent = search.has_spent();
        let without = before[0].filter(|_| is_spent).map_or(f64::INFINITY, |one| {
            let (cost, work) = exact.compare(&one.placement, self.distances);
            search.work += work;
            cost
        });
        self.gel.show(candidates[0].slot);
        let (with, work) = exact.compare(&candidates[0].placement, self.distances);
        search.work += work;
        // Interrupted steps may have made the pose worse, and no budget is left to repair it.
        let is_used = if is_spent { with <= without } else { self.gel.here.explained() >= EXPLAINED };
        if !is_used {
            candidates.clear();
            candidates.extend(before.into_iter().flatten());
        }
        is_used.then_some(end)
    }

    /// The first few, and the others if these do not fit.
    fn settle_few(&mut self, search: &mut Search<'_>, candidates: &mut Vec<Candidate>) -> End {
        let samples = search.problem.samples;
        let rest = Rest::begin(samples.gel.rest_plane(samples.radius_mm));
        for (slot, candidate) in candidates.iter_mut().enumerate() {
            (candidate.rest, candidate.slot) = (rest, slot);
        }
        self.gel.clear(&samples.gel);
        let all: [Option<Candidate>; KEPT] = core::array::from_fn(|k| candidates.get(k).copied());
        candidates.truncate(FIRST_FEW);
        let end = self.settle(search, candidates, &BLURRED);
        let best = candidates[0];
        let left = all.into_iter().flatten().filter(|one| one.slot != best.slot);
        if search.has_spent() || self.gel.kept(best.slot).misfit() <= FITS || left.clone().count() == 0 {
            return end;
        }
        candidates.clear();
        candidates.extend(left);
        let budget = search.limit;
        let is_short = search.work as f64 > SHORT * budget as f64;
        search.limit = (SEARCHED * budget as f64) as u64;
        let end_on = self.settle(search, candidates, if is_short { &BLURRED_SHORT } else { &BLURRED_ON });
        search.limit = budget;
        // Among equals the first one stays first.
        candidates.insert(0, best);
        keep(candidates, FINALISTS, 0.0, 0.0);
        if candidates[0].slot == best.slot {
            return end;
        }
        if end_on.converged {
            return end_on;
        }
        let max_steps = search.problem.max_steps().saturating_sub(end_on.iterations);
        let last = self.refine_all(search, &mut candidates[..1], max_steps);
        End { iterations: end_on.iterations + last.iterations, ..last }
    }

    /// Steps of decreasing width on the field, then on the exact surface to convergence.
    fn settle(
        &mut self,
        search: &mut Search<'_>,
        candidates: &mut Vec<Candidate>,
        blurred: &[(f64, usize)],
    ) -> End {
        let (params, radius_mm) = (search.problem.params, search.problem.samples.radius_mm);
        self.begin_all(search, candidates, false);
        for &(width_mm, keeps) in blurred {
            self.step_all(search, candidates, &GelFit::on_field(search.problem), params.scaled(width_mm));
            keep(candidates, keeps, radius_mm, params.scaled(SAME_MM));
        }
        self.begin_all(search, candidates, true);
        // No candidate is dropped before convergence: one marker that an edge has yet to pass changes the
        // cost by ten or more.
        self.step_all(search, candidates, &GelFit::exact(search.problem), params.scaled(SHARP_MM));
        let end = self.refine_all(search, candidates, search.problem.max_steps());
        keep(candidates, FINALISTS, 0.0, 0.0);
        end
    }

    /// Predicts the gel at the candidates' current states. Drops those for which no budget is left.
    fn begin_all(&mut self, search: &mut Search<'_>, candidates: &mut Vec<Candidate>, is_exact: bool) {
        let fit = if is_exact { GelFit::exact(search.problem) } else { GelFit::on_field(search.problem) };
        for k in 0..candidates.len() {
            if k > 0 && search.has_spent() {
                return candidates.truncate(k);
            }
            search.work += fit.begin(&mut candidates[k], self.gel);
        }
    }

    fn step_all(
        &mut self,
        search: &mut Search<'_>,
        candidates: &mut [Candidate],
        fit: &GelFit<'_>,
        width_mm: f64,
    ) {
        for candidate in candidates {
            if !search.has_spent() {
                search.work += fit.blurred(candidate, width_mm, self.gel);
            }
        }
    }

    /// Returns how the best one ended.
    fn refine_all(&mut self, search: &mut Search<'_>, candidates: &mut [Candidate], max_steps: u32) -> End {
        let fit = GelFit::exact(search.problem);
        let run =
            |search: &mut Search<'_>, one: &mut Candidate| fit.run(one, search.limits(max_steps), self.gel);
        search.refine_each(candidates, run).1
    }
}

impl Objective for GelObjective<'_> {
    fn refine(&mut self, search: &mut Search<'_>, one: &mut Candidate, stage: Stage) -> End {
        let fit = match stage {
            Stage::Field => GelFit::on_field(search.problem),
            Stage::First | Stage::Last => GelFit::exact(search.problem),
        };
        search.work += fit.begin(one, self.gel);
        let width_mm = match stage {
            Stage::Field => FIELD_MM,
            Stage::First => SHARP_MM,
            Stage::Last => {
                return self.refine_all(search, core::slice::from_mut(one), search.problem.max_steps());
            }
        };
        search.work += fit.blurred(one, search.problem.params.scaled(width_mm), self.gel);
        End::NONE
    }

    fn read(&mut self, search: &mut Search<'_>, one: &mut Candidate) {
        search.work += GelFit::exact(search.problem).begin(one, self.gel);
        self.gel.show(one.slot);
        let exact = Refinement::new(search.problem, search.problem.faces);
        let (_, work) = exact.compare(&one.placement, self.distances);
        search.work += work;
    }

    fn distances(&self) -> &RefineScratch {
        self.distances
    }

    /// Markers in contact or lifted are where the part puts them, or anywhere within the patch's height;
    /// this does not depend on the gel model. The other markers test that model. Where they follow it they
    /// count as evidence (noise makes a squared deviation of 1 on average, counted by its half); otherwise
    /// the model is wrong.
    fn odds(&self, problem: &Problem<'_>) -> Odds {
        let (samples, outliers) = (problem.samples, problem.params.advanced.outlier_share);
        let stray = outliers.max(MIN_OUTLIERS) / (STRAY_MM * samples.gel_scale);
        let gain = |with: f64, without: f64| {
            ln(((1.0 - outliers) * with + stray) / ((1.0 - outliers) * without + stray))
        };
        let (mut part, mut beside, mut count) = (0.0, 0.0, 0.0);
        for (sight, height_mm) in self.gel.here.sights.iter().zip(&self.gel.here.heights_mm) {
            let sigma_mm = sqrt(sight.variance_mm2);
            let peak = 1.0 / (sqrt(TAU) * sigma_mm);
            let half_squared = 0.5 * sight.residual_mm * sight.residual_mm / sight.variance_mm2;
            let measured_mm = sight.residual_mm + height_mm;
            if sight.touches || measured_mm > LIFTED * sigma_mm {
                part += gain(peak * exp(-half_squared), 1.0 / samples.height_mm);
            } else {
                beside += gain(peak * exp(0.5 - half_squared), peak);
                count += 1.0;
            }
        }
        // Half a squared normal deviation has a variance of 1/2.
        Odds { log: part + beside.max(0.0), is_law_kept: beside > -LAW_BROKEN * sqrt(0.5 * count) }
    }

    fn observe(&mut self, problem: &Problem<'_>, read: &Candidate, converged: bool) -> Observability {
        let fit = GelFit::exact(problem);
        let information = fit.information(read, self.gel);
        let left_mm = if converged { 0.0 } else { fit.left_mm(read, self.gel) };
        let mut system = System::new(problem.samples.radius_mm, problem.params.point_sigma_mm);
        add(&mut system, problem, self.gel, read);
        system.replace_information(&turned(&information, read));
        if !converged {
            system.blur(Some(left_mm));
        }
        // About the salient points' centroid, in the object's axes.
        system.observe(read.placement.object_point(DVec3::ZERO))
    }

    /// Errors of the gel model are common to neighbours within a decay length l, i.e. to n = π l² / pitch²
    /// markers. Of the mean square χ² of the markers, 1 is noise and the rest is that error. A sum over n
    /// markers has the variance n + n² (χ² - 1) instead of n. χ² is that of the markers in contact, or of all
    /// that are in contact or lifted, whichever is larger: an error beside the contact moves its border.
    fn excess(&self, problem: &Problem<'_>) -> f64 {
        let touching = self.gel.here.touching_misfit(problem.params.advanced.outlier_share, |_| false);
        let shared = (PI * problem.samples.gel.stiffness(0.0)).min(touching.count);
        1.0 + shared * (touching.mean.max(self.gel.here.misfit()) - 1.0).max(0.0)
    }

    /// Salient markers carry pressure and should be in contact.
    fn misfit(&self, problem: &Problem<'_>) -> Option<MeanSquare> {
        let Samples { gel, pressed, .. } = problem.samples;
        let is_salient = |k: usize| gel.nodes[k].index < pressed.len();
        Some(self.gel.here.touching_misfit(problem.params.advanced.outlier_share, is_salient))
    }

    fn gel_decay(&self, problem: &Problem<'_>, best: &Candidate) -> Option<GelDecay> {
        Some(best.rest.decay(problem.samples.decay_mm))
    }
}

/// Adds the noise of the normals of the markers in contact.
fn add(system: &mut System, problem: &Problem<'_>, gel: &GelFitScratch, read: &Candidate) {
    let back = read.placement.pose.rotation.conjugate();
    let press = back * problem.press_direction;
    let nodes = problem.samples.gel.nodes.iter().zip(&gel.here.sights).zip(&gel.counts_per_mm2);
    for ((node, sight), count_per_mm2) in nodes.filter(|(_, count)| **count > 0.0) {
        let Some(foot) = sight.foot.as_ref() else { continue };
        let variance_mm2 = node.sample.variance(read.placement.sensor_direction(foot.normal));
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
}

/// Information about (ρ ω, v) with both halves in the object's axes.
fn turned(information: &Symmetric<6>, read: &Candidate) -> Symmetric<6> {
    let turn = DMat3::from_quat(read.placement.pose.rotation.conjugate());
    let turned = |x: [f64; 3]| (turn * DVec3::from_array(x)).to_array();
    let halves = |row: [f64; 6]| {
        let [a, b] = [turned([row[0], row[1], row[2]]), turned([row[3], row[4], row[5]])];
        [a[0], a[1], a[2], b[0], b[1], b[2]]
    };
    let rows = information.map(halves);
    core::array::from_fn(|k| halves(core::array::from_fn(|i| rows[i][k])))
}
