//! The last steps where all markers are known: the heights of the gel that a pose of the part predicts, against those
//! that were measured.
//!
//! What touches and what hangs at a pose is what the gel does there ([`Gel`]). Unknown beside the pose are the gel's plane of
//! rest and the decay length.

use super::candidate::{Candidate, End};
use super::contact::Samples;
use super::edges::Wall;
use super::gel::Gel;
use super::lattice::{Node, Sweeps};
use super::misfit::MOST;
use super::noise::{Likelihood, STRAY_MM};
use super::part::{Coarse, Exact, Foot, Line, UNDER_MM};
use super::rest::{DECAY_LOGS, Rest};
use super::step::{Normal, Prior};

use crate::math::{DVec3, abs, exp, sqrt};
use crate::params::RegisterParams;
use crate::stop::Stop;
use alloc::vec::Vec;
use core::mem::swap;

/// Turn and shift of the part, the plane of rest, and the logarithm of l².
pub(super) const UNKNOWN: usize = 10;
pub(super) const PLANE: usize = 6;
pub(super) const DECAY: usize = 9;
pub(super) type Row = [f64; UNKNOWN];

/// Standard deviation of the logarithm of l²: a third of l.
pub(super) const DECAY_SIGMA: f64 = 0.6;
/// No free height is wrong by more than this share of its gap to the part.
const GAP_SHARE: f64 = 0.5;
/// Standard deviations from which gel is lifted.
pub(super) const LIFTED: f64 = 3.0;
/// Standard deviation of what lies anywhere between two markers, in pitches: 1 / √12.
pub(super) const BETWEEN: f64 = 0.288_675;
/// There may be outliers even where none are expected.
const LEAST_OUTLIERS: f64 = 1e-3;
/// Over which differences are taken at the end.
pub(super) const LAST_SCALE_MM: f64 = 0.04;
/// A pose that gains no more, in logarithms of the likelihood, is at rest, however far it still moves along what is free:
/// from the peak of a normal law that is a quarter of a standard deviation.
const LEAST_GAIN: f64 = 0.03;
/// Poses of blurred steps are judged by what is half as blurred: not at rest yet, they are told apart by sharp heights
/// for how far they have come.
const JUDGED: f64 = 0.5;
/// Longest step, over the patch, and how often one is tried: as a whole, and where that fails as far as is then likely to
/// do. A third try is worth less than the next start.
pub(super) const LONGEST_MM: f64 = 0.5;
const TRIES: u32 = 2;
/// Sweeps over the gel of a prediction.
const MOST_SWEEPS: u32 = 80;
/// Work of a sweep over a node, in lookups of the field.
pub(super) const SWEEPS_A_LOOKUP: u64 = 8;

/// What a pose predicts of one node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    /// Where the part is under it; `None` where there is none.
    pub foot: Option<Foot>,
    /// How near the part is to the line through the node that does not meet it.
    pub clear_mm: f64,
    pub touches: bool,
    /// Measured over predicted height.
    pub residual_mm: f64,
    /// Between the gel and the part.
    gap_mm: f64,
    pub variance_mm2: f64,
    /// Probability that it is no outlier.
    pub weight: f64,
}

/// All of that at one state.
#[derive(Clone, Debug, Default)]
pub(super) struct Prediction {
    /// Whether it is of this contact.
    is_known: bool,
    pub sights: Vec<Sight>,
    pub heights_mm: Vec<f64>,
    cost: f64,
}

impl Prediction {
    /// Share of the markers at the part which are no outliers.
    pub fn explained(&self) -> f64 {
        mean(self.at_part().map(|sight| sight.weight)).unwrap_or(0.0)
    }

    /// Mean square of what the markers at the part miss it by over its variance; of an outlier nothing is known, and it
    /// counts as one that is as wrong as its noise.
    pub fn misfit(&self) -> f64 {
        let squared = |sight: &Sight| sight.residual_mm * sight.residual_mm / sight.variance_mm2;
        mean(self.at_part().map(|s| s.weight * squared(s) + 1.0 - s.weight)).unwrap_or(f64::INFINITY)
    }

    /// As [`Self::misfit`], of the markers that touch the part, and of others by their place in the list, and how many they
    /// are. Outliers beyond the expected share are no chance: each counts as much as an outlier may.
    pub fn touching_misfit(&self, outlier_share: f64, and: impl Fn(usize) -> bool) -> (f64, f64) {
        let tested = || {
            let all = self.sights.iter().enumerate();
            all.filter(|(k, sight)| sight.touches || and(*k)).map(|(_, sight)| sight)
        };
        let squared = |sight: &Sight| sight.residual_mm * sight.residual_mm / sight.variance_mm2;
        let good = mean(tested().map(|s| s.weight * squared(s) + 1.0 - s.weight)).unwrap_or(1.0);
        let outliers = mean(tested().map(|s| 1.0 - s.weight)).unwrap_or(0.0);
        let unexpected = (outliers - outlier_share).max(0.0);
        (good + unexpected * (MOST - 1.0), tested().count() as f64)
    }

    /// The markers that touch it or are lifted.
    fn at_part(&self) -> impl Iterator<Item = &Sight> {
        let is_lifted = |(sight, height_mm): &(&Sight, &f64)| {
            *height_mm * *height_mm > LIFTED * LIFTED * sight.variance_mm2
        };
        let all = self.sights.iter().zip(&self.heights_mm);
        all.filter(move |one| one.0.touches || is_lifted(one)).map(|(sight, _)| sight)
    }

    /// Heights to begin from are those of another.
    fn begin_as(&mut self, other: &Self) {
        self.heights_mm.clear();
        self.heights_mm.extend_from_slice(&other.heights_mm);
    }
}

/// `None` of nothing.
fn mean(all: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = all.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Predictions that are kept: those of as many candidates.
pub(super) const KEPT: usize = 8;

/// Vectors that are kept from run to run.
#[derive(Clone, Debug, Default)]
pub(super) struct SettledScratch {
    pub here: Prediction,
    pub there: Prediction,
    /// Of candidates, by their slots.
    kept: [Prediction; KEPT],
    pub obstacle_mm: Vec<f64>,
    pub changes: Vec<Row>,
    pub sweeps: Sweeps,
    pub cells: Vec<Row>,
    pub rows: Vec<Row>,
    hints: Vec<u32>,
    /// Through the nodes.
    pub lines: Vec<Line>,
    /// What every node's height counts for in the information, per mm².
    pub counts_per_mm2: Vec<f64>,
    /// What edges leave room for.
    pub walls: Vec<Wall>,
}

impl SettledScratch {
    /// For another contact, of which nothing is known; room in all predictions, since they change places.
    pub fn clear(&mut self, gel: &Gel) {
        let count = gel.nodes.len();
        for one in self.kept.iter_mut().chain([&mut self.here, &mut self.there]) {
            one.sights.reserve(count.saturating_sub(one.sights.len()));
            one.heights_mm.reserve(count.saturating_sub(one.heights_mm.len()));
            one.is_known = false;
        }
        self.hints.clear();
        self.hints.resize(count, 0);
        self.changes.resize(count, [0.0; UNKNOWN]);
        self.lines.clear();
        self.lines.reserve(count);
        self.walls.clear();
        self.walls.reserve(count);
        gel.lay_out(&mut self.sweeps);
    }

    pub fn kept(&self, slot: usize) -> &Prediction {
        &self.kept[slot]
    }

    /// Brings a kept prediction to `here`; how another one changed does not count.
    pub fn show(&mut self, slot: usize) {
        self.changes.fill([0.0; UNKNOWN]);
        swap(&mut self.kept[slot], &mut self.here);
    }
}

/// The way of one candidate to the greatest likelihood.
pub(super) struct Settled<'a> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub press_direction: DVec3,
    pub field: Coarse<'a>,
    /// Without it the field alone.
    pub faces: Option<Exact<'a>>,
    pub prior: Prior,
    pub stop: Stop<'a>,
}

impl Settled<'_> {
    pub(super) fn gel(&self) -> &Gel {
        &self.samples.gel
    }

    /// Predicts at a candidate as it stands. On the field what its slot kept before is of another candidate; on the exact
    /// surface it is this one's, and close.
    pub fn begin(&self, state: &mut Candidate, scratch: &mut SettledScratch) -> u64 {
        if scratch.kept[state.slot].is_known {
            swap(&mut scratch.kept[state.slot], &mut scratch.here);
        }
        if self.faces.is_none() || !scratch.here.is_known {
            return self.begin_anew(state, scratch);
        }
        scratch.there.begin_as(&scratch.here);
        self.keep(state, 0.0, scratch)
    }

    /// Predicts, from the heights that were measured.
    pub fn begin_anew(&self, state: &mut Candidate, scratch: &mut SettledScratch) -> u64 {
        let over_rest_mm =
            self.gel().nodes.iter().map(|node| (node.along_mm - state.rest.plane_mm[0]).max(0.0));
        scratch.there.heights_mm.clear();
        scratch.there.heights_mm.extend(over_rest_mm);
        self.keep(state, 0.0, scratch)
    }

    /// One step blurred by a width, unchecked.
    pub fn blurred(&self, state: &mut Candidate, width_mm: f64, scratch: &mut SettledScratch) -> u64 {
        scratch.show(state.slot);
        self.weigh(state, width_mm, &mut scratch.here);
        let (step, work) = self.step(state, width_mm, scratch);
        if let Some(step) = step {
            *state = self.moved(state, &step.row, 1.0);
        }
        scratch.there.begin_as(&scratch.here);
        work + self.keep(state, if self.faces.is_none() { JUDGED * width_mm } else { 0.0 }, scratch)
    }

    /// Predicts, from the heights that are `there`, into the candidate's slot, and judges it blurred by a width.
    fn keep(&self, state: &mut Candidate, width_mm: f64, scratch: &mut SettledScratch) -> u64 {
        let work = self.predict_heights(state, scratch);
        self.weigh(state, width_mm, &mut scratch.there);
        state.cost = scratch.there.cost;
        swap(&mut scratch.kept[state.slot], &mut scratch.there);
        work
    }

    /// At most `most` steps to the end; none once `budget` of work is spent.
    pub fn run(
        &self,
        state: &mut Candidate,
        (most, budget): (u32, u64),
        scratch: &mut SettledScratch,
    ) -> End {
        scratch.show(state.slot);
        scratch.there.begin_as(&scratch.here);
        let mut end = End { converged: false, iterations: 0, work: 0 };
        let sigma_mm = self.params.point_sigma_mm;
        let tolerance_mm = 10.0 * self.params.step_tolerance * sigma_mm;
        while end.iterations < most && !end.converged && end.work < budget && !(self.stop)() {
            end.iterations += 1;
            let (step, work) = self.step(state, self.params.scaled(LAST_SCALE_MM), scratch);
            end.work += work;
            let Some(step) = step else { break };
            let full_mm = sqrt(step.row[..6].iter().map(|x| x * x).sum());
            let (mut share, mut accepted, before) = (1.0, false, scratch.here.cost);
            for _ in 0..TRIES {
                let next = self.moved(state, &step.row, share);
                end.work += self.predict(&next, scratch);
                let rise = scratch.there.cost - before;
                if rise < 0.0 {
                    *state = next;
                    swap(&mut scratch.here, &mut scratch.there);
                    accepted = true;
                    break;
                }
                let gain;
                (share, gain) = step.lowest(share, rise);
                if gain < LEAST_GAIN || share * full_mm < tolerance_mm {
                    break;
                }
            }
            let is_gained = before - scratch.here.cost > LEAST_GAIN;
            end.converged = !accepted || !is_gained || share * full_mm < tolerance_mm;
        }
        state.cost = scratch.here.cost;
        swap(&mut scratch.kept[state.slot], &mut scratch.here);
        end
    }

    pub(super) fn moved(&self, state: &Candidate, step: &Row, share: f64) -> Candidate {
        let z = step.map(|x| share * x);
        let omega = DVec3::new(z[0], z[1], z[2]) / self.samples.radius_mm;
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

    /// What a state predicts, into `there`: where the part is, and the heights of the gel.
    fn predict_heights(&self, state: &Candidate, scratch: &mut SettledScratch) -> u64 {
        let SettledScratch { there, obstacle_mm, hints, lines, sweeps, .. } = scratch;
        let (placement, gel) = (&state.placement, self.gel());
        let press = placement.object_direction(self.press_direction);
        let per_radius = 1.0 / self.samples.radius_mm;
        let mut work = 0;
        obstacle_mm.clear();
        there.is_known = true;
        there.sights.clear();
        let start_mm = self.params.scaled(UNDER_MM);
        let line = |node: &Node| Line::new(placement.object_point(node.sample.p_mm), start_mm);
        lines.clear();
        lines.extend(gel.nodes.iter().map(line));
        self.field.march(lines, press);
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
        let sweeps = gel.settle((stiffness, MOST_SWEEPS), obstacle_mm, &mut there.heights_mm, sweeps);
        for ((sight, height_mm), obstacle_mm) in
            there.sights.iter_mut().zip(&there.heights_mm).zip(&*obstacle_mm)
        {
            sight.residual_mm -= height_mm;
            sight.gap_mm = height_mm - obstacle_mm;
            sight.touches = height_mm <= obstacle_mm;
        }
        work + u64::from(sweeps) * gel.nodes.len() as u64 / SWEEPS_A_LOOKUP
    }

    /// What a state predicts, into `there`, and how likely that is.
    fn predict(&self, state: &Candidate, scratch: &mut SettledScratch) -> u64 {
        let work = self.predict_heights(state, scratch);
        self.weigh(state, 0.0, &mut scratch.there);
        work
    }

    /// How likely the measured heights are beside the predicted ones, all blurred by a width.
    fn weigh(&self, state: &Candidate, width_mm: f64, there: &mut Prediction) {
        let (placement, gel) = (&state.placement, self.gel());
        let mut likelihood = Likelihood::after(self.prior_cost(state));
        let model = self.params.surface_sigma_mm * self.params.surface_sigma_mm + width_mm * width_mm;
        let outliers = self.params.outlier_share.max(LEAST_OUTLIERS);
        let stray_mm = self.params.scaled(STRAY_MM);
        // The gel leaves the part at an edge, which the nodes know to a pitch; over that it sinks by 1 - e^(-pitch / l).
        let share = BETWEEN * (1.0 - exp(-1.0 / sqrt(gel.stiffness(state.rest.log_decay))));
        for ((node, sight), &height_mm) in gel.nodes.iter().zip(&mut there.sights).zip(&there.heights_mm) {
            let (variance, wrong_mm) = match (sight.touches, &sight.foot) {
                (true, Some(foot)) => {
                    let normal = placement.sensor_direction(foot.normal);
                    let cosine = normal.dot(self.press_direction);
                    (node.sample.variance(normal) / (cosine * cosine), 0.0)
                }
                _ => {
                    let wrong_mm = (share * abs(height_mm)).min(GAP_SHARE * sight.gap_mm);
                    (node.sample.variance(self.press_direction), wrong_mm)
                }
            };
            sight.variance_mm2 = variance + wrong_mm * wrong_mm + model;
            let squared = sight.residual_mm * sight.residual_mm / sight.variance_mm2;
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
        sum.add_prior(&self.prior, &state.placement, self.samples.radius_mm, 1.0);
        sum.cost + 0.5 * state.rest.log_decay * state.rest.log_decay / (DECAY_SIGMA * DECAY_SIGMA)
    }

    /// How the height of a marker that touches changes with what is sought.
    pub(super) fn touching_row(&self, state: &Candidate, node: &Node, foot: &Foot) -> Row {
        let radius_mm = self.samples.radius_mm;
        let normal = state.placement.sensor_direction(foot.normal);
        let per_cosine = 1.0 / normal.dot(self.press_direction);
        let under = node.sample.p_mm - self.press_direction * foot.over_mm;
        let (m, n) = (under.cross(normal) * (per_cosine / radius_mm), normal * per_cosine);
        let [u, v] = (node.across_mm / radius_mm).to_array();
        [m.x, m.y, m.z, n.x, n.y, n.z, -1.0, -u, -v, 0.0]
    }
}
