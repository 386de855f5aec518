//! Saliency for a gel whose law is not known: several rules propose a contact, and the gel's curvature
//! chooses.
//!
//! A rigid part presses its own convex surface into the gel, so that the gel is concave under it, -Δh > 0.
//! Beside the contact the gel returns to rest and is convex, Δh > 0. This holds for a foundation with
//! tension, for an elastic layer and for a gel without any shoulder, so the border of the contact is where
//! the curvature changes its sign, as an edge is in an image (Marr and Hildreth 1980). A single second
//! difference is too noisy to be a rule of its own. The sum over a whole contact and its ring is not, so it
//! chooses among a few candidates: the markers in contact by [`QuickPressure`] for a set of decay lengths,
//! and those indented by more than a share of the deepest indentation. For an elastic half-space under a ball
//! the share is a half (Hertz 1882); in thin layers it is less.

use super::quick::QuickPressure;
use super::rule::LEAST_SIGMA_MM;
use super::stencils::{Regions, Stencils};
use super::{ContactError, RestSurface};
use crate::math::{abs, sqrt};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Decay lengths that are tried, over the given one. With 2.5 mm they are 2.5 to 0.5 mm.
const DECAYS: [f64; 5] = [1.0, 0.64, 0.4, 0.28, 0.2];
/// Smallest and largest share of the deepest indentation that is tried, in steps. On the half for work of the
/// contacts by finite elements, 3 to 11 steps are chosen.
const SHARES: (u32, u32) = (1, 12);
/// Step of the shares.
const SHARE_STEP: f64 = 0.05;
/// Standard deviations that the indentation of a marker in contact must exceed.
const MIN_SIGMAS: f64 = 3.0;

/// What another rule must score more than pressure with the longest decay, in deviations that noise gives a
/// single marker's part of the score. Without it noise chooses in the shallowest contacts. Tried: 0, 1, 2 and
/// 4. On simulated presses with 10 um of noise, F1 of balls, cylinders and tilted parts is 0.90, 0.92, 0.940
/// and 0.943. On the contacts for work by finite elements, 4 costs 0.02 beside 2.
const MARGIN: f64 = 2.0;

/// The rule by which the markers in contact were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ContactRule {
    /// The gel carries pressure there, for a gel that returns to rest over this length.
    Pressure {
        /// The decay length.
        decay_mm: f64,
    },
    /// The indentation is more than this share of the deepest one.
    Share {
        /// The share, 0 to 1.
        share: f64,
    },
}

/// Finds the markers in contact without knowing the law of the gel; scratch is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct AdaptiveSaliency {
    pressures: Vec<QuickPressure>,
    /// Signed square root of every marker's curvature, so that no single marker decides; 0 where a height is
    /// missing.
    bend: Vec<f64>,
    variance_mm2: Vec<f64>,
    evidence: Vec<f64>,
    candidate: Vec<bool>,
    seen_mm: Vec<f64>,
    regions: Regions,
}

impl AdaptiveSaliency {
    /// For this rest surface of `rows * cols` markers, row by row. `max_decay_mm` is the longest decay length
    /// that is tried.
    ///
    /// # Errors
    /// As [`QuickPressure::new`].
    pub fn new(
        rest: &RestSurface,
        rows: usize,
        cols: usize,
        max_decay_mm: f64,
    ) -> Result<Self, ContactError> {
        let new = |&share: &f64| QuickPressure::new(rest, rows, cols, (share * max_decay_mm).max(1e-3));
        // A longer length than the given one is refused like that one.
        QuickPressure::new(rest, rows, cols, max_decay_mm)?;
        let mut adaptive =
            Self { pressures: DECAYS.iter().map(new).collect::<Result<_, _>>()?, ..Self::default() };
        let markers = rows * cols;
        let Self { bend, variance_mm2, evidence, candidate, seen_mm, regions, .. } = &mut adaptive;
        [bend, variance_mm2, evidence, seen_mm].into_iter().for_each(|list| list.reserve(markers));
        candidate.reserve(markers);
        regions.reserve(markers);
        Ok(adaptive)
    }

    /// Markers in contact, from the indentations and their variances (mm²), and the rule that found them:
    /// `None` when nothing touches the gel. Markers that are not seen are never salient. `out` is cleared
    /// first; no allocation once it has held this many.
    ///
    /// # Errors
    /// As [`QuickPressure::run`]; `out` is then empty.
    pub fn run(
        &mut self,
        indentation_mm: &[f64],
        variance_mm2: impl Iterator<Item = f64>,
        state: &[MarkerState],
        out: &mut Vec<bool>,
    ) -> Result<Option<ContactRule>, ContactError> {
        out.clear();
        self.variance_mm2.clear();
        self.variance_mm2.extend(variance_mm2);
        let (mut best, mut rule) = (f64::NEG_INFINITY, None);

        for k in 0..self.pressures.len() {
            let Self { pressures, candidate, variance_mm2, .. } = self;
            if let Err(error) =
                pressures[k].run(indentation_mm, variance_mm2.iter().copied(), state, candidate)
            {
                out.clear();
                return Err(error);
            }
            if k == 0 {
                out.resize(indentation_mm.len(), false);
                self.bend(indentation_mm);
            }
            // A gel that keeps its volume is concave too where it bulges beside the contact, but not indented
            // there.
            let heights = indentation_mm.iter().zip(&self.variance_mm2);
            for (touches, (&h, &variance)) in self.candidate.iter_mut().zip(heights) {
                *touches &= h > MIN_SIGMAS * sqrt(variance);
            }
            let decay_mm = self.pressures[k].decay_mm();
            self.compare(ContactRule::Pressure { decay_mm }, &mut best, &mut rule, out);
            if k == 0 {
                let longest = &self.pressures[0];
                best += MARGIN * sqrt(longest.sigma_mm() * sqrt(longest.mean_noise()));
            }
        }
        if rule.is_some() {
            self.try_shares(indentation_mm, state, &mut best, &mut rule, out);
        }
        Ok(rule)
    }

    /// Candidates by shares of the deepest indentation; the second deepest stands for it, as one marker may
    /// be wrong.
    fn try_shares(
        &mut self,
        indentation_mm: &[f64],
        state: &[MarkerState],
        best: &mut f64,
        rule: &mut Option<ContactRule>,
        out: &mut [bool],
    ) {
        let seen = |&(_, &state): &(&f64, &MarkerState)| state == MarkerState::Seen;
        self.seen_mm.clear();
        self.seen_mm.extend(indentation_mm.iter().zip(state).filter(seen).map(|(&h, _)| h));
        if self.seen_mm.len() < 2 {
            return;
        }
        let place = self.seen_mm.len() - 2;
        let &mut deepest_mm = self.seen_mm.select_nth_unstable_by(place, f64::total_cmp).1;
        self.evidence.clear();
        let heights = indentation_mm.iter().zip(&self.variance_mm2).zip(state);
        self.evidence.extend(heights.map(|((&h, &variance), &state)| {
            if state == MarkerState::Seen {
                h * abs(h) / variance.max(LEAST_SIGMA_MM * LEAST_SIGMA_MM)
            } else {
                0.0
            }
        }));
        for step in SHARES.0..=SHARES.1 {
            let share = f64::from(step) * SHARE_STEP;
            let Self { candidate, evidence, regions, pressures, .. } = self;
            candidate.clear();
            let pairs = indentation_mm.iter().zip(evidence.iter());
            candidate.extend(
                pairs.map(|(&h, &evidence)| h > share * deepest_mm && evidence > MIN_SIGMAS * MIN_SIGMAS),
            );
            regions.keep_sure(pressures[0].stencils(), evidence, state, candidate);
            self.compare(ContactRule::Share { share }, best, rule, out);
        }
    }

    /// Takes the candidate over when it is the best so far.
    fn compare(&self, from: ContactRule, best: &mut f64, rule: &mut Option<ContactRule>, out: &mut [bool]) {
        let Some(score) = score(self.pressures[0].stencils(), &self.bend, &self.candidate) else { return };
        if score > *best {
            (*best, *rule) = (score, Some(from));
            out.copy_from_slice(&self.candidate);
        }
    }

    /// Curvatures from the first pressures, p = h - l² Δh.
    fn bend(&mut self, indentation_mm: &[f64]) {
        let (pressure_mm, valid) = self.pressures[0].measured();
        let values = indentation_mm.iter().zip(pressure_mm).zip(valid);
        self.bend.clear();
        self.bend.extend(values.map(|((&h, &p), &valid)| {
            let curvature = if valid { h - p } else { 0.0 };
            if curvature < 0.0 { -sqrt(-curvature) } else { sqrt(curvature) }
        }));
    }
}

/// How much the gel is concave in a candidate and convex in the ring around it, over the root of the count,
/// in which chance would grow; `None` for an empty candidate.
fn score(lattice: &Stencils, bend: &[f64], candidate: &[bool]) -> Option<f64> {
    let (mut sum, mut inside, mut around) = (0.0, 0_usize, 0_usize);
    for (i, &touches) in candidate.iter().enumerate() {
        if touches {
            sum -= bend[i];
            inside += 1;
        } else if lattice.taps(i).skip(1).any(|(k, _)| candidate[k]) {
            sum += bend[i];
            around += 1;
        }
    }
    (inside > 0).then(|| sum / sqrt((inside + around) as f64))
}
