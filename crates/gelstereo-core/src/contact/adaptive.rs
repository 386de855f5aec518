//! Saliency for a gel whose law is not known: pressure where its law holds, and else the gel's curvature
//! chooses among what several rules propose.
//!
//! Where the law p = h - l² Δh holds, nothing presses beside a contact, so that the pressures of a ring around
//! it add up to noise. In their sum most of the noise of the second differences cancels. A sum below that
//! shows a gel that comes back to rest on a shorter way, or by another law.
//!
//! A rigid part presses its own convex surface into the gel, so that the gel is concave under it, -Δh > 0.
//! Beside the contact the gel returns to rest and is convex, Δh > 0. This holds for a foundation with
//! tension, for an elastic layer and for a gel without any shoulder, so the border of the contact is where
//! the curvature changes its sign, as an edge is in an image (Marr and Hildreth 1980). A single second
//! difference is too noisy to be a rule of its own. The sum over a whole contact and its ring is not, so it
//! chooses among a few candidates: the markers in contact by [`QuickPressure`] for the longest decay length,
//! those that carry pressure beyond its noise for shorter ones, and those indented by more than a share of the
//! deepest indentation. For an elastic half-space under a ball the share is a half (Hertz 1882); in thin layers
//! it is less.

use super::quick::QuickPressure;
use super::rule::{MIN_SIGMA_MM, START};
use super::stencils::Regions;
use super::{ContactError, RestSurface};
use crate::math::{abs, sqrt};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Decay lengths that are tried beside the given one, over that. With 2.5 mm they are 1.6 to 0.5 mm. Their
/// pressures are so little noisier than the heights that a threshold will do: settling the labels as
/// [`QuickPressure`] does costs four times as much as all else here, and gains up to 0.009 of F1 on the
/// contacts for work by finite elements with 5 um of noise, 0.006 with 10 um.
const SHORTER: [f64; 4] = [0.64, 0.4, 0.28, 0.2];
/// Smallest and largest share of the deepest indentation that is tried, in steps. On the half for work of the
/// contacts by finite elements, 3 to 11 steps are chosen.
const SHARES: (u32, u32) = (1, 12);
/// Step of the shares.
const SHARE_STEP: f64 = 0.05;
/// Standard deviations that the indentation of a marker in contact must exceed.
const MIN_SIGMAS: f64 = 3.0;

/// Rows and columns together from a contact to the nearest and farthest markers of its ring. Stencils of the
/// very next ones share heights with the contact's rim.
const RING: (u8, u8) = (2, 3);
/// How far the pressures of the ring may be from none in all: in standard deviations of their sum, and as a
/// share of the heights there, for the five points of the stencil give (pitch / l)² / 12 of these, 0.01. Tried:
/// 3 and 5, with 0.05, 0.1 and 0.2. Where the law holds, in simulated presses with 5 and 10 um of noise, F1 is
/// that of pressure with all of them; on the contacts for work by finite elements 5 costs up to 0.04.
const LAW_MARGIN: (f64, f64) = (3.0, 0.1);

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
    pressure: QuickPressure,
    /// Of the lengths [`SHORTER`], for every marker: the pressure's standard deviation for heights of variance
    /// 1, inverted.
    per_noise: [Vec<f64>; SHORTER.len()],
    /// Signed square root of every marker's curvature, so that no single marker decides; 0 where a height is
    /// missing.
    bend: Vec<f64>,
    variance_mm2: Vec<f64>,
    evidence: Vec<f64>,
    candidate: Vec<bool>,
    seen_mm: Vec<f64>,
    /// Rows and columns together from the contact, up to the ring's; and what each height counts in its sum.
    steps: Vec<u8>,
    counts: Vec<f64>,
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
        let pressure = QuickPressure::new(rest, rows, cols, max_decay_mm)?;
        let per_noise = SHORTER.map(|share| {
            let weights = pressure.stencils().weights.iter();
            weights.map(|weights| 1.0 / sqrt(shorter_noise(weights, share))).collect()
        });
        let mut adaptive = Self { pressure, per_noise, ..Self::default() };
        let markers = rows * cols;
        let Self { bend, variance_mm2, evidence, candidate, seen_mm, steps, counts, regions, .. } =
            &mut adaptive;
        [bend, variance_mm2, evidence, seen_mm, counts].into_iter().for_each(|list| list.reserve(markers));
        candidate.reserve(markers);
        steps.reserve(markers);
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

        let variances = self.variance_mm2.iter().copied();
        self.pressure.run(indentation_mm, variances, state, &mut self.candidate)?;
        out.resize(indentation_mm.len(), false);
        self.keep_indented(indentation_mm);
        let decay_mm = self.pressure.decay_mm();
        if self.candidate.contains(&true) && self.law_holds(indentation_mm) {
            out.copy_from_slice(&self.candidate);
            return Ok(Some(ContactRule::Pressure { decay_mm }));
        }
        self.bend(indentation_mm);
        self.compare(ContactRule::Pressure { decay_mm }, &mut best, &mut rule, out);
        for (k, share) in SHORTER.into_iter().enumerate() {
            self.press(k, indentation_mm, state);
            self.keep_indented(indentation_mm);
            let decay_mm = share * decay_mm;
            self.compare(ContactRule::Pressure { decay_mm }, &mut best, &mut rule, out);
        }
        if rule.is_some() {
            self.try_shares(indentation_mm, state, &mut best, &mut rule, out);
        }
        Ok(rule)
    }

    /// Whether the pressures around the candidate are those of a free gel, by their sum.
    fn law_holds(&mut self, indentation_mm: &[f64]) -> bool {
        let Self { pressure, candidate, steps, counts, .. } = self;
        let lattice = pressure.stencils();
        steps.clear();
        steps.extend(candidate.iter().map(|&touches| if touches { 0 } else { u8::MAX }));
        for step in 0..RING.1 {
            for i in 0..steps.len() {
                if steps[i] > step && lattice.taps(i).skip(1).any(|(k, _)| steps[k] == step) {
                    steps[i] = step + 1;
                }
            }
        }
        counts.clear();
        counts.resize(steps.len(), 0.0);
        let (pressure_mm, valid) = pressure.measured();
        let (mut sum_mm, mut heights_mm) = (0.0, 0.0);
        for i in 0..steps.len() {
            if (RING.0..=RING.1).contains(&steps[i]) && valid[i] && lattice.is_inside(i, 1) {
                sum_mm += pressure_mm[i];
                heights_mm += indentation_mm[i].max(0.0);
                lattice.taps(i).for_each(|(k, weight)| counts[k] += weight);
            }
        }
        let sigma_mm = pressure.sigma_mm() * sqrt(counts.iter().map(|count| count * count).sum::<f64>());
        abs(sum_mm) <= LAW_MARGIN.0 * sigma_mm + LAW_MARGIN.1 * heights_mm
    }

    /// The candidate by pressure for the shorter decay length of this index: p = h - l² Δh is linear in l².
    fn press(&mut self, k: usize, indentation_mm: &[f64], state: &[MarkerState]) {
        let Self { pressure, per_noise, candidate, evidence, regions, .. } = self;
        let share2 = SHORTER[k] * SHORTER[k];
        let per_sigma = 1.0 / pressure.sigma_mm();
        let (pressure_mm, valid) = pressure.measured();
        let pressures = indentation_mm.iter().zip(pressure_mm).zip(valid).zip(&per_noise[k]);
        evidence.clear();
        evidence.extend(pressures.map(|(((&h, &longest), &valid), &per_noise)| {
            let sigmas = if valid { (h - share2 * (h - longest)) * per_sigma * per_noise } else { 0.0 };
            sigmas * abs(sigmas)
        }));
        candidate.clear();
        candidate.extend(evidence.iter().map(|&evidence| evidence > START * START));
        // Beside a marker that is not seen the others around tell.
        for i in (0..valid.len()).filter(|&i| !valid[i] && state[i] == MarkerState::Seen) {
            let around = pressure.stencils().taps(i).skip(1).filter(|&(k, _)| valid[k]);
            let (touch, count) =
                around.fold((0, 0), |(touch, count), (k, _)| (touch + u32::from(candidate[k]), count + 1));
            candidate[i] = 2 * touch > count;
        }
        regions.keep_sure(pressure.stencils(), evidence, state, candidate);
    }

    /// A gel that keeps its volume is concave too where it bulges beside the contact, but not indented there.
    fn keep_indented(&mut self, indentation_mm: &[f64]) {
        let heights = indentation_mm.iter().zip(&self.variance_mm2);
        for (touches, (&h, &variance)) in self.candidate.iter_mut().zip(heights) {
            *touches &= h * abs(h) > MIN_SIGMAS * MIN_SIGMAS * variance;
        }
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
                h * abs(h) / variance.max(MIN_SIGMA_MM * MIN_SIGMA_MM)
            } else {
                0.0
            }
        }));
        for step in SHARES.0..=SHARES.1 {
            let share = f64::from(step) * SHARE_STEP;
            let Self { candidate, evidence, regions, pressure, .. } = self;
            candidate.clear();
            let pairs = indentation_mm.iter().zip(evidence.iter());
            candidate.extend(
                pairs.map(|(&h, &evidence)| h > share * deepest_mm && evidence > MIN_SIGMAS * MIN_SIGMAS),
            );
            regions.keep_sure(pressure.stencils(), evidence, state, candidate);
            self.compare(ContactRule::Share { share }, best, rule, out);
        }
    }

    /// Takes the candidate over when it is the best so far.
    fn compare(&self, from: ContactRule, best: &mut f64, rule: &mut Option<ContactRule>, out: &mut [bool]) {
        let Some(score) = score(self.pressure.stencils().cols, &self.bend, &self.candidate) else { return };
        if score > *best {
            (*best, *rule) = (score, Some(from));
            out.copy_from_slice(&self.candidate);
        }
    }

    /// Curvatures from the pressures of the longest decay, p = h - l² Δh.
    fn bend(&mut self, indentation_mm: &[f64]) {
        let (pressure_mm, valid) = self.pressure.measured();
        let values = indentation_mm.iter().zip(pressure_mm).zip(valid);
        self.bend.clear();
        self.bend.extend(values.map(|((&h, &p), &valid)| {
            let curvature = if valid { h - p } else { 0.0 };
            if curvature < 0.0 { -sqrt(-curvature) } else { sqrt(curvature) }
        }));
    }
}

/// Variance of the pressure for heights of variance 1 with a decay length so much shorter than that of these
/// weights.
fn shorter_noise(weights: &[f64; 5], share: f64) -> f64 {
    let share2 = share * share;
    let [own, around @ ..] = weights;
    let own = 1.0 + share2 * (own - 1.0);
    own * own + share2 * share2 * around.iter().map(|weight| weight * weight).sum::<f64>()
}

/// How much the gel is concave in a candidate and convex in the ring around it, over the root of the count,
/// in which chance would grow; `None` for an empty candidate. `cols` markers make a row.
fn score(cols: usize, bend: &[f64], candidate: &[bool]) -> Option<f64> {
    let (mut sum, mut inside, mut around) = (0.0, 0_u32, 0_u32);
    for (row, bend) in bend.chunks_exact(cols).enumerate() {
        let of = |row: usize| &candidate[row * cols..(row + 1) * cols];
        let here = of(row);
        // A row beyond the border touches nothing; nor does this one beside markers that do not touch.
        let up = row.checked_sub(1).map_or(here, of);
        let down = if (row + 2) * cols > candidate.len() { here } else { of(row + 1) };
        for col in 0..cols {
            if here[col] {
                sum -= bend[col];
                inside += 1;
            } else if up[col] | down[col] || (col > 0 && here[col - 1]) || (col + 1 < cols && here[col + 1]) {
                sum += bend[col];
                around += 1;
            }
        }
    }
    (inside > 0).then(|| sum / sqrt(f64::from(inside + around)))
}
