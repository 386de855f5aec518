//! Single-start search from the guess: tracking, and refinement of a nearly known pose.

use super::candidate::{Candidate, End};
use super::coarse::{Clear, View};
use super::refine::{RefineScratch, Refinement};
use super::state::Search;
use crate::math::{exp, ln};
use alloc::vec::Vec;

/// Widths of the coarse passes, in standard deviations of the guess (widest) and of the noise
/// (narrowest). They shrink in equal ratios and then stay (graduated non-convexity, Blake and Zisserman
/// 1987). Wide passes converge from afar; only narrow ones separate the gel's shoulder from the part. A
/// pass costs a fifth of a step on the exact surface.
const WIDEST: f64 = 0.25;
const NARROWEST: f64 = 3.0;
const NARROWING: u32 = 4;
const NARROW: u32 = 10;
/// Least width of a pass, in cells: about the bend of the field between its nodes.
const BLUNT: f64 = 0.25;
/// Unchecked steps on the field, and then steps on the exact surface.
const SLIDES: u32 = 2;
const STEPS: u32 = 4;
/// Halvings of a step on the exact surface. If the full step fails an edge is near, and a shorter one
/// gains less than it costs.
const HALVINGS: u32 = 0;
/// Other markers are not evaluated from this distance over the part: they have influence up to 0.5 mm,
/// and the part hardly moves by then.
const SLIDE_REACH_MM: f64 = 1.0;
const CLOSE_REACH_MM: f64 = 0.7;
/// Field steps of tracking. From 0.5 degrees and 0.1 mm off, five succeed no more often and take a fifth
/// longer. On successive frames, each started from the previous result, five leave one in fifty fewer wrong.
const TRACK_STEPS: u32 = 3;

impl Search<'_> {
    /// Tracks from the guess, on the field.
    pub fn track(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut RefineScratch) -> End {
        self.begin_at_guess(candidates);
        let polish = self.refine(self.field);
        let end = polish.slide(&mut candidates[0], TRACK_STEPS, self.limit, scratch);
        // The field has no curvature; without it facets would appear to determine a cylinder's spin.
        let (cost, work) = self.refine(self.faces).compare(&candidates[0].placement, scratch);
        candidates[0].cost = cost;
        self.work = end.work + work;
        end
    }

    /// Refines the guess: on the field, then on the exact surface.
    pub fn close(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut RefineScratch) -> End {
        self.begin_at_guess(candidates);
        self.look_closer(&mut candidates[0], &mut scratch.clear);
        let left = self.left();
        let polish = Refinement { reach_mm: self.params.scaled(SLIDE_REACH_MM), ..self.refine(self.field) };
        self.work += polish.slide(&mut candidates[0], SLIDES, left, scratch).work;
        let left = self.left();
        let polish = Refinement {
            reach_mm: self.params.scaled(CLOSE_REACH_MM),
            halvings: HALVINGS,
            pushes_bluntly: true,
            ..self.refine(self.faces)
        };
        let end =
            polish.run(&mut candidates[0], self.params.advanced.max_iterations.min(STEPS), left, scratch);
        let (cost, work) = polish.compare_ended(&candidates[0].placement, scratch);
        candidates[0].cost = cost;
        self.work += end.work + work;
        end
    }

    /// Coarse passes of decreasing width.
    fn look_closer(&mut self, candidate: &mut Candidate, clear: &mut [Clear]) {
        let touching = self.samples.may_touch();
        let view = View::of(self.samples, touching, self.samples.medium_unpressed, self.press_direction);
        let widest_mm = WIDEST * self.params.start_sigma_mm;
        let narrowest_mm = (NARROWEST * self.samples.sigma_mm(self.press_direction))
            .max(BLUNT * self.field.field.cell_mm())
            .min(widest_mm);
        let ratio = exp(ln(narrowest_mm / widest_mm) / f64::from(NARROWING));
        // Around holes the field does not bound the distance either.
        let reach_mm = if self.faces.solid.is_closed() { self.field.field.reach_mm() } else { 0.0 };
        let mut width_mm = widest_mm;
        for look in 0..NARROWING + NARROW {
            if self.has_spent() {
                return;
            }
            let sum = view.look_again(&self.field, &candidate.placement, width_mm, (clear, reach_mm));
            self.step_by(candidate, &view, sum);
            if look < NARROWING {
                width_mm *= ratio;
            }
        }
    }

    fn begin_at_guess(&self, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        candidates.push(Candidate::at(self.prior.guess));
    }
}
