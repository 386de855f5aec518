//! Multi-start search by successive halving: each round evaluates fewer candidates more closely.

use super::candidate::{Candidate, End};
use super::distance_objective::DistanceObjective;
use super::gel::objective::GelObjective;
use super::gel::prediction::GelFitScratch;
use super::halving::{FIRST, Round, SAME_MM, SECOND, keep};
use super::modes::Modes;
use super::multi_start::start;
use super::objective::Objective;
use super::refine::RefineScratch;
use super::state::Search;
use alloc::vec::Vec;

/// Outcome of a search.
#[derive(Clone, Copy)]
pub(super) struct Outcome {
    /// How the best pose ended.
    pub end: End,
    /// The candidate that was read last: the best one, or where the part looks the same.
    pub read: Candidate,
    /// Whether alternatives may be missing.
    pub is_cut: bool,
    /// Whether the pose was selected among many.
    pub is_selected: bool,
    /// In lookups of the field.
    pub work: u64,
}

/// Lists of candidates, reused between runs.
#[derive(Clone, Debug, Default)]
pub(super) struct Candidates {
    /// The best pose comes first, then the others.
    pub best: Vec<Candidate>,
    /// The cheapest ones of the second round.
    pub runners_up: Vec<Candidate>,
}

/// Share of the budget that screening may take: with less, fewer starts are screened, so that the best of
/// them can be refined. Tried 1/4, 1/3 and 1/2 on 108 simulated contacts: of wide guesses with a budget of
/// 60 000, 88, 85 and 87 % succeed, and of near ones 96, 94 and 91 %.
const SCREENED: f64 = 1.0 / 4.0;
/// Starts that are screened with any budget. With 4, 8 and 16, near guesses succeed in 88, 89 and 86 % of the
/// same contacts with a budget of 20 000, and wide ones in 74, 75 and 79 %.
const MIN_STARTS: usize = 8;

impl Search<'_> {
    /// Number of starts that are screened.
    fn starts(&self) -> usize {
        let (params, samples) = (self.problem.params, self.problem.samples);
        let points = |round: &Round, unpressed: usize| round.pressed.min(samples.spread_count) + unpressed;
        let first = points(&FIRST, samples.coarse_unpressed);
        let second = points(&SECOND, samples.medium_unpressed);
        let work = |starts: usize| FIRST.work(starts, first) + SECOND.work(starts.min(FIRST.keeps), second);
        let max_work = (SCREENED * self.limit as f64) as usize;
        let mut starts = params.surface_search.starts as usize;
        while starts > MIN_STARTS && work(starts) > max_work {
            starts -= 1;
        }
        starts
    }

    /// Reduces many starts to the few that are refined. Returns the cost of the best one.
    pub fn screen(&mut self, candidates: &mut Candidates) -> f64 {
        let (params, samples) = (self.problem.params, self.problem.samples);
        let Candidates { best, runners_up } = candidates;
        best.clear();
        for k in 0..self.starts() {
            best.push(Candidate::at(start(&self.problem.prior, k as u32)));
        }
        self.round(best, &FIRST, samples.coarse_unpressed);
        best.truncate(FIRST.keeps);
        self.round(best, &SECOND, samples.medium_unpressed);
        runners_up.clear();
        runners_up.extend_from_slice(best);
        keep(best, SECOND.keeps, samples.radius_mm, params.scaled(SAME_MM));
        runners_up[0].cost
    }

    /// Refines and ranks the candidates by the gel where it explains the contact, otherwise by distances.
    /// Passes the objective, and how the best one ended, to `then`.
    pub fn rank<T>(
        &mut self,
        candidates: &mut Candidates,
        distances: &mut RefineScratch,
        gel: &mut GelFitScratch,
        then: impl FnOnce(&mut Self, &mut dyn Objective, &mut Candidates, End) -> T,
    ) -> T {
        if self.problem.samples.gel.is_known() {
            let mut by_gel = GelObjective { distances, gel };
            if let Some(end) = by_gel.rank(self, &mut candidates.best) {
                return then(self, &mut by_gel, candidates, end);
            }
        }
        let mut by_distances = DistanceObjective { scratch: distances };
        let end = by_distances.rank(self, &mut candidates.best);
        then(self, &mut by_distances, candidates, end)
    }

    /// The best pose alone, which ended as `end` states and is read.
    pub fn best_only(&self, candidates: &Candidates, end: End) -> Outcome {
        Outcome { end, read: candidates.best[0], is_cut: true, is_selected: true, work: self.work }
    }

    /// Finds the alternatives to the best pose, which ended as `end` states and is read.
    pub fn alternatives(
        &mut self,
        objective: &mut dyn Objective,
        candidates: &mut Candidates,
        end: End,
    ) -> Outcome {
        let Candidates { best, runners_up } = candidates;
        let (before, mut is_cut) = (self.work, self.has_spent());
        let odds = objective.odds(self.problem);
        // If the part is not what is in contact, there are no alternatives.
        if odds.log <= 0.0 {
            best.truncate(1);
            return Outcome { end, read: best[0], is_cut, is_selected: true, work: self.work };
        }
        // If the gel does not follow its model, likelihoods of poses are not comparable. Only rotations
        // after which the part looks the same are then known.
        if !odds.is_law_kept {
            best.truncate(1);
            runners_up.clear();
            is_cut = true;
        }
        let mut modes = Modes::new(self, objective, &best[0], end);
        if odds.is_law_kept {
            modes.hold(&mut best[0]);
        }
        let found = modes.find(best, runners_up);
        let (mut read, end) = found.read;
        if self.work > before {
            objective.read(self, &mut read);
        }
        let read = Candidate { placement: read.placement, ..best[0] };
        Outcome { end, read, is_cut: is_cut || found.is_cut, is_selected: true, work: self.work }
    }
}
