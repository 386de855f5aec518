//! Single-start search from the guess: refinement of a nearly known pose.

use super::candidate::Candidate;
use super::coarse::{Clear, View};
use super::refine::{RefineScratch, Refinement};
use super::search::Outcome;
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

impl Search<'_> {
    /// Refines the guess: on the field, then on the exact surface.
    pub fn close(&mut self, candidates: &mut Vec<Candidate>, scratch: &mut RefineScratch) -> Outcome {
        let (problem, params) = (self.problem, self.problem.params);
        let mut one = Candidate::at(problem.prior.guess);
        self.look_closer(&mut one, &mut scratch.clear);
        let on_field =
            Refinement { reach_mm: params.scaled(SLIDE_REACH_MM), ..Refinement::new(problem, problem.field) };
        self.work += on_field.slide(&mut one, self.limits(SLIDES), scratch).work;
        let exact = Refinement {
            reach_mm: params.scaled(CLOSE_REACH_MM),
            halvings: HALVINGS,
            pushes_bluntly: true,
            ..Refinement::new(problem, problem.faces)
        };
        let limits = self.limits(params.advanced.max_iterations.min(STEPS));
        let end = exact.run(&mut one, limits, scratch);
        let (cost, work) = exact.compare_ended(&one.placement, scratch);
        self.work += end.work + work;
        one.cost = cost;
        candidates.clear();
        candidates.push(one);
        Outcome { end, read: one, is_cut: false, is_selected: false, work: self.work }
    }

    /// Coarse passes of decreasing width.
    fn look_closer(&mut self, candidate: &mut Candidate, clear: &mut [Clear]) {
        let problem = self.problem;
        let (samples, press_direction, field) = (problem.samples, problem.press_direction, &problem.field);
        let view = View::of(samples, samples.may_touch(), samples.medium_unpressed, press_direction);
        let widest_mm = WIDEST * problem.params.start_sigma_mm;
        let narrowest_mm =
            (NARROWEST * samples.sigma_mm(press_direction)).max(BLUNT * field.field.cell_mm()).min(widest_mm);
        let ratio = exp(ln(narrowest_mm / widest_mm) / f64::from(NARROWING));
        // Around holes the field does not bound the distance either.
        let reach_mm = if problem.faces.solid.is_closed() { field.field.reach_mm() } else { 0.0 };
        let mut width_mm = widest_mm;
        for look in 0..NARROWING + NARROW {
            if self.has_spent() {
                return;
            }
            let sum = view.look_again(field, &candidate.placement, width_mm, clear, reach_mm);
            self.step_by(candidate, &view, sum);
            if look < NARROWING {
                width_mm *= ratio;
            }
        }
    }
}
