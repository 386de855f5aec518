//! Saliency by pressure: the gel rises beside a contact too, but carries pressure only in contact.
//!
//! Model: a Pasternak foundation (Pasternak 1954), p = h - l² Δh, where h is the indentation at the
//! marker's rest position (as in all linear elasticity) and p the pressure per stiffness, in mm. Beside
//! the contact p = 0 for every part.
//!
//! One stencil multiplies the noise of h by 1 + 8 l² / pitch², so a plain threshold on p fails. But at a
//! marker known to be free, p *is* noise, and neighbouring stencils share markers. The noise of p at a
//! marker is therefore predicted from the free ones among the markers around it whose stencils share a
//! height with its own (simple kriging), and subtracted: twelve in a square print, eighteen in a hexagonal
//! one. Labels of a Markov random field that couples neighbours are updated simultaneously, in a few rounds,
//! where the pressure alone does not decide. Far from contacts the weights of a regular lattice select the
//! markers to classify.

use super::covariances::Prediction;
use super::rule::{self, MIN_SIGMA_MM, START};
use super::stencils::{Regions, Stencils};
use super::{ContactError, RestSurface};
use crate::lattice::Topology;
use crate::math::{abs, sqrt};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Most rounds of label updates; two or three are typical.
const ROUNDS: usize = 6;
/// Pressures, in standard deviations, between which a label is judged. Above them it is contact, as the
/// predictable noise is seldom more than half of that; below them it is free.
const UNCERTAIN: core::ops::Range<f64> = -1.0..6.0;

/// Finds the markers in contact from the pressure of the gel; scratch is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Pressure {
    stencils: Stencils,
    /// Whether the noise of a marker's pressure is predicted from those around it: if it has neighbours on
    /// both sides along every axis.
    inner: Vec<bool>,
    prediction: Prediction,
    /// Variances of the heights; the least one for a marker that was not seen.
    variance_mm2: Vec<f64>,
    pressure_mm: Vec<f64>,
    noise_mm2: Vec<f64>,
    /// Whether all heights behind a pressure were seen.
    valid: Vec<bool>,
    /// Pressures divided by their standard deviations; then the evidence of contact, such a score squared
    /// with its sign.
    evidence: Vec<f64>,
    asked: Vec<bool>,
    next: Vec<bool>,
    regions: Regions,
}

impl Pressure {
    /// For this rest surface of `rows * cols` markers, row by row, and this decay length of the gel
    /// beside a contact.
    ///
    /// # Errors
    /// [`ContactError::LengthMismatch`] when the rest surface does not have `rows * cols` markers,
    /// [`ContactError::Decay`] for an invalid length.
    pub fn new(rest: &RestSurface, rows: usize, cols: usize, decay_mm: f64) -> Result<Self, ContactError> {
        Self::on(rest, Topology::square(rows, cols), decay_mm)
    }

    /// As [`Self::new`], for a print of any topology.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn on(rest: &RestSurface, topology: Topology, decay_mm: f64) -> Result<Self, ContactError> {
        let stencils = Stencils::new(rest, topology, decay_mm)?;
        let inner = (0..rest.points_mm().len()).map(|i| stencils.is_inner(i)).collect();
        let prediction = Prediction::new(topology.is_hexagonal());
        let mut pressure = Self { inner, stencils, prediction, ..Self::default() };
        pressure.set_even();
        pressure.reserve(rest.points_mm().len());
        Ok(pressure)
    }

    /// Sets another decay length, such as one from [`DecayFit`](super::DecayFit). No allocation.
    ///
    /// # Errors
    /// [`ContactError::Decay`] for an invalid length; the previous one is then kept.
    pub fn set_decay(&mut self, decay_mm: f64) -> Result<(), ContactError> {
        self.stencils.set_decay(decay_mm)?;
        self.set_even();
        Ok(())
    }

    /// Predicts far from contacts as in a regular lattice with the mean weights of this one.
    fn set_even(&mut self) {
        let mean = |axis: usize| {
            let inner = (0..self.inner.len()).filter(|&i| self.inner[i]);
            let pairs = inner.map(|i| [1, 2].map(|side| self.stencils.weight(i, 2 * axis + side)));
            let (sum, count) =
                pairs.fold((0.0, 0.0), |(sum, count), [before, after]| (sum + before + after, count + 2.0));
            sum / f64::max(count, 1.0)
        };
        let is_hexagonal = self.stencils.topology.is_hexagonal();
        self.prediction.set_even([mean(0), mean(1), if is_hexagonal { mean(2) } else { 0.0 }]);
    }

    /// The decay length in use.
    #[must_use]
    pub const fn decay_mm(&self) -> f64 {
        self.stencils.decay_mm
    }

    pub(super) const fn stencils(&self) -> &Stencils {
        &self.stencils
    }

    /// Variances of the heights of the last run, mm²; meaningless for a marker that was not seen.
    pub(super) fn variance_mm2(&self) -> &[f64] {
        &self.variance_mm2
    }

    /// Pressure of every marker by its own stencil in the last run, mm, with many times the noise of its
    /// height; 0 where a height is missing.
    #[must_use]
    pub fn pressure_mm(&self) -> &[f64] {
        &self.pressure_mm
    }

    /// Variances of the pressures of the last run, mm².
    pub(super) fn noise_mm2(&self) -> &[f64] {
        &self.noise_mm2
    }

    /// Pressures of the last run, and whether all heights behind each were seen.
    pub(super) fn measured(&self) -> (&[f64], &[bool]) {
        (&self.pressure_mm, &self.valid)
    }

    /// Reserves all memory: the first contact may come late.
    fn reserve(&mut self, markers: usize) {
        let Self { variance_mm2, pressure_mm, noise_mm2, evidence, .. } = self;
        [variance_mm2, pressure_mm, noise_mm2, evidence].into_iter().for_each(|list| list.reserve(markers));
        let Self { prediction, valid, asked, next, regions, .. } = self;
        prediction.reserve(markers);
        [valid, asked, next].into_iter().for_each(|list| list.reserve(markers));
        regions.reserve(markers);
    }

    /// Finds the markers in contact from the indentations and their variances (mm²). Markers that are not
    /// seen are never salient; those beside them are classified by their neighbours. `out` is cleared
    /// first; no allocation once it has held this many.
    ///
    /// # Errors
    /// [`ContactError::LengthMismatch`] when a list does not have `rows * cols` entries,
    /// [`ContactError::NotFinite`] for a seen marker whose indentation or variance is NaN, infinite or
    /// negative; `out` is then empty.
    pub fn run(
        &mut self,
        indentation_mm: &[f64],
        variance_mm2: impl Iterator<Item = f64>,
        state: &[MarkerState],
        out: &mut Vec<bool>,
    ) -> Result<(), ContactError> {
        out.clear();
        self.check(indentation_mm, variance_mm2, state)?;
        self.measure(indentation_mm, state);
        out.extend(self.evidence.iter().map(|&score| score > START));
        if !self.begin(out) {
            return Ok(());
        }
        self.prediction.measure(&self.stencils, &self.variance_mm2);
        self.next.clear();
        self.next.extend_from_slice(out);
        self.evidence.iter_mut().for_each(|score| *score *= abs(*score));
        for _ in 0..ROUNDS {
            for i in 0..out.len() {
                if self.asked[i] && UNCERTAIN.contains(&self.score(i)) {
                    self.next[i] = self.judge(i, indentation_mm[i], out);
                }
            }
            if !self.take_over(out) {
                break;
            }
        }
        let Self { stencils, regions, evidence, .. } = self;
        regions.keep_sure(stencils, evidence, state, out);
        Ok(())
    }

    /// Checks the input, and keeps the variances.
    fn check(
        &mut self,
        indentation_mm: &[f64],
        variance_mm2: impl Iterator<Item = f64>,
        state: &[MarkerState],
    ) -> Result<(), ContactError> {
        let rest = self.inner.len();
        self.variance_mm2.clear();
        self.variance_mm2.extend(variance_mm2);
        for found in [indentation_mm.len(), self.variance_mm2.len(), state.len()] {
            if found != rest {
                return Err(ContactError::LengthMismatch { rest, found });
            }
        }
        let min_mm2 = MIN_SIGMA_MM * MIN_SIGMA_MM;
        for (index, variance) in self.variance_mm2.iter_mut().enumerate() {
            if state[index] != MarkerState::Seen {
                *variance = min_mm2;
            } else if indentation_mm[index].is_finite() && variance.is_finite() && *variance >= 0.0 {
                *variance = variance.max(min_mm2);
            } else {
                return Err(ContactError::NotFinite { index });
            }
        }
        Ok(())
    }

    /// Pressures and their scores; 0 where a height is missing.
    fn measure(&mut self, indentation_mm: &[f64], state: &[MarkerState]) {
        let Self { stencils, variance_mm2, pressure_mm, noise_mm2, valid, evidence, .. } = self;
        [&mut *pressure_mm, &mut *noise_mm2, &mut *evidence].into_iter().for_each(Vec::clear);
        valid.clear();
        for i in 0..variance_mm2.len() {
            let (mut pressure, mut noise, mut seen) = (0.0, 0.0, true);
            for (k, weight) in stencils.taps(i) {
                pressure += weight * indentation_mm[k];
                noise += weight * weight * variance_mm2[k];
                seen &= state[k] == MarkerState::Seen;
            }
            let pressure = if seen { pressure } else { 0.0 };
            pressure_mm.push(pressure);
            noise_mm2.push(noise);
            evidence.push(pressure / sqrt(noise));
            valid.push(seen);
        }
    }

    fn score(&self, i: usize) -> f64 {
        self.pressure_mm[i] / sqrt(self.noise_mm2[i])
    }

    /// Selects the markers on both sides of a contact's rim, and those that free neighbours do not
    /// explain; returns whether there are any.
    fn begin(&mut self, contact: &[bool]) -> bool {
        self.asked.clear();
        self.asked.resize(contact.len(), false);
        let mut any = false;
        for i in 0..contact.len() {
            if contact[i] {
                any = true;
                for (k, _) in self.stencils.taps(i).filter(|&(k, _)| !contact[k]) {
                    (self.asked[i], self.asked[k]) = (true, true);
                }
            } else if self.pressure_mm[i] > 0.0 && self.stands_out(i) {
                any = true;
                self.asked[i] = true;
            }
        }
        any
    }

    /// Whether the pressure is significant after prediction from its neighbours, all taken as free.
    fn stands_out(&self, i: usize) -> bool {
        let (mut left_mm, mut variance_mm2) = (self.pressure_mm[i], self.noise_mm2[i]);
        if self.stencils.is_inside(i, 3) {
            let share;
            (left_mm, share) = self.prediction.left_over(&self.stencils, i, &self.pressure_mm);
            variance_mm2 *= share;
        }
        rule::stands_out(left_mm, variance_mm2)
    }

    /// Whether a marker is in contact, given the labels of the others.
    fn judge(&mut self, i: usize, height_mm: f64, contact: &[bool]) -> bool {
        let (mut pressure_mm, mut variance_mm2) = (self.pressure_mm[i], self.noise_mm2[i]);
        if self.inner[i] {
            let is_free = |k: usize| !contact[k] && self.inner[k] && self.valid[k];
            let predicted;
            (predicted, variance_mm2) =
                self.prediction.predict(&self.stencils, i, is_free, &self.pressure_mm);
            pressure_mm -= predicted;
        }
        // Where a height is missing, the neighbours alone decide.
        let (pressure_mm, height_mm) = if self.valid[i] { (pressure_mm, height_mm) } else { (0.0, 0.0) };
        self.evidence[i] = rule::evidence(pressure_mm, variance_mm2);
        let neighbours = self.stencils.taps(i).skip(1).map(|(k, _)| contact[k]);
        rule::gain(pressure_mm, height_mm, variance_mm2, neighbours) > 0.0
    }

    /// Applies the changed labels and selects them and their neighbours again; returns whether there are
    /// any.
    fn take_over(&mut self, contact: &mut [bool]) -> bool {
        self.asked.fill(false);
        let mut changed = false;
        for i in 0..contact.len() {
            if self.next[i] != contact[i] {
                changed = true;
                contact[i] = self.next[i];
                for (k, _) in self.stencils.taps(i) {
                    self.asked[k] = true;
                }
            }
        }
        changed
    }
}
