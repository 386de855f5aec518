//! Many starts, successive halving: each round looks at fewer candidates more closely.

use super::contact::{COARSE, MEDIUM, Samples};
use super::fit::View;
use super::part::{Coarse, Distances, Exact};
use super::polish::{End, OUT_OF_REACH_MM, Polish, PolishScratch};
use super::rest::Rest;
use super::settled::{Settled, SettledScratch};
use super::starts::start;
use super::step::{Placement, Prior};
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, sqrt};
use crate::params::RegisterParams;
use alloc::vec::Vec;

/// A pose in the running.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub placement: Placement,
    /// Of the gel, where it is asked.
    pub rest: Rest,
    /// The lower the better; comparable within a round.
    pub cost: f64,
}

impl Candidate {
    fn at(placement: Placement) -> Self {
        Self { placement, rest: Rest::UNKNOWN, cost: f64::INFINITY }
    }
}

/// One round of screening: how many salient points it looks at, the widths of its steps, the last for the cost alone,
/// and how many candidates it keeps.
struct Round {
    pressed: usize,
    widths_mm: &'static [f64],
    keeps: usize,
    /// Candidates closer than this, over the patch, are one.
    same_mm: f64,
}

const FIRST: Round = Round { pressed: COARSE, widths_mm: &[1.5, 0.8, 0.4, 0.3], keeps: 32, same_mm: 0.0 };
const SECOND: Round =
    Round { pressed: MEDIUM, widths_mm: &[0.6, 0.3, 0.2, 0.12, 0.1], keeps: 8, same_mm: 0.1 };
/// From a guess that is close: coarse looks, and steps on the field that are not checked. A step on the exact surface costs
/// several of them.
const CLOSE: &[f64] = &[0.5, 0.25, 0.15];
const SLIDES: u32 = 8;
/// Other markers this far over the part are not looked at: they count up to half a millimetre, and by then the part hardly
/// moves.
const SLIDE_REACH_MM: f64 = 1.0;
const CLOSE_REACH_MM: f64 = 0.7;
/// Steps on the field of a part that is followed.
const TRACK_STEPS: u32 = 5;
/// Steps on the field before candidates are compared, and how many go on.
const FIELD_STEPS: u32 = 4;
const FINALISTS: usize = 3;
/// Steps of all of them on the exact surface, and of those that are left.
const FIRST_STEPS: u32 = 3;
const MOST_STEPS: u32 = 15;
/// Finalists whose likelihood is less than that of the best by this, in logarithms, are not polished on.
const HOPELESS: f64 = 12.0;
/// With fewer of the markers around the contact explained the gel is another than it is said to be, and is not asked.
const EXPLAINED: f64 = 0.75;
/// Widths of the steps that ask the gel, on the field and on the exact surface.
const BLURRED: &[(&[f64], usize)] = &[(&[0.3], 5), (&[0.2], 3), (&[0.1], 2)];
const SHARP: &[f64] = &[0.05];
/// The guess counts little while weights are those of wide laws.
const COARSE_PRIOR: f64 = 0.1;
/// Longest step of a coarse look.
const LONGEST_MM: f64 = 2.0;

/// What a search works with.
pub(super) struct Search<'a> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub press_direction: DVec3,
    pub field: Coarse<'a>,
    pub faces: Exact<'a>,
    pub prior: Prior,
    pub work: u64,
    /// Whether the answer is that of the gel.
    pub is_settled: bool,
}

impl Search<'_> {
    /// All points.
    fn whole(&self) -> View<'_> {
        View::of(self.samples, usize::MAX, usize::MAX, self.press_direction)
    }

    fn budget(&self) -> u64 {
        u64::from(self.params.budget)
    }

    fn polish<D: Distances>(&self, part: D) -> Polish<'_, D> {
        Polish {
            params: self.params,
            samples: self.samples,
            view: self.whole(),
            field: self.field,
            part,
            prior: self.prior,
            reach_mm: OUT_OF_REACH_MM,
        }
    }

    /// From the guess alone, on the field.
    pub fn track(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut PolishScratch) -> End {
        self.begin_at_guess(candidates);
        let polish = self.polish(self.field);
        let end = polish.slide(&mut candidates[0], TRACK_STEPS, self.budget(), scratch);
        // The field knows no curvature, and without it facets would seem to hold a cylinder's spin.
        let (cost, work) = self.polish(self.faces).compare(&candidates[0].placement, scratch);
        candidates[0].cost = cost;
        self.work = end.work + work;
        end
    }

    /// From the guess alone: on the field, then on the exact surface.
    pub fn close(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut PolishScratch) -> End {
        self.begin_at_guess(candidates);
        let view = View::of(
            self.samples,
            self.samples.may_touch(),
            self.samples.medium_unpressed,
            self.press_direction,
        );
        for &width_mm in CLOSE {
            self.step(&mut candidates[0], &view, width_mm);
        }
        let left = self.budget().saturating_sub(self.work);
        let polish = Polish { reach_mm: SLIDE_REACH_MM, ..self.polish(self.field) };
        self.work += polish.slide(&mut candidates[0], SLIDES, left, scratch).work;
        let left = self.budget().saturating_sub(self.work);
        let polish = Polish { reach_mm: CLOSE_REACH_MM, ..self.polish(self.faces) };
        let end = polish.run(&mut candidates[0], self.params.max_iterations.min(MOST_STEPS), left, scratch);
        let (cost, work) = polish.compare_ended(&candidates[0].placement, scratch);
        candidates[0].cost = cost;
        self.work += end.work + work;
        end
    }

    /// From many starts.
    pub fn many(
        &mut self,
        candidates: &mut Vec<Candidate>,
        scratch: &mut PolishScratch,
        settled: &mut SettledScratch,
    ) -> End {
        candidates.clear();
        for k in 0..self.params.starts {
            candidates.push(Candidate::at(start(&self.prior, k)));
        }
        self.round(candidates, &FIRST, self.samples.coarse_unpressed);
        self.round(candidates, &SECOND, self.samples.medium_unpressed);
        self.is_settled = false;
        if self.samples.gel.is_known() {
            let before: [Option<Candidate>; SECOND.keeps] =
                core::array::from_fn(|k| candidates.get(k).copied());
            let end = self.settle(candidates, scratch, settled);
            self.is_settled = self.settled(true).explained(&settled.here) >= EXPLAINED;
            if self.is_settled {
                return end;
            }
            candidates.clear();
            candidates.extend(before.into_iter().flatten());
        }
        for k in 0..candidates.len() {
            if self.work >= self.budget() {
                candidates.truncate(k.max(1));
                break;
            }
            let polish = self.polish(self.field);
            let left = self.budget() - self.work;
            let end = polish.run(&mut candidates[k], FIELD_STEPS, left, scratch);
            let (cost, work) = polish.compare(&candidates[k].placement, scratch);
            candidates[k].cost = cost;
            self.work += end.work + work;
        }
        keep(candidates, FINALISTS, self.samples.radius_mm, SECOND.same_mm);
        self.finish(candidates, scratch)
    }

    fn settled(&self, is_exact: bool) -> Settled<'_> {
        Settled {
            params: self.params,
            samples: self.samples,
            press_direction: self.press_direction,
            field: self.field,
            faces: is_exact.then_some(self.faces),
            prior: self.prior,
        }
    }

    /// Information about (ρ ω, v) about the centroid, of the candidate whose prediction is in `settled`.
    pub fn information(&self, best: &Candidate, settled: &SettledScratch) -> Symmetric<6> {
        self.settled(true).information(best, &settled.here)
    }

    /// The candidates by what the gel would do, best first. The best one's prediction is left in `settled`.
    fn settle(
        &mut self,
        candidates: &mut Vec<Candidate>,
        scratch: &mut PolishScratch,
        settled: &mut SettledScratch,
    ) -> End {
        let rest = Rest { plane_mm: self.samples.gel.rest_plane(self.samples.radius_mm), log_decay: 0.0 };
        candidates.iter_mut().for_each(|candidate| candidate.rest = rest);
        for (widths_mm, keeps) in BLURRED {
            self.settle_all(candidates, (false, widths_mm, 0), settled);
            keep(candidates, *keeps, self.samples.radius_mm, SECOND.same_mm);
        }
        // Not at rest, none is hopeless: one marker that an edge has yet to pass makes a difference of ten and more.
        self.settle_all(candidates, (true, SHARP, 0), settled);
        let mut end =
            self.settle_all(candidates, (true, &[], self.params.max_iterations.min(MOST_STEPS)), settled);
        keep(candidates, FINALISTS, 0.0, 0.0);
        end.work += self.settle_all(&mut candidates[..1], (true, &[], 0), settled).work;
        self.work += self.polish(self.faces).compare(&candidates[0].placement, scratch).1;
        end
    }

    /// How the best one ended.
    fn settle_all(
        &mut self,
        candidates: &mut [Candidate],
        (is_exact, widths_mm, most): (bool, &[f64], u32),
        settled: &mut SettledScratch,
    ) -> End {
        let mut best = (f64::INFINITY, End { converged: false, iterations: 0, work: 0 });
        for k in 0..candidates.len() {
            if k > 0 && self.work >= self.budget() {
                break;
            }
            let left = self.budget().saturating_sub(self.work);
            let end = self.settled(is_exact).run(&mut candidates[k], widths_mm, (most, left), settled);
            self.work += end.work;
            if candidates[k].cost < best.0 {
                best = (candidates[k].cost, end);
            }
        }
        best.1
    }

    fn begin_at_guess(&self, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        candidates.push(Candidate::at(self.prior.guess));
    }

    /// The finalists on the exact surface, best first. How the best one ended; its readings are in the scratch.
    fn finish(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut PolishScratch) -> End {
        if candidates.len() > 1 {
            self.polish_all(candidates, FIRST_STEPS, scratch);
            keep(candidates, FINALISTS, 0.0, 0.0);
            let hopeless = candidates[0].cost + HOPELESS;
            let near = candidates.iter().take_while(|c| c.cost < hopeless).count();
            candidates.truncate(near.max(1));
        }
        let end = self.polish_all(candidates, self.params.max_iterations.min(MOST_STEPS), scratch);
        keep(candidates, FINALISTS, 0.0, 0.0);
        let (_, work) = self.polish(self.faces).compare(&candidates[0].placement, scratch);
        self.work += work;
        end
    }

    /// How the best one ended.
    fn polish_all(&mut self, candidates: &mut Vec<Candidate>, most: u32, scratch: &mut PolishScratch) -> End {
        let mut best = (f64::INFINITY, End { converged: false, iterations: 0, work: 0 });
        for k in 0..candidates.len() {
            let left = self.budget().saturating_sub(self.work);
            if k > 0 && left == 0 {
                candidates.truncate(k);
                break;
            }
            let polish = self.polish(self.faces);
            let end = polish.run(&mut candidates[k], most, left, scratch);
            let (cost, work) = polish.compare(&candidates[k].placement, scratch);
            candidates[k].cost = cost;
            self.work += end.work + work;
            if cost < best.0 {
                best = (cost, end);
            }
        }
        best.1
    }

    /// Steps of all candidates, and the choice of those that go on.
    fn round(&mut self, candidates: &mut Vec<Candidate>, round: &Round, unpressed: usize) {
        let view = View::of(
            self.samples,
            round.pressed.min(self.samples.spread_count),
            unpressed,
            self.press_direction,
        );
        for candidate in candidates.iter_mut() {
            candidate.cost = f64::INFINITY;
            if self.work >= self.budget() {
                continue;
            }
            let (last, steps) = match round.widths_mm.split_last() {
                Some((last, steps)) => (*last, steps),
                None => continue,
            };
            for &width_mm in steps {
                self.step(candidate, &view, width_mm);
            }
            candidate.cost = view.look(&self.field, &candidate.placement, last).cost;
            self.work += view.len();
        }
        keep(candidates, round.keeps, self.samples.radius_mm, round.same_mm);
    }

    fn step(&mut self, candidate: &mut Candidate, view: &View<'_>, width_mm: f64) {
        let mut sum = view.look(&self.field, &candidate.placement, width_mm);
        self.work += view.len();
        sum.add_prior(&self.prior, &candidate.placement, view.radius_mm, COARSE_PRIOR);
        if let Some((omega, v)) = sum.solve(view.radius_mm, LONGEST_MM) {
            candidate.placement = candidate.placement.moved(omega, v);
        }
    }
}

/// The `most` cheapest, in order; of those closer than `same_mm` the cheaper one. Sorting is stable: ties stay in the
/// order of the starts.
fn keep(candidates: &mut Vec<Candidate>, most: usize, radius_mm: f64, same_mm: f64) {
    insertion_sort(candidates);
    if same_mm == 0.0 {
        return candidates.truncate(most);
    }
    let mut kept = 0;
    for k in 0..candidates.len() {
        if kept == most {
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
fn insertion_sort(candidates: &mut [Candidate]) {
    for k in 1..candidates.len() {
        let mut at = k;
        while at > 0 && candidates[at].cost < candidates[at - 1].cost {
            candidates.swap(at, at - 1);
            at -= 1;
        }
    }
}
