//! Screening: rounds of coarse steps with ever fewer candidates (successive halving).

use super::candidate::Candidate;
use super::coarse::View;
use super::contact::{COARSE, MEDIUM};
use super::gel::prediction::KEPT;
use super::normal_system::Normal;
use super::state::{Problem, Search};
use crate::math::sqrt;
use alloc::vec::Vec;

/// One round of screening.
pub(super) struct Round {
    /// Number of salient points in use.
    pub pressed: usize,
    /// Widths of its steps, and how many candidates continue from each: the cheapest before the step.
    steps: &'static [(f64, usize)],
    /// Width of the final comparison, and how many candidates are kept.
    last_mm: f64,
    pub keeps: usize,
}

impl Round {
    /// Work for this many candidates, with `points` salient and other ones.
    pub const fn work(&self, count: usize, points: usize) -> usize {
        let (mut left, mut sum, mut k) = (count, 0, 0);
        while k < self.steps.len() {
            sum += left * points;
            left = if left < self.steps[k].1 { left } else { self.steps[k].1 };
            k += 1;
        }
        sum + left * points
    }
}

/// Candidates closer than this, over the patch, count as one.
pub(super) const SAME_MM: f64 = 0.1;

/// The first round.
pub(super) const FIRST: Round =
    Round { pressed: COARSE, steps: &[(1.5, usize::MAX), (0.8, 96), (0.4, 48)], last_mm: 0.3, keeps: 32 };
/// The second round keeps all to its end: alternatives as likely as the best pose are searched among them.
pub(super) const SECOND: Round = Round {
    pressed: MEDIUM,
    steps: &[(0.6, usize::MAX), (0.3, usize::MAX), (0.2, usize::MAX), (0.12, usize::MAX)],
    last_mm: 0.1,
    keeps: KEPT,
};
/// Weight of the guess in coarse steps; small, since the point weights are those of wide distributions.
const COARSE_PRIOR: f64 = 0.1;
/// Longest coarse step, over the patch.
const LONGEST_MM: f64 = 2.0;

impl Search<'_> {
    /// Steps all candidates, and selects those that continue.
    pub fn round(&mut self, candidates: &mut Vec<Candidate>, round: &Round, unpressed: usize) {
        let Problem { params, samples, field, press_direction, .. } = self.problem;
        let pressed = round.pressed.min(samples.spread_count);
        let view = View::of(samples, pressed, unpressed, *press_direction);
        for &(width_mm, keeps) in round.steps {
            self.each(candidates, |search, candidate| search.step(candidate, &view, params.scaled(width_mm)));
            keep(candidates, keeps, 0.0, 0.0);
        }
        self.each(candidates, |search, candidate| {
            search.work += view.len();
            view.cost(field, &candidate.placement, params.scaled(round.last_mm))
        });
        insertion_sort(candidates);
    }

    /// Computes the cost of all candidates, or until the budget is spent.
    fn each(&mut self, candidates: &mut [Candidate], mut cost: impl FnMut(&mut Self, &mut Candidate) -> f64) {
        if self.has_spent() {
            return;
        }
        for candidate in candidates {
            candidate.cost = if !self.has_spent() { cost(self, candidate) } else { f64::INFINITY };
        }
    }

    /// Takes a coarse step; returns the cost before it.
    pub fn step(&mut self, candidate: &mut Candidate, view: &View<'_>, width_mm: f64) -> f64 {
        let sum = view.look(&self.problem.field, &candidate.placement, width_mm);
        self.step_by(candidate, view, sum)
    }

    /// Takes the step of a pass's linear system; returns the cost before it.
    pub fn step_by(&mut self, candidate: &mut Candidate, view: &View<'_>, mut sum: Normal) -> f64 {
        self.work += view.len();
        let cost = sum.cost;
        sum.add_prior(&self.problem.prior, &candidate.placement, view.radius_mm, COARSE_PRIOR);
        if let Some((omega, v)) = sum.solve(view.radius_mm, self.problem.params.scaled(LONGEST_MM)) {
            candidate.placement = candidate.placement.moved(omega, v);
        }
        cost
    }
}

/// Keeps the `max_count` cheapest, in order; of those closer than `same_mm` the cheaper one. The sort is
/// stable: ties keep the order of the starts.
pub(super) fn keep(candidates: &mut Vec<Candidate>, max_count: usize, radius_mm: f64, same_mm: f64) {
    insertion_sort(candidates);
    if same_mm == 0.0 {
        return candidates.truncate(max_count);
    }
    let mut kept = 0;
    for k in 0..candidates.len() {
        if kept == max_count {
            break;
        }
        let one = candidates[k];
        let is_new = candidates[..kept].iter().all(|other| {
            let (omega, v) = one.placement.since(&other.placement);
            sqrt((omega * radius_mm).length_squared() + v.length_squared()) > same_mm
        });
        if is_new {
            candidates[kept] = one;
            kept += 1;
        }
    }
    candidates.truncate(kept);
}

/// The standard library's stable sort allocates.
pub(super) fn insertion_sort(candidates: &mut [Candidate]) {
    for k in 1..candidates.len() {
        let mut at = k;
        while at > 0 && candidates[at].cost < candidates[at - 1].cost {
            candidates.swap(at, at - 1);
            at -= 1;
        }
    }
}
