//! Saliency for a gel with unknown law: pressure where its law holds, otherwise the best of several
//! candidate rules by the curvature of the gel.
//!
//! Where the law p = h - l² Δh holds, the pressure beside a contact is zero, so the pressures in a ring
//! around it sum to noise. Most of the noise of the second differences cancels in that sum. A sum below
//! noise indicates a gel that returns to rest over a shorter length or by another law.
//!
//! A rigid part presses its own convex surface into the gel, so the gel is concave under it, -Δh > 0.
//! Beside the contact the gel returns to rest and is convex, Δh > 0. This holds for a foundation with
//! tension, for an elastic layer and for a gel without any shoulder. So the border of the contact is
//! where the curvature changes its sign, like an edge in an image (Marr and Hildreth 1980). A single
//! second difference is too noisy for a rule of its own, but the sum over a contact and its ring is not.
//! It selects among a few candidates: the markers in contact by [`Pressure`] for the longest decay
//! length, those with significant pressure for shorter ones, and those indented by more than a share of
//! the deepest indentation. For an elastic half-space under a ball the share is a half (Hertz 1882); in
//! thin layers it is less.
//!
//! Where a smooth part lifts the gel gradually, the last markers in contact are hardly concave, and this
//! choice is up to a marker too small. It is replaced by the largest share that scores nearly as well and
//! whose heights are those of a smooth part ([`smooth`]).

use super::pressure::Pressure;
use super::rule::{self, MIN_SIGMA_MM, START};
use super::smooth;
use super::stencils::Regions;
use super::{ContactError, RestSurface};
use crate::lattice::Topology;
use crate::math::{abs, sqrt};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Decay lengths tried in addition to the given one, as shares of it. With 2.5 mm they are 1.6 to 0.5 mm.
/// Their pressures are hardly noisier than the heights, so a threshold suffices: iterating the labels as
/// in [`Pressure`] costs four times as much as everything else here, and gains up to 0.009 of F1 on
/// the development half of the finite-element contacts with 5 um of noise, 0.006 with 10 um.
const SHORTER: [f64; 4] = [0.64, 0.4, 0.28, 0.2];
/// Smallest and largest share of the deepest indentation tried, in steps. On the development half of the
/// finite-element contacts, 3 to 11 steps are chosen.
const SHARES: (u32, u32) = (1, 12);
/// Step of the shares.
const SHARE_STEP: f64 = 0.05;
/// Share of the best score that a larger candidate must have. With 0.8, 0.85, 0.9 and 0.95 the mean F1 over
/// five laws (gels a and c of the development half, and 168 made contacts of three laws) is 0.907, 0.903,
/// 0.899 and 0.891, and without this step 0.881. On balls that the gel leaves at half their depth with
/// nearly the same slope it is 0.857, 0.869, 0.889 and 0.923, and 0.941 without it.
const NEARLY: f64 = 0.9;
/// Deviation of a smooth part from a quadratic polynomial, as a share of the deepest indentation, and the
/// largest mean square in these and the noise's variances. With 0.005, 0.01 and 0.02 the mean F1 is 0.896,
/// 0.899 and 0.901. With 1.5, 2 and 3 (and a share of the score of 0.8) it is 0.906, 0.907 and 0.910.
const SMOOTH: (f64, f64) = (0.01, 2.0);
/// Standard deviations that the indentation of a marker in contact must exceed.
const MIN_SIGMAS: f64 = 3.0;

/// City-block distance of a contact to the nearest and farthest markers of its ring. Stencils of the
/// adjacent markers share heights with the contact's rim.
const RING: (u8, u8) = (2, 3);
/// Largest deviation from zero of the sum of the ring's pressures: in standard deviations of the sum,
/// plus a share of the heights there, since the five-point stencil has a relative error of (pitch / l)² /
/// 12, 0.01. Tried: 3 and 5, with 0.05, 0.1 and 0.2. Where the law holds, in simulated presses with 5 and
/// 10 um of noise, all of them give the F1 of pressure; on the development half of the finite-element
/// contacts 5 costs up to 0.04.
const LAW_MARGIN: (f64, f64) = (3.0, 0.1);

/// Rule by which the markers in contact were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ContactRule {
    /// The gel carries pressure there, given this decay length.
    Pressure {
        /// The decay length.
        decay_mm: f64,
    },
    /// The indentation exceeds this share of the deepest one.
    Share {
        /// The share, 0 to 1.
        share: f64,
    },
}

/// Finds the markers in contact for a gel with unknown law; scratch is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct AdaptiveSaliency {
    pressure: Pressure,
    /// Signed square root of every marker's curvature, which limits the influence of single markers; 0
    /// where a height is missing.
    bend: Vec<f64>,
    variance_mm2: Vec<f64>,
    evidence: Vec<f64>,
    candidate: Vec<bool>,
    seen_mm: Vec<f64>,
    /// City-block distance from the contact, up to the ring's, and the weight of each height in the
    /// ring's sum.
    steps: Vec<u8>,
    counts: Vec<f64>,
    regions: Regions,
}

impl AdaptiveSaliency {
    /// For this rest surface of `rows * cols` markers, row by row. `max_decay_mm` is the longest decay
    /// length tried.
    ///
    /// # Errors
    /// As [`Pressure::new`].
    pub fn new(
        rest: &RestSurface,
        rows: usize,
        cols: usize,
        max_decay_mm: f64,
    ) -> Result<Self, ContactError> {
        Self::on(rest, Topology::square(rows, cols), max_decay_mm)
    }

    /// As [`Self::new`], for a print of any topology.
    ///
    /// # Errors
    /// As [`Pressure::new`].
    pub fn on(rest: &RestSurface, topology: Topology, max_decay_mm: f64) -> Result<Self, ContactError> {
        let pressure = Pressure::on(rest, topology, max_decay_mm)?;
        let mut adaptive = Self { pressure, ..Self::default() };
        let markers = topology.places();
        let Self { bend, variance_mm2, evidence, candidate, seen_mm, steps, counts, regions, .. } =
            &mut adaptive;
        [bend, variance_mm2, evidence, seen_mm, counts].into_iter().for_each(|list| list.reserve(markers));
        candidate.reserve(markers);
        steps.reserve(markers);
        regions.reserve(markers);
        Ok(adaptive)
    }

    /// Finds the markers in contact from the indentations and their variances (mm²). Returns the rule
    /// that found them, or `None` without contact. Markers that are not seen are never salient. `out` is
    /// cleared first; no allocation once it has held this many.
    ///
    /// # Errors
    /// As [`Pressure::run`]; `out` is then empty.
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

    /// Whether the pressures around the candidate sum to zero as in a free gel.
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
        let variances =
            counts.iter().zip(pressure.variance_mm2()).map(|(count, variance)| count * count * variance);
        abs(sum_mm) <= LAW_MARGIN.0 * sqrt(variances.sum::<f64>()) + LAW_MARGIN.1 * heights_mm
    }

    /// Candidate by pressure for the shorter decay length of this index: p = h - l² Δh is linear in l².
    fn press(&mut self, k: usize, indentation_mm: &[f64], state: &[MarkerState]) {
        let Self { pressure, candidate, evidence, regions, .. } = self;
        let share2 = SHORTER[k] * SHORTER[k];
        let (pressure_mm, valid) = pressure.measured();
        evidence.clear();
        evidence.extend(indentation_mm.iter().enumerate().map(|(i, &h)| {
            if !valid[i] {
                return 0.0;
            }
            // Its own height and those around it are independent.
            let (own, variance_mm2) = (pressure.stencils().weights[i][0], pressure.variance_mm2()[i]);
            let around_mm2 = pressure.noise_mm2()[i] - own * own * variance_mm2;
            let own = 1.0 + share2 * (own - 1.0);
            let noise_mm2 = own * own * variance_mm2 + share2 * share2 * around_mm2;
            rule::evidence(h - share2 * (h - pressure_mm[i]), noise_mm2)
        }));
        candidate.clear();
        candidate.extend(evidence.iter().map(|&evidence| evidence > START * START));
        // Beside a marker that is not seen, the majority of its neighbours decides.
        for i in (0..valid.len()).filter(|&i| !valid[i] && state[i] == MarkerState::Seen) {
            let around = pressure.stencils().taps(i).skip(1).filter(|&(k, _)| valid[k]);
            let (touch, count) =
                around.fold((0, 0), |(touch, count), (k, _)| (touch + u32::from(candidate[k]), count + 1));
            candidate[i] = 2 * touch > count;
        }
        regions.keep_sure(pressure.stencils(), evidence, state, candidate);
    }

    /// Removes markers that are not indented: an incompressible gel is also concave where it bulges
    /// beside the contact.
    fn keep_indented(&mut self, indentation_mm: &[f64]) {
        let heights = indentation_mm.iter().zip(&self.variance_mm2);
        for (touches, (&h, &variance)) in self.candidate.iter_mut().zip(heights) {
            *touches &= h * abs(h) > MIN_SIGMAS * MIN_SIGMAS * variance;
        }
    }

    /// Candidates by shares of the deepest indentation. The second deepest is used, as a single marker
    /// may be wrong.
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
            let share = self.take_share(step, deepest_mm, indentation_mm, state);
            self.compare(ContactRule::Share { share }, best, rule, out);
        }
        self.widen(indentation_mm, state, deepest_mm, *best, rule, out);
    }

    /// Replaces the candidate with the best score by the largest share that scores nearly as well and is that
    /// of a smooth part. The evidence is that of the heights.
    fn widen(
        &mut self,
        indentation_mm: &[f64],
        state: &[MarkerState],
        deepest_mm: f64,
        best: f64,
        rule: &mut Option<ContactRule>,
        out: &mut [bool],
    ) {
        let count = |all: &[bool]| all.iter().filter(|touches| **touches).count();
        let found = count(out);
        let model_mm2 = SMOOTH.0 * SMOOTH.0 * deepest_mm * deepest_mm;
        for step in SHARES.0..=SHARES.1 {
            let share = self.take_share(step, deepest_mm, indentation_mm, state);
            if count(&self.candidate) <= found {
                return;
            }
            if self.score().is_none_or(|score| score < NEARLY * best) {
                continue;
            }
            let topology = self.pressure.stencils().topology;
            let variance_mm2 = |i: usize| self.variance_mm2[i].max(MIN_SIGMA_MM * MIN_SIGMA_MM) + model_mm2;
            let square = smooth::mean_square(topology, indentation_mm, &self.candidate, variance_mm2);
            if square.is_some_and(|square| square < SMOOTH.1) {
                *rule = Some(ContactRule::Share { share });
                out.copy_from_slice(&self.candidate);
                return;
            }
        }
    }

    /// Candidate by a step of the shares, from the evidence of the heights. Returns the share.
    fn take_share(
        &mut self,
        step: u32,
        deepest_mm: f64,
        indentation_mm: &[f64],
        state: &[MarkerState],
    ) -> f64 {
        let share = f64::from(step) * SHARE_STEP;
        let Self { candidate, evidence, regions, pressure, .. } = self;
        candidate.clear();
        let pairs = indentation_mm.iter().zip(evidence.iter());
        candidate.extend(
            pairs.map(|(&h, &evidence)| h > share * deepest_mm && evidence > MIN_SIGMAS * MIN_SIGMAS),
        );
        regions.keep_sure(pressure.stencils(), evidence, state, candidate);
        share
    }

    /// Keeps the candidate if it is the best so far.
    fn compare(&self, from: ContactRule, best: &mut f64, rule: &mut Option<ContactRule>, out: &mut [bool]) {
        let Some(score) = self.score() else { return };
        if score > *best {
            (*best, *rule) = (score, Some(from));
            out.copy_from_slice(&self.candidate);
        }
    }

    fn score(&self) -> Option<f64> {
        let topology = self.pressure.stencils().topology;
        if topology.is_hexagonal() {
            score_around(topology, &self.bend, &self.candidate)
        } else {
            score(topology.cols(), &self.bend, &self.candidate)
        }
    }

    /// Curvatures from the pressures of the longest decay length, p = h - l² Δh.
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

/// Concavity of the gel in a candidate plus convexity in the ring around it, divided by the root of the
/// count, with which chance grows. `None` for an empty candidate. Rows have `cols` markers.
fn score(cols: usize, bend: &[f64], candidate: &[bool]) -> Option<f64> {
    let (mut sum, mut inside, mut around) = (0.0, 0_u32, 0_u32);
    for (row, bend) in bend.chunks_exact(cols).enumerate() {
        let of = |row: usize| &candidate[row * cols..(row + 1) * cols];
        let here = of(row);
        // Rows beyond the border are replaced by the present one, which adds no neighbour in contact.
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

/// As [`score`], for a print of any topology.
fn score_around(topology: Topology, bend: &[f64], candidate: &[bool]) -> Option<f64> {
    let (mut sum, mut inside, mut around) = (0.0, 0_u32, 0_u32);
    for (i, &bend) in bend.iter().enumerate() {
        if candidate[i] {
            sum -= bend;
            inside += 1;
        } else if topology.neighbours(i).any(|k| candidate[k]) {
            sum += bend;
            around += 1;
        }
    }
    (inside > 0).then(|| sum / sqrt(f64::from(inside + around)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use proptest::prelude::*;

    const SIDE: usize = 7;
    const MARKERS: usize = SIDE * SIDE;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Evidence by a shorter decay length is that of the law with that length, noise included.
        #[test]
        fn a_shorter_length_has_its_own_evidence(
            heights_mm in prop::collection::vec(-0.1..0.8_f64, MARKERS),
            variances_mm2 in prop::collection::vec(1e-6..1e-3_f64, MARKERS), k in 0..SHORTER.len(),
        ) {
            let at = |i: usize| DVec3::new(0.9 * (i % SIDE) as f64, 0.9 * (i / SIDE) as f64, 30.0);
            let rest = RestSurface::new(&(0..MARKERS).map(at).collect::<Vec<_>>()).unwrap();
            let (state, mut out) = ([MarkerState::Seen; MARKERS], Vec::new());
            let mut adaptive = AdaptiveSaliency::new(&rest, SIDE, SIDE, 2.5).unwrap();
            let variances = || variances_mm2.iter().copied();
            adaptive.run(&heights_mm, variances(), &state, &mut out).unwrap();
            adaptive.press(k, &heights_mm, &state);
            let mut shorter = Pressure::new(&rest, SIDE, SIDE, 2.5 * SHORTER[k]).unwrap();
            shorter.run(&heights_mm, variances(), &state, &mut out).unwrap();
            let laws = shorter.measured().0.iter().zip(shorter.noise_mm2());
            for (found, (&pressure_mm, &noise_mm2)) in adaptive.evidence.iter().zip(laws) {
                let expected = rule::evidence(pressure_mm, noise_mm2);
                prop_assert!(abs(found - expected) <= 1e-9 * (1.0 + abs(expected)), "{found} {expected}");
            }
        }
    }
}
