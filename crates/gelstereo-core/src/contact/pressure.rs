//! Saliency by pressure: the gel rises beside a contact too, but carries pressure only in contact.
//!
//! Model: a Pasternak foundation (Pasternak 1954), p = h - l² Δh, where h is the indentation at the
//! marker's rest position (as in all linear elasticity) and p the pressure per stiffness, in mm. Beside
//! the contact p = 0 for every part.
//!
//! One stencil multiplies the noise of h by 1 + 8 l² / pitch², so a plain threshold on p fails. But at a
//! marker known to be free, p *is* noise, and neighbouring stencils share markers. The noise of p at a
//! marker is therefore predicted from the free markers around it (simple kriging) and subtracted. The
//! free markers are found by iterated conditional modes (Besag 1986) on a Markov random field that
//! couples neighbours. Far from contacts the precomputed weights of an untouched gel are used. Only
//! markers that these do not explain, and those around contacts, are predicted individually.

use super::kriging::{Covariances, Kriging, LANES, REACH, SIDE, WINDOW, Windows};
use super::rule::{self, MIN_SIGMA_MM, START};
use super::stencils::{Regions, Stencils};
use super::{ContactError, RestSurface};
use crate::math::sqrt;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Most label changes per marker: the windows make the energy approximate, so cycles are possible.
const MAX_CHANGES: u8 = 4;
/// Variance of an unmeasured height, mm²: effectively unknown, and still 10 digits above rounding errors.
const UNKNOWN_MM2: f64 = 100.0;

/// Finds the markers in contact from the pressure of the gel; scratch is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Pressure {
    stencils: Stencils,
    /// Filters of the pressures, valid far from contacts.
    filters: Vec<Filter>,
    /// Heights and their variances; 0 and effectively unknown for a marker that was not seen.
    height_mm: Vec<f64>,
    variance_mm2: Vec<f64>,
    pressure_mm: Vec<f64>,
    covariances: Covariances,
    /// Signed squared pressures in standard deviations.
    evidence: Vec<f64>,
    gain: Vec<f64>,
    stale: Vec<bool>,
    changes: Vec<u8>,
    regions: Regions,
}

/// A marker's pressure minus the noise predicted from its window, if all of it is free and measured
/// equally well. It only selects the markers to classify, so single precision suffices.
#[derive(Clone, Debug)]
struct Filter {
    /// Weights over the window; 0 outside the lattice.
    weights: [f32; WINDOW],
    /// Variance for heights of variance 1.
    variance: f32,
}

impl Pressure {
    /// For this rest surface of `rows * cols` markers, row by row, and this decay length of the gel
    /// beside a contact.
    ///
    /// # Errors
    /// [`ContactError::LengthMismatch`] when the rest surface does not have `rows * cols` markers,
    /// [`ContactError::Decay`] for an invalid length.
    pub fn new(rest: &RestSurface, rows: usize, cols: usize, decay_mm: f64) -> Result<Self, ContactError> {
        let stencils = Stencils::new(rest, rows, cols, decay_mm)?;
        let mut pressure = Self { stencils, ..Self::default() };
        pressure.make_filters();
        Ok(pressure)
    }

    /// Sets another decay length, such as one from [`DecayFit`](super::DecayFit). No allocation.
    ///
    /// # Errors
    /// [`ContactError::Decay`] for an invalid length; the previous one is then kept.
    pub fn set_decay(&mut self, decay_mm: f64) -> Result<(), ContactError> {
        self.stencils.set_decay(decay_mm)?;
        self.make_filters();
        Ok(())
    }

    fn make_filters(&mut self) {
        self.variance_mm2.clear();
        self.variance_mm2.resize(self.len(), 1.0);
        self.covariances.measure(self.stencils.cols, &self.stencils.weights, &self.variance_mm2);
        let mut filters = core::mem::take(&mut self.filters);
        filters.clear();
        filters.reserve_exact(self.len());
        let mut windows = Windows::new();
        while filters.len() < self.len() {
            let i = filters.len();
            // If both ends are inside and in one row, so are all markers between.
            let last = i + LANES - 1;
            let inside = |i: usize| i < self.len() && self.stencils.is_inside(i, REACH);
            if inside(i) && inside(last) && i / self.stencils.cols == last / self.stencils.cols {
                filters.extend(self.filters_from(i, &mut windows));
            } else {
                filters.push(self.filter(i));
            }
        }
        self.filters = filters;
    }

    /// Filters of a marker and those right of it.
    fn filters_from(&self, i: usize, windows: &mut Windows) -> [Filter; LANES] {
        let mut weights = [[0.0_f32; WINDOW]; LANES];
        weights.iter_mut().for_each(|weights| weights[WINDOW / 2] = 1.0);
        let variance = windows.weights(&self.covariances, i, |slot, found| {
            weights.iter_mut().zip(found).for_each(|(weights, weight)| weights[slot] = -weight as f32);
        });
        core::array::from_fn(|lane| Filter { weights: weights[lane], variance: variance[lane] as f32 })
    }

    fn filter(&self, i: usize) -> Filter {
        let mut weights = [0.0_f32; WINDOW];
        weights[WINDOW / 2] = 1.0;
        let mut kriging = Kriging::new(&self.covariances, i, self.window(i, REACH), |_| true);
        let variance = kriging.weights(|j, weight| weights[self.slot(i, j)] = -weight as f32) as f32;
        Filter { weights, variance }
    }

    /// Finds the markers in contact from the indentations and their variances (mm²). Markers that are not
    /// seen are never salient, and their heights count as unknown. `out` is cleared first; no allocation
    /// once it has held this many.
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
        self.variance_mm2.clear();
        self.variance_mm2.extend(variance_mm2);
        self.check(indentation_mm, state)?;
        for (variance, &state) in self.variance_mm2.iter_mut().zip(state) {
            let least = MIN_SIGMA_MM * MIN_SIGMA_MM;
            *variance = if state == MarkerState::Seen { variance.max(least) } else { UNKNOWN_MM2 };
        }
        self.height_mm.clear();
        let seen = |(&h, &state)| if state == MarkerState::Seen { h } else { 0.0 };
        self.height_mm.extend(indentation_mm.iter().zip(state).map(seen));
        self.measure();
        out.extend((0..self.len()).map(|i| self.pressure_mm[i] > START * sqrt(self.covariances.variance(i))));
        self.choose(out);
        self.settle(out);
        let Self { regions, stencils, evidence, .. } = self;
        regions.keep_sure(stencils, evidence, state, out);
        Ok(())
    }

    /// Pressure of every marker by its own stencil, mm, in the last frame; noisy, see the module.
    #[must_use]
    pub fn pressure_mm(&self) -> &[f64] {
        &self.pressure_mm
    }

    /// The decay length in use.
    #[must_use]
    pub const fn decay_mm(&self) -> f64 {
        self.stencils.decay_mm
    }

    /// Variances of the heights of the last run, mm²; effectively unknown for a marker that was not seen.
    pub(super) fn variance_mm2(&self) -> &[f64] {
        &self.variance_mm2
    }

    fn len(&self) -> usize {
        self.stencils.weights.len()
    }

    fn check(&self, indentation_mm: &[f64], state: &[MarkerState]) -> Result<(), ContactError> {
        for found in [indentation_mm.len(), self.variance_mm2.len(), state.len()] {
            if found != self.len() {
                return Err(ContactError::LengthMismatch { rest: self.len(), found });
            }
        }
        let values = indentation_mm.iter().zip(&self.variance_mm2).zip(state);
        let bad = |((h, v), &s): ((&f64, &f64), _)| {
            s == MarkerState::Seen && !(h.is_finite() && v.is_finite() && *v >= 0.0)
        };
        match values.into_iter().position(bad) {
            Some(index) => Err(ContactError::NotFinite { index }),
            None => Ok(()),
        }
    }

    /// Marker, left, right, upper and lower neighbour of a stencil, with their weights.
    pub(super) fn taps(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        self.stencils.taps(i)
    }

    /// Computes pressures and the covariances of their noise.
    fn measure(&mut self) {
        let Self { stencils, height_mm, pressure_mm, .. } = self;
        let pressure = |i| stencils.taps(i).map(|(k, w)| w * height_mm[k]).sum::<f64>();
        pressure_mm.clear();
        pressure_mm.extend((0..height_mm.len()).map(pressure));
        self.covariances.measure(self.stencils.cols, &self.stencils.weights, &self.variance_mm2);
    }

    /// Index of marker `j` in the window around marker `i`.
    fn slot(&self, i: usize, j: usize) -> usize {
        let cols = self.stencils.cols;
        (j / cols + REACH - i / cols) * SIDE + j % cols + REACH - i % cols
    }

    /// Markers of the window around a marker.
    pub(super) fn window(&self, i: usize, reach: usize) -> impl Iterator<Item = usize> + use<> {
        self.stencils.window(i, reach)
    }

    /// Marks the markers to classify: those near a contact, and far from contacts those that the filter
    /// does not explain.
    fn choose(&mut self, contact: &[bool]) {
        self.stale.clear();
        self.stale.resize(contact.len(), false);
        for i in (0..contact.len()).filter(|&i| contact[i]) {
            self.window(i, REACH).for_each(|j| self.stale[j] = true);
        }
        for i in 0..contact.len() {
            self.stale[i] = self.stale[i] || self.stands_out(i);
        }
    }

    /// Whether the pressure is significant after prediction from its neighbours, all taken as free.
    fn stands_out(&self, i: usize) -> bool {
        let filter = &self.filters[i];
        let cols = self.stencils.cols;
        let value: f64 = if self.stencils.is_inside(i, REACH) {
            let start = i - REACH * cols - REACH;
            let rows = filter.weights.chunks_exact(SIDE).enumerate();
            let row = |(r, weights): (usize, &[f32])| {
                let values = &self.pressure_mm[start + r * cols..][..SIDE];
                weights.iter().zip(values).map(|(&w, p)| f64::from(w) * p).sum::<f64>()
            };
            rows.map(row).sum()
        } else {
            self.window(i, REACH)
                .map(|j| f64::from(filter.weights[self.slot(i, j)]) * self.pressure_mm[j])
                .sum()
        };
        let variance_mm2 = f64::from(filter.variance) * self.variance_mm2[i];
        rule::stands_out(value, variance_mm2)
    }

    /// Changes labels until none gains. Each round changes those with the largest gain within their
    /// windows, so that no order of the markers is preferred.
    fn settle(&mut self, contact: &mut [bool]) {
        for list in [&mut self.evidence, &mut self.gain] {
            list.clear();
            list.resize(contact.len(), 0.0);
        }
        self.changes.clear();
        self.changes.resize(contact.len(), 0);
        loop {
            for i in 0..contact.len() {
                if self.stale[i] {
                    self.judge(i, contact);
                    self.stale[i] = false;
                }
            }
            let mut changed = false;
            for i in 0..contact.len() {
                let gain = self.gain[i];
                // The first of equal gains.
                let best = |j| gain > self.gain[j] || (gain == self.gain[j] && i <= j);
                if gain > 0.0 && self.window(i, REACH).all(best) {
                    contact[i] = !contact[i];
                    self.changes[i] += 1;
                    self.window(i, REACH).for_each(|j| self.stale[j] = true);
                    changed = true;
                }
            }
            if !changed {
                return;
            }
        }
    }

    /// Computes the decrease of the energy when this marker's label changes.
    fn judge(&mut self, i: usize, contact: &[bool]) {
        let mut kriging = Kriging::new(&self.covariances, i, self.window(i, REACH), |j| !contact[j]);
        let (pressure, variance) = kriging.predict(i, &self.pressure_mm);
        let variance = variance.max(1e-9 * self.covariances.variance(i));
        let neighbours = self.stencils.taps(i).skip(1).map(|(j, _)| contact[j]);
        let gain = rule::gain(pressure, self.height_mm[i], variance, neighbours);
        self.evidence[i] = rule::evidence(pressure, variance);
        let gain = if contact[i] { -gain } else { gain };
        self.gain[i] = if self.changes[i] < MAX_CHANGES { gain } else { 0.0 };
    }
}
