//! Consistency check of a tracked pose: the predicted gel against all markers.
//!
//! A wrong pose can be in contact with most of the patch. The gel beside it is then too high or too low,
//! which shows in the squared deviations over all markers.

use super::candidate::Candidate;
use super::gel::fit::GelFit;
use super::gel::prediction::{GelFitScratch, LIFTED, MAX_SQUARE, Prediction};
use super::gel::rest::Rest;
use super::state::{Problem, Search};
use crate::math::sqrt;

/// Steps from a pose of a rung without the gel model, which is off by several standard deviations of the
/// gel fit. In 20 rounds of a simulated part in a soft gel, with 3 steps the residuals of poses that had not
/// converged became usual, and another part was accepted twice; with 6 and 12 never.
const STEPS: u32 = 6;
/// A correct converged pose is doubted once in e^14, 1.2 million, frames if its markers are independent.
/// Errors of the gel model are common to neighbours; the usual residuals include them.
const ALARM_LOG: f64 = 14.0;
/// Once the usual residuals are known, one of this many frames is run to the end and learned from,
/// whatever its result.
const LEARNED_OF: u32 = 8;
/// Number of remembered markers, those of some ten frames, and the weight of the prior in markers.
const REMEMBERED: f64 = 4000.0;
const BEFORE: f64 = 100.0;

/// Deviation of the markers that the part lifts, by the pose or by measurement, from the predicted gel:
/// squares of their distances in standard deviations, each up to 16.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Number of lifted markers.
    pub markers: usize,
    /// Mean of the squares; about 1 at a correct pose.
    pub mean: f64,
    /// Mean of the squares' squares.
    pub mean_square: f64,
}

impl Misfit {
    fn of(here: &Prediction) -> Self {
        let (mut markers, mut sum, mut sum_squares) = (0_usize, 0.0, 0.0);
        for (sight, &height_mm) in here.sights.iter().zip(&here.heights_mm) {
            let square = sight.square().min(MAX_SQUARE);
            let is_lifted = height_mm * height_mm > LIFTED * LIFTED * sight.variance_mm2;
            if sight.touches || is_lifted || square == MAX_SQUARE {
                markers += 1;
                sum += square;
                sum_squares += square * square;
            }
        }
        let per_marker = 1.0 / markers.max(1) as f64;
        Self { markers, mean: sum * per_marker, mean_square: sum_squares * per_marker }
    }
}

/// The squares at accepted poses after convergence.
#[derive(Clone, Copy, Debug)]
pub(in crate::register) struct UsualResiduals {
    mean: f64,
    mean_square: f64,
    markers: f64,
    /// Frames since the last one learned from.
    since: u32,
}

impl UsualResiduals {
    /// Prior before any frame: normal deviations, and outliers.
    pub fn new(outlier_share: f64) -> Self {
        let good = 1.0 - outlier_share;
        Self {
            mean: good + outlier_share * MAX_SQUARE,
            mean_square: 3.0 * good + outlier_share * MAX_SQUARE * MAX_SQUARE,
            markers: BEFORE,
            since: 0,
        }
    }

    /// Whether a frame need not be run to the end: enough markers are remembered, and it is not the one
    /// of several that is learned from.
    pub fn is_enough(&mut self) -> bool {
        self.since += 1;
        self.markers >= REMEMBERED && self.since < LEARNED_OF
    }

    /// Learns from a frame; older ones count less. The frame must have run to the end whatever its
    /// result. Others stop as soon as they are usual, and learning from those that do not would raise the
    /// usual residuals without limit.
    pub fn learn(&mut self, one: &Misfit) {
        let count = one.markers as f64;
        let share = count / (self.markers + count);
        self.mean += share * (one.mean - self.mean);
        self.mean_square += share * (one.mean_square - self.mean_square);
        self.markers = (self.markers + count).min(REMEMBERED);
        self.since = 0;
    }

    /// Whether usual deviations are as large with a probability below e^-14 (Bernstein 1924). The sum of
    /// n squares below b, of variance v, exceeds its mean by t with a probability below e^(-t² / 2 (n
    /// v + b t / 3)).
    pub fn is_exceeded(&self, by: &Misfit) -> bool {
        let count = by.markers as f64;
        let variance = (self.mean_square - self.mean * self.mean).max(0.0);
        let b = ALARM_LOG * MAX_SQUARE / 3.0;
        let max_excess = b + sqrt(b * b + 2.0 * ALARM_LOG * count * variance);
        count * (by.mean - self.mean) > max_excess
    }
}

/// Deviation at the guess, after the first step at which it is usual, or after all steps.
pub(super) fn misfit(
    problem: &Problem<'_>,
    usual: Option<&UsualResiduals>,
    scratch: &mut GelFitScratch,
) -> Misfit {
    let gel = &problem.samples.gel;
    let rest = Rest { plane_mm: gel.rest_plane(problem.samples.radius_mm), log_decay: 0.0 };
    let mut one = Candidate { rest, ..Candidate::at(problem.prior.guess) };
    scratch.clear(gel);
    let fit = GelFit::exact(problem);
    fit.begin_anew(&mut one, scratch);
    for _ in 0..STEPS {
        let so_far = Misfit::of(scratch.kept(one.slot));
        if usual.is_some_and(|usual| !usual.is_exceeded(&so_far)) {
            return so_far;
        }
        let one_step = Search::new(problem).limits(1);
        if fit.run(&mut one, one_step, scratch).converged {
            break;
        }
    }
    Misfit::of(scratch.kept(one.slot))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn misfit(markers: usize, mean: f64) -> Misfit {
        Misfit { markers, mean, mean_square: 3.0 * mean * mean }
    }

    #[test]
    fn what_deviates_more_than_chance_explains_exceeds_the_usual() {
        let mut usual = UsualResiduals { mean: 1.0, mean_square: 3.0, markers: REMEMBERED, since: 0 };
        // b = 74.67; for 400 squares of variance 2 the excess is 74.67 + √(74.67² + 28 · 800) = 242.0,
        // 0.605 each.
        assert!(!usual.is_exceeded(&misfit(400, 1.604)) && usual.is_exceeded(&misfit(400, 1.606)));
        assert!(!usual.is_exceeded(&misfit(0, 0.0)) && !usual.is_exceeded(&misfit(5, 16.0)));
        assert!(usual.is_exceeded(&misfit(30, 16.0)));
        // A tenth of outliers is usual where expected, and unusual after learning from markers without any.
        usual = UsualResiduals::new(0.1);
        assert!(!usual.is_exceeded(&misfit(400, 2.5)));
        for _ in 0..20 {
            usual.learn(&misfit(400, 1.0));
        }
        assert!(usual.is_exceeded(&misfit(400, 2.5)) && !usual.is_exceeded(&misfit(400, 1.5)));
    }

    /// One of several frames is run to the end, once enough markers are remembered.
    #[test]
    fn what_is_learned_from_is_not_chosen_by_what_it_shows() {
        let mut usual = UsualResiduals::new(0.1);
        assert!((0..20).all(|_| !usual.is_enough()), "nothing is known yet");
        for _ in 0..10 {
            usual.learn(&misfit(400, 1.0));
        }
        let mut learned = 0;
        for _ in 0..80 {
            if !usual.is_enough() {
                usual.learn(&misfit(400, 1.0));
                learned += 1;
            }
        }
        assert_eq!(learned, 10);
    }
}
