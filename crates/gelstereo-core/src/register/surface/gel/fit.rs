//! Final steps where all markers are known: fits the predicted gel heights to the measured ones.
//!
//! The gel model ([`Gel`]) determines which markers are in contact at a pose. The rest plane and the
//! decay length are unknowns besides the pose.

use super::lattice::Node;
use super::model::Gel;
use super::prediction::{DECAY, GelFitScratch, PLANE, Prediction, Row, Sight, UNKNOWN};
use super::rest::{DECAY_LOGS, Rest};
use crate::math::{DVec3, abs, exp, sqrt};
use crate::register::surface::candidate::{Candidate, End};
use crate::register::surface::distances::{Exact, Foot, Line, UNDER_MM};
use crate::register::surface::mixture::{Likelihood, MIN_OUTLIERS, STRAY_MM};
use crate::register::surface::normal_system::Normal;
use crate::register::surface::state::{Limits, Problem};
use core::mem::swap;

/// Largest error of a free height, as a share of its gap to the part.
const GAP_SHARE: f64 = 0.5;
/// Standard deviation of a uniform position between two markers, in pitches: 1 / √12.
pub(in crate::register::surface) const BETWEEN: f64 = 0.288_675;
/// Finite difference step of the final steps.
pub(in crate::register::surface) const LAST_SCALE_MM: f64 = 0.04;
/// Convergence limit of the gain in log-likelihood, however far the pose still moves along free
/// directions. It corresponds to a quarter of a standard deviation from the peak of a normal distribution.
const MIN_GAIN: f64 = 0.03;
/// Blur at which poses are compared, relative to that of their steps. Before convergence, sharp heights
/// would only measure the progress of a pose.
const JUDGED: f64 = 0.5;
/// Longest step, over the patch, and number of tries: the full step, then the share with the lowest
/// predicted cost. A third try is worth less than the next start.
pub(in crate::register::surface) const LONGEST_MM: f64 = 0.5;
const TRIES: u32 = 2;
/// Cosine between two steps from which the second one continues the first. Without longer steps 2 of 100
/// simulated pegs did not converge; with them, from 0.5, 0.8 and 0.95, all did. Of 1887 other contacts 7 did
/// not, and with them 11, 8 and 8; 53 poses were wrong, and with them 56, 55 and 54.
const CONTINUES: f64 = 0.95;
/// Largest number of sweeps over the gel per prediction.
const MAX_SWEEPS: u32 = 80;
/// Sweeps over one node that cost as much as one lookup of the field.
pub(in crate::register::surface) const SWEEPS_A_LOOKUP: u64 = 8;

/// Likelihood maximisation of one candidate.
pub(in crate::register::surface) struct GelFit<'a> {
    pub problem: &'a Problem<'a>,
    /// Exact surface; without it only the field is used.
    pub faces: Option<Exact<'a>>,
}

/// A step, and the share of it that was taken.
struct Stride {
    row: Row,
    share: f64,
}

impl Stride {
    const NONE: Self = Self { row: [0.0; UNKNOWN], share: 1.0 };

    /// Share of the next step to try first. Along a curved valley Gauss-Newton steps are too short: while
    /// they continue in one direction, each is twice as long as the one before.
    fn next_share(&self, next: &Row) -> f64 {
        let dot = |a: &Row, b: &Row| a[..6].iter().zip(&b[..6]).map(|(a, b)| a * b).sum::<f64>();
        let continues = dot(&self.row, next) > CONTINUES * sqrt(dot(&self.row, &self.row) * dot(next, next));
        if continues { (2.0 * self.share).max(1.0) } else { 1.0 }
    }
}

impl<'a> GelFit<'a> {
    /// On the exact surface.
    pub fn exact(problem: &'a Problem<'a>) -> Self {
        Self { problem, faces: Some(problem.faces) }
    }

    /// On the field of distances.
    pub fn on_field(problem: &'a Problem<'a>) -> Self {
        Self { problem, faces: None }
    }

    pub(in crate::register::surface) fn gel(&self) -> &'a Gel {
        &self.problem.samples.gel
    }

    /// Predicts at the candidate's current state. On the field, the prediction kept in its slot is of
    /// another candidate; on the exact surface it is its own, and close.
    pub fn begin(&self, state: &mut Candidate, scratch: &mut GelFitScratch) -> u64 {
        if scratch.kept[state.slot].is_known {
            swap(&mut scratch.kept[state.slot], &mut scratch.here);
        }
        if self.faces.is_none() || !scratch.here.is_known {
            return self.begin_anew(state, scratch);
        }
        scratch.there.begin_as(&scratch.here);
        self.keep(state, 0.0, scratch)
    }

    /// Predicts from the measured heights.
    pub fn begin_anew(&self, state: &mut Candidate, scratch: &mut GelFitScratch) -> u64 {
        let over_rest_mm =
            self.gel().nodes.iter().map(|node| (node.along_mm - state.rest.plane_mm[0]).max(0.0));
        scratch.there.heights_mm.clear();
        scratch.there.heights_mm.extend(over_rest_mm);
        self.keep(state, 0.0, scratch)
    }

    /// One unchecked step, blurred by a width.
    pub fn blurred(&self, state: &mut Candidate, width_mm: f64, scratch: &mut GelFitScratch) -> u64 {
        scratch.show(state.slot);
        self.weigh(state, width_mm, &mut scratch.here);
        let (step, work) = self.step(state, width_mm, scratch);
        if let Some(step) = step {
            *state = self.moved(state, &step.row, 1.0);
        }
        scratch.there.begin_as(&scratch.here);
        work + self.keep(state, if self.faces.is_none() { JUDGED * width_mm } else { 0.0 }, scratch)
    }

    /// Predicts from the heights in `there` into the candidate's slot, and computes its cost blurred by a
    /// width.
    fn keep(&self, state: &mut Candidate, width_mm: f64, scratch: &mut GelFitScratch) -> u64 {
        let work = self.predict_heights(state, scratch);
        self.weigh(state, width_mm, &mut scratch.there);
        state.cost = scratch.there.cost;
        swap(&mut scratch.kept[state.slot], &mut scratch.there);
        work
    }

    /// Steps until convergence, or to the limits.
    pub fn run(&self, state: &mut Candidate, limits: Limits, scratch: &mut GelFitScratch) -> End {
        scratch.show(state.slot);
        scratch.there.begin_as(&scratch.here);
        let mut end = End::NONE;
        let sigma_mm = self.problem.params.point_sigma_mm;
        let tolerance_mm = 10.0 * self.problem.params.advanced.step_tolerance * sigma_mm;
        let mut last = Stride::NONE;
        while end.iterations < limits.max_steps
            && !end.converged
            && end.work < limits.max_work
            && !(self.problem.stop)()
        {
            end.iterations += 1;
            let (step, work) = self.step(state, self.problem.params.scaled(LAST_SCALE_MM), scratch);
            end.work += work;
            let Some(step) = step else { break };
            let full_mm = sqrt(step.row[..6].iter().map(|x| x * x).sum());
            let (mut share, mut accepted, before) = (last.next_share(&step.row), false, scratch.here.cost);
            let tries = if share > 1.0 { TRIES + 1 } else { TRIES };
            for _ in 0..tries {
                let next = self.moved(state, &step.row, share);
                end.work += self.predict(&next, scratch);
                let rise = scratch.there.cost - before;
                if rise < 0.0 {
                    *state = next;
                    swap(&mut scratch.here, &mut scratch.there);
                    accepted = true;
                    break;
                }
                if share > 1.0 {
                    share = 1.0;
                    continue;
                }
                let gain;
                (share, gain) = step.lowest(share, rise);
                if gain < MIN_GAIN || share * full_mm < tolerance_mm {
                    break;
                }
            }
            last = Stride { row: step.row, share };
            let is_gained = before - scratch.here.cost > MIN_GAIN;
            end.converged = !accepted || !is_gained || share * full_mm < tolerance_mm;
        }
        state.cost = scratch.here.cost;
        swap(&mut scratch.kept[state.slot], &mut scratch.here);
        end
    }

    pub(in crate::register::surface) fn moved(&self, state: &Candidate, step: &Row, share: f64) -> Candidate {
        let z = step.map(|x| share * x);
        let omega = DVec3::new(z[0], z[1], z[2]) / self.problem.samples.radius_mm;
        Candidate {
            placement: state.placement.moved(omega, DVec3::new(z[3], z[4], z[5])),
            rest: Rest {
                plane_mm: core::array::from_fn(|i| state.rest.plane_mm[i] + z[PLANE + i]),
                log_decay: (state.rest.log_decay + z[DECAY]).clamp(*DECAY_LOGS.start(), *DECAY_LOGS.end()),
            },
            slot: state.slot,
            cost: f64::INFINITY,
        }
    }

    /// Predicts the part's surface and the gel heights of a state into `there`; returns the work.
    fn predict_heights(&self, state: &Candidate, scratch: &mut GelFitScratch) -> u64 {
        let GelFitScratch { there, obstacle_mm, hints, lines, sweeps, .. } = scratch;
        let (placement, gel) = (&state.placement, self.gel());
        let press = placement.object_direction(self.problem.press_direction);
        let per_radius = 1.0 / self.problem.samples.radius_mm;
        let mut work = 0;
        obstacle_mm.clear();
        there.is_known = true;
        there.sights.clear();
        let start_mm = self.problem.params.scaled(UNDER_MM);
        let line = |node: &Node| Line::new(placement.object_point(node.sample.p_mm), start_mm);
        lines.clear();
        lines.extend(gel.nodes.iter().map(line));
        self.problem.field.march(lines, press);
        for ((node, line), hint) in gel.nodes.iter().zip(&*lines).zip(hints) {
            let foot = match &self.faces {
                Some(faces) => faces.foot(line, press, hint),
                None => line.foot.ok_or(line.clear_mm),
            };
            work += if self.faces.is_some() && foot.is_ok() { 16 } else { 3 };
            let (foot, clear_mm) = foot.map_or_else(|clear_mm| (None, clear_mm), |foot| (Some(foot), 0.0));
            let over_plane_mm = node.along_mm - state.rest.at(node.across_mm * per_radius);
            obstacle_mm.push(foot.map_or(f64::NEG_INFINITY, |foot| over_plane_mm - foot.over_mm));
            let residual_mm = over_plane_mm;
            there.sights.push(Sight {
                foot,
                clear_mm,
                touches: false,
                residual_mm,
                gap_mm: 0.0,
                variance_mm2: 1.0,
                weight: 0.0,
            });
        }
        let stiffness = gel.stiffness(state.rest.log_decay);
        let sweeps = gel.settle(stiffness, MAX_SWEEPS, obstacle_mm, &mut there.heights_mm, sweeps);
        for ((sight, height_mm), obstacle_mm) in
            there.sights.iter_mut().zip(&there.heights_mm).zip(&*obstacle_mm)
        {
            sight.residual_mm -= height_mm;
            sight.gap_mm = height_mm - obstacle_mm;
            sight.touches = height_mm <= obstacle_mm;
        }
        work + u64::from(sweeps) * gel.nodes.len() as u64 / SWEEPS_A_LOOKUP
    }

    /// Predicts a state and its likelihood into `there`; returns the work.
    fn predict(&self, state: &Candidate, scratch: &mut GelFitScratch) -> u64 {
        let work = self.predict_heights(state, scratch);
        self.weigh(state, 0.0, &mut scratch.there);
        work
    }

    /// Likelihood of the measured heights given the predicted ones, all blurred by a width.
    fn weigh(&self, state: &Candidate, width_mm: f64, there: &mut Prediction) {
        let (placement, gel) = (&state.placement, self.gel());
        let mut likelihood = Likelihood::after(self.prior_cost(state));
        let model = self.problem.params.advanced.surface_sigma_mm
            * self.problem.params.advanced.surface_sigma_mm
            + width_mm * width_mm;
        let outliers = self.problem.params.advanced.outlier_share.max(MIN_OUTLIERS);
        let stray_mm = self.problem.params.scaled(STRAY_MM);
        // The nodes resolve the edge at which the gel leaves the part to a pitch, over which the gel
        // sinks by 1 - e^(-pitch / l).
        let share = BETWEEN * (1.0 - exp(-1.0 / sqrt(gel.stiffness(state.rest.log_decay))));
        for ((node, sight), &height_mm) in gel.nodes.iter().zip(&mut there.sights).zip(&there.heights_mm) {
            let (variance, wrong_mm) = match (sight.touches, &sight.foot) {
                (true, Some(foot)) => {
                    let normal = placement.sensor_direction(foot.normal);
                    let cosine = normal.dot(self.problem.press_direction);
                    (node.sample.variance(normal) / (cosine * cosine), 0.0)
                }
                _ => {
                    let wrong_mm = (share * abs(height_mm)).min(GAP_SHARE * sight.gap_mm);
                    (node.sample.variance(self.problem.press_direction), wrong_mm)
                }
            };
            sight.variance_mm2 = variance + wrong_mm * wrong_mm + model;
            let squared = sight.square();
            let good = (1.0 - outliers) * exp(-0.5 * squared.min(1000.0))
                / sqrt(core::f64::consts::TAU * sight.variance_mm2);
            let all = good + outliers / stray_mm;
            sight.weight = good / all;
            likelihood.times(all);
        }
        there.cost = likelihood.cost();
    }

    fn prior_cost(&self, state: &Candidate) -> f64 {
        let mut sum = Normal::ZERO;
        sum.add_prior(&self.problem.prior, &state.placement, self.problem.samples.radius_mm, 1.0);
        sum.cost + state.rest.decay_cost()
    }

    /// Derivatives of the height of a marker in contact by the unknowns.
    pub(in crate::register::surface) fn touching_row(
        &self,
        state: &Candidate,
        node: &Node,
        foot: &Foot,
    ) -> Row {
        let radius_mm = self.problem.samples.radius_mm;
        let normal = state.placement.sensor_direction(foot.normal);
        let per_cosine = 1.0 / normal.dot(self.problem.press_direction);
        let under = node.sample.p_mm - self.problem.press_direction * foot.over_mm;
        let (m, n) = (under.cross(normal) * (per_cosine / radius_mm), normal * per_cosine);
        let [u, v] = (node.across_mm / radius_mm).to_array();
        [m.x, m.y, m.z, n.x, n.y, n.z, -1.0, -u, -v, 0.0]
    }
}
