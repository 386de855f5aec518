//! From the guess alone: a part that is followed, and one whose pose is nearly known.

use super::fit::View;
use super::polish::{End, Polish, PolishScratch};
use super::search::{Candidate, MOST_STEPS, Search};
use alloc::vec::Vec;

/// From a guess that is close: coarse looks, and steps on the field that are not checked. A step on the exact surface costs
/// several of them.
const CLOSE: &[f64] = &[0.5, 0.25, 0.15];
const SLIDES: u32 = 8;
/// Halvings of a step on the exact surface: where a quarter of it is no better an edge is near, and less of it gains less than it
/// costs.
const HALVINGS: u32 = 2;
/// Other markers this far over the part are not looked at: they count up to half a millimetre, and by then the part hardly
/// moves.
const SLIDE_REACH_MM: f64 = 1.0;
const CLOSE_REACH_MM: f64 = 0.7;
/// Steps on the field of a part that is followed.
const TRACK_STEPS: u32 = 5;

impl Search<'_> {
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
        let polish = Polish { reach_mm: CLOSE_REACH_MM, halvings: HALVINGS, ..self.polish(self.faces) };
        let end = polish.run(&mut candidates[0], self.params.max_iterations.min(MOST_STEPS), left, scratch);
        let (cost, work) = polish.compare_ended(&candidates[0].placement, scratch);
        candidates[0].cost = cost;
        self.work += end.work + work;
        end
    }

    fn begin_at_guess(&self, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        candidates.push(Candidate::at(self.prior.guess));
    }
}
