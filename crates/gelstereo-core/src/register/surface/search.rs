//! Multi-start search by successive halving: each round evaluates fewer candidates more closely.

use super::assess::Told;
use super::candidate::{Candidate, End};
use super::evidence_ratio::odds;
use super::gel::fit::GelFit;
use super::gel::prediction::{GelFitScratch, KEPT};
use super::gel::rest::Rest;
use super::halving::{FIRST, SECOND, keep};
use super::modes::Modes;
use super::multi_start::start;
use super::refine::RefineScratch;
use super::state::{HOPELESS, Search, Stage};
use alloc::vec::Vec;

/// Steps on the field before candidates are compared, and how many continue.
const FIELD_STEPS: u32 = 4;
const FINALISTS: usize = 3;
/// Steps of all of them on the exact surface, and of those that remain.
const FIRST_STEPS: u32 = 3;
const MAX_STEPS: u32 = 15;
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

impl Search<'_> {
    /// Searches from many starts. The best pose comes first, then the others; leaves the cheapest of the
    /// second round in `runners_up`.
    pub fn many(
        &mut self,
        candidates: &mut Vec<Candidate>,
        runners_up: &mut Vec<Candidate>,
        scratch: &mut RefineScratch,
        settled: &mut GelFitScratch,
    ) -> End {
        candidates.clear();
        for k in 0..self.params.surface_search.starts {
            candidates.push(Candidate::at(start(&self.prior, k)));
        }
        self.round(candidates, &FIRST, self.samples.coarse_unpressed);
        candidates.truncate(FIRST.keeps);
        self.round(candidates, &SECOND, self.samples.medium_unpressed);
        runners_up.clear();
        runners_up.extend_from_slice(candidates);
        keep(candidates, SECOND.keeps, self.samples.radius_mm, self.params.scaled(SECOND.same_mm));
        self.is_settled = false;
        if self.samples.gel.is_known() {
            let before: [Option<Candidate>; KEPT] = core::array::from_fn(|k| candidates.get(k).copied());
            let end = self.settle_few(candidates, settled);
            let is_spent = self.has_spent();
            let without = before[0].filter(|_| is_spent).map_or(f64::INFINITY, |one| {
                let (cost, work) = self.refine(self.faces).compare(&one.placement, scratch);
                self.work += work;
                cost
            });
            settled.show(candidates[0].slot);
            let (with, work) = self.refine(self.faces).compare(&candidates[0].placement, scratch);
            self.work += work;
            // Interrupted steps may have made the pose worse, and no budget is left to repair it.
            self.is_settled = if is_spent { with <= without } else { settled.here.explained() >= EXPLAINED };
            if self.is_settled {
                return self.others(candidates, runners_up, end, (scratch, settled));
            }
            candidates.clear();
            candidates.extend(before.into_iter().flatten());
        }
        for k in 0..candidates.len() {
            if self.has_spent() {
                candidates.truncate(k.max(1));
                break;
            }
            let polish = self.refine(self.field);
            let left = self.left();
            let end = polish.run(&mut candidates[k], FIELD_STEPS, left, scratch);
            let (cost, work) = polish.compare(&candidates[k].placement, scratch);
            candidates[k].cost = cost;
            self.work += end.work + work;
        }
        keep(candidates, FINALISTS, self.samples.radius_mm, self.params.scaled(SECOND.same_mm));
        let end = self.finish(candidates, scratch);
        self.others(candidates, runners_up, end, (scratch, settled))
    }

    /// Finds the alternatives. Returns how the best pose ended, and leaves its readings, or prediction,
    /// in the scratch.
    fn others(
        &mut self,
        candidates: &mut Vec<Candidate>,
        runners_up: &mut Vec<Candidate>,
        end: End,
        (scratch, settled): (&mut RefineScratch, &mut GelFitScratch),
    ) -> End {
        let before = self.work;
        self.is_cut = self.has_spent();
        let asked = self.is_settled.then_some(&*settled);
        let odds = odds(self.params, self.samples, (scratch, asked));
        // If the part is not what is in contact, there are no alternatives.
        if odds.log <= 0.0 {
            candidates.truncate(1);
            return end;
        }
        // If the gel does not follow its model, likelihoods of poses are not comparable. Only rotations
        // after which the part looks the same are then known.
        if !odds.is_law_kept {
            candidates.truncate(1);
            runners_up.clear();
            self.is_cut = true;
        }
        let mut others = Modes::new(self, (&candidates[0], end), (scratch, settled));
        if odds.is_law_kept {
            others.hold(&mut candidates[0]);
        }
        let ((mut read, end), is_cut) = others.find(candidates, runners_up);
        self.is_cut |= is_cut;
        if self.work > before {
            self.read(&mut read, scratch, settled);
        }
        self.read_at = Some(read.placement);
        end
    }

    /// Leaves the readings of a pose, and the gel prediction if used, in the scratch.
    pub fn read(&mut self, best: &mut Candidate, scratch: &mut RefineScratch, settled: &mut GelFitScratch) {
        if self.is_settled {
            self.work += self.settled(true).begin(best, settled);
            settled.show(best.slot);
        }
        let (cost, work) = self.refine(self.faces).compare(&best.placement, scratch);
        self.work += work;
        if !self.is_settled {
            best.cost = cost;
        }
    }

    pub fn settled(&self, is_exact: bool) -> GelFit<'_> {
        GelFit {
            params: self.params,
            samples: self.samples,
            press_direction: self.press_direction,
            field: self.field,
            faces: is_exact.then_some(self.faces),
            prior: self.prior,
            stop: self.stop,
        }
    }

    /// Information from the gel about the candidate whose prediction is in `settled`. `ended` is whether
    /// its steps converged.
    pub fn told(&self, best: &Candidate, ended: bool, settled: &mut GelFitScratch) -> Told {
        let way = self.settled(true);
        let information = way.information(best, settled);
        let left_mm = if ended { 0.0 } else { way.left_mm(best, settled) };
        Told { press_direction: self.press_direction, information, left_mm }
    }

    /// Ranks the candidates by the gel model, best first: the first few, and the others if these do not fit.
    fn settle_few(&mut self, candidates: &mut Vec<Candidate>, settled: &mut GelFitScratch) -> End {
        let rest = Rest { plane_mm: self.samples.gel.rest_plane(self.samples.radius_mm), log_decay: 0.0 };
        for (slot, candidate) in candidates.iter_mut().enumerate() {
            (candidate.rest, candidate.slot) = (rest, slot);
        }
        settled.clear(&self.samples.gel);
        let all: [Option<Candidate>; KEPT] = core::array::from_fn(|k| candidates.get(k).copied());
        candidates.truncate(FIRST_FEW);
        let end = self.settle(candidates, &BLURRED, settled);
        let best = candidates[0];
        let left = all.into_iter().flatten().filter(|one| one.slot != best.slot);
        if self.has_spent() || settled.kept(best.slot).misfit() <= FITS || left.clone().count() == 0 {
            return end;
        }
        candidates.clear();
        candidates.extend(left);
        let budget = self.limit;
        let is_short = self.work as f64 > SHORT * budget as f64;
        self.limit = (SEARCHED * budget as f64) as u64;
        let end_on = self.settle(candidates, if is_short { &BLURRED_SHORT } else { &BLURRED_ON }, settled);
        self.limit = budget;
        // Among equals the first one stays first.
        candidates.insert(0, best);
        keep(candidates, FINALISTS, 0.0, 0.0);
        if candidates[0].slot == best.slot {
            return end;
        }
        if end_on.converged {
            return end_on;
        }
        let most = self.params.advanced.max_iterations.min(MAX_STEPS).saturating_sub(end_on.iterations);
        let last = self.settle_all(&mut candidates[..1], most, settled);
        End { iterations: end_on.iterations + last.iterations, ..last }
    }

    /// Ranks the candidates by the gel model, best first.
    fn settle(
        &mut self,
        candidates: &mut Vec<Candidate>,
        blurred: &[(f64, usize)],
        settled: &mut GelFitScratch,
    ) -> End {
        self.begin_all(false, candidates, settled);
        for &(width_mm, keeps) in blurred {
            self.blurred_all((false, self.params.scaled(width_mm)), candidates, settled);
            keep(candidates, keeps, self.samples.radius_mm, self.params.scaled(SECOND.same_mm));
        }
        self.begin_all(true, candidates, settled);
        // No candidate is dropped before convergence: one marker that an edge has yet to pass changes the
        // cost by ten or more.
        self.blurred_all((true, self.params.scaled(SHARP_MM)), candidates, settled);
        let end = self.settle_all(candidates, self.params.advanced.max_iterations.min(MAX_STEPS), settled);
        keep(candidates, FINALISTS, 0.0, 0.0);
        end
    }

    /// Runs one stage of a pose after the best one with the gel model.
    pub fn settle_on(&mut self, one: &mut Candidate, stage: Stage, settled: &mut GelFitScratch) -> End {
        let way = self.settled(stage != Stage::Field);
        let mut work = way.begin(one, settled);
        match stage {
            Stage::Field => work += way.blurred(one, self.params.scaled(FIELD_MM), settled),
            Stage::First => work += way.blurred(one, self.params.scaled(SHARP_MM), settled),
            Stage::Last => {}
        }
        self.work += work;
        let most = if stage == Stage::Last { self.params.advanced.max_iterations.min(MAX_STEPS) } else { 0 };
        self.settle_all(core::slice::from_mut(one), most, settled)
    }

    /// Predicts the gel at the candidates' current states. Drops those for which no budget is left.
    fn begin_all(&mut self, is_exact: bool, candidates: &mut Vec<Candidate>, settled: &mut GelFitScratch) {
        for k in 0..candidates.len() {
            if k > 0 && self.has_spent() {
                return candidates.truncate(k);
            }
            self.work += self.settled(is_exact).begin(&mut candidates[k], settled);
        }
    }

    fn blurred_all(
        &mut self,
        (is_exact, width_mm): (bool, f64),
        candidates: &mut [Candidate],
        settled: &mut GelFitScratch,
    ) {
        for candidate in candidates {
            if !self.has_spent() {
                self.work += self.settled(is_exact).blurred(candidate, width_mm, settled);
            }
        }
    }

    /// Returns how the best one ended.
    fn settle_all(&mut self, candidates: &mut [Candidate], most: u32, settled: &mut GelFitScratch) -> End {
        let mut best = (f64::INFINITY, End { converged: false, iterations: 0, work: 0 });
        for k in 0..candidates.len() {
            if k > 0 && self.has_spent() {
                break;
            }
            let left = self.left();
            let end = self.settled(true).run(&mut candidates[k], (most, left), settled);
            self.work += end.work;
            if candidates[k].cost < best.0 {
                best = (candidates[k].cost, end);
            }
        }
        best.1
    }

    /// Refines the finalists on the exact surface, best first. Returns how the best one ended; its
    /// readings are in the scratch.
    fn finish(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut RefineScratch) -> End {
        if candidates.len() > 1 {
            self.refine_all(candidates, FIRST_STEPS, scratch);
            keep(candidates, FINALISTS, 0.0, 0.0);
            let hopeless = candidates[0].cost + HOPELESS;
            let near = candidates.iter().take_while(|c| c.cost < hopeless).count();
            candidates.truncate(near.max(1));
        }
        let end = self.refine_all(candidates, self.params.advanced.max_iterations.min(MAX_STEPS), scratch);
        keep(candidates, FINALISTS, 0.0, 0.0);
        let (_, work) = self.refine(self.faces).compare(&candidates[0].placement, scratch);
        self.work += work;
        end
    }

    /// Runs one stage of a pose after the best one without the gel model.
    pub fn finish_on(&mut self, one: &mut Candidate, stage: Stage, scratch: &mut RefineScratch) -> End {
        match stage {
            Stage::Field => {
                let left = self.left();
                let end = self.refine(self.field).run(one, FIELD_STEPS, left, scratch);
                self.work += end.work;
                end
            }
            Stage::First => self.refine_one(one, FIRST_STEPS, scratch),
            Stage::Last => self.refine_one(one, self.params.advanced.max_iterations.min(MAX_STEPS), scratch),
        }
    }

    /// Returns how it ended.
    fn refine_one(&mut self, candidate: &mut Candidate, most: u32, scratch: &mut RefineScratch) -> End {
        let left = self.left();
        let polish = self.refine(self.faces);
        let end = polish.run(candidate, most, left, scratch);
        let (cost, work) = polish.compare(&candidate.placement, scratch);
        candidate.cost = cost;
        self.work += end.work + work;
        end
    }

    /// Returns how the best one ended.
    fn refine_all(&mut self, candidates: &mut Vec<Candidate>, most: u32, scratch: &mut RefineScratch) -> End {
        let mut best = (f64::INFINITY, End { converged: false, iterations: 0, work: 0 });
        for k in 0..candidates.len() {
            if k > 0 && self.has_spent() {
                candidates.truncate(k);
                break;
            }
            let end = self.refine_one(&mut candidates[k], most, scratch);
            if candidates[k].cost < best.0 {
                best = (candidates[k].cost, end);
            }
        }
        best.1
    }
}
