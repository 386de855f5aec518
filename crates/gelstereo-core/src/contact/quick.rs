//! Saliency by pressure from fewer neighbours: an approximation of [`Pressure`](super::Pressure).
//!
//! Law and rule are the same: p = h - l² Δh is noise where the gel is free, and a marker is in contact
//! where its pressure, minus the noise predicted from the free markers around it, exceeds a threshold.
//! The approximations: all heights are equally noisy, the lattice is regular, and only the twelve markers
//! whose stencils share a height with the centre one predict its noise. Labels are updated
//! simultaneously, in a few rounds, where the pressure alone does not decide.

use super::rule::{self, MIN_SIGMA_MM, START};
use super::stencils::{Regions, Stencils};
use super::{ContactError, RestSurface};
use crate::math::{abs, sqrt};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Markers whose stencils share a height with the centre one: rows down, columns across.
const AROUND: [(isize, isize); 12] =
    [(-2, 0), (-1, -1), (-1, 0), (-1, 1), (0, -2), (0, -1), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];
/// Most rounds of label updates; two or three are typical.
const ROUNDS: usize = 6;
/// Pressures, in standard deviations, beyond which a label is fixed. Above the first it is contact, as
/// the predictable noise is seldom more than half of that; below the second it is free.
const CERTAIN: (f64, f64) = (6.0, -1.0);

/// Finds the markers in contact from the pressure of the gel, quickly; scratch is kept from frame to
/// frame.
#[derive(Clone, Debug, Default)]
pub struct QuickPressure {
    stencils: Stencils,
    /// Variance of every pressure for heights of variance 1.
    noise: Vec<f64>,
    /// Whether a marker and its four neighbours lie inside the lattice.
    inner: Vec<bool>,
    even: Even,
    pressure_mm: Vec<f64>,
    valid: Vec<bool>,
    /// Root mean square of the heights' standard deviations in the last run.
    sigma_mm: f64,
    /// Pressures divided by their standard deviations.
    score: Vec<f64>,
    evidence: Vec<f64>,
    asked: Vec<bool>,
    next: Vec<bool>,
    regions: Regions,
}

/// Covariances of the pressures of a regular lattice for heights of variance 1.
#[derive(Clone, Debug, Default)]
struct Even {
    own: f64,
    cross: [f64; 12],
    among: [[f64; 12]; 12],
    /// Weights of the twelve in the prediction of the centre one, and the remaining variance.
    weights: [f64; 12],
    left: f64,
}

impl Even {
    /// For the weights of the neighbours along a row and down a column.
    fn new(along: f64, down: f64) -> Self {
        let stencil = |(row, col): (isize, isize)| match (row.abs(), col.abs()) {
            (0, 0) => 1.0 - 2.0 * (along + down),
            (0, 1) => along,
            (1, 0) => down,
            _ => 0.0,
        };
        let taps = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)];
        let alike = |(row, col): (isize, isize)| -> f64 {
            taps.iter().map(|&(r, c)| stencil((r, c)) * stencil((r - row, c - col))).sum()
        };
        let mut even = Self {
            own: alike((0, 0)),
            cross: AROUND.map(alike),
            among: AROUND.map(|(a, b)| AROUND.map(|(row, col)| alike((row - a, col - b)))),
            ..Self::default()
        };
        let all: [usize; 12] = core::array::from_fn(|k| k);
        for k in 0..12 {
            // The prediction is linear: the response to a unit pressure is its weight.
            let mut unit = [0.0; 12];
            unit[k] = 1.0;
            (even.weights[k], even.left) = even.predict(&all, &unit);
        }
        even
    }

    /// Prediction of the centre pressure from those of free markers at these places of [`AROUND`], and
    /// the remaining variance (simple kriging, by a Cholesky factor of their covariance matrix).
    fn predict(&self, places: &[usize], pressure_mm: &[f64; 12]) -> (f64, f64) {
        let (mut factor, mut half, mut values) = ([[0.0; 12]; 12], [0.0; 12], [0.0; 12]);
        let (mut predicted, mut left) = (0.0, self.own);
        for (i, &place) in places.iter().enumerate() {
            let mut row = [0.0; 12];
            let among = &self.among[place];
            for j in 0..i {
                let sum: f64 = row[..j].iter().zip(&factor[j][..j]).map(|(a, b)| a * b).sum();
                row[j] = (among[places[j]] - sum) * factor[j][j];
            }
            let before = |list: &[f64; 12]| row[..i].iter().zip(list).map(|(a, b)| a * b).sum::<f64>();
            let pivot = (among[place] - before(&row)).max(1e-9 * self.own);
            // The inverse of the diagonal.
            let inverse = 1.0 / sqrt(pivot);
            (half[i], values[i]) =
                ((self.cross[place] - before(&half)) * inverse, (pressure_mm[i] - before(&values)) * inverse);
            row[i] = inverse;
            factor[i] = row;
            predicted += half[i] * values[i];
            left -= half[i] * half[i];
        }
        (predicted, left.max(1e-9 * self.own))
    }
}

impl QuickPressure {
    /// As [`Pressure::new`](super::Pressure::new).
    ///
    /// # Errors
    /// The same.
    pub fn new(rest: &RestSurface, rows: usize, cols: usize, decay_mm: f64) -> Result<Self, ContactError> {
        let stencils = Stencils::new(rest, rows, cols, decay_mm)?;
        let all = &stencils.weights;
        let mean = |pair: [usize; 2]| {
            let inner = all.iter().filter(|w| w[1..].iter().all(|&w| w != 0.0));
            let (sum, count) =
                inner.fold((0.0, 0.0), |(sum, count), w| (sum + w[pair[0]] + w[pair[1]], count + 2.0));
            sum / f64::max(count, 1.0)
        };
        let even = Even::new(mean([1, 2]), mean([3, 4]));
        let noise = all.iter().map(|w| w.iter().map(|w| w * w).sum()).collect();
        let inner = all.iter().map(|w| w.iter().all(|&w| w != 0.0)).collect();
        let mut quick = Self { noise, inner, even, stencils, ..Self::default() };
        quick.reserve(rows * cols);
        Ok(quick)
    }

    /// The decay length in use.
    #[must_use]
    pub const fn decay_mm(&self) -> f64 {
        self.stencils.decay_mm
    }

    pub(super) const fn stencils(&self) -> &Stencils {
        &self.stencils
    }

    /// Root mean square of the standard deviations of the seen markers' heights in the last run.
    pub(super) const fn sigma_mm(&self) -> f64 {
        self.sigma_mm
    }

    /// Pressures of the last run, and whether all heights behind each were seen.
    pub(super) fn measured(&self) -> (&[f64], &[bool]) {
        (&self.pressure_mm, &self.valid)
    }

    /// Reserves all memory: the first contact may come late.
    fn reserve(&mut self, markers: usize) {
        let Self { pressure_mm, score, evidence, valid, asked, next, regions, .. } = self;
        [pressure_mm, score, evidence].into_iter().for_each(|list| list.reserve(markers));
        [valid, asked, next].into_iter().for_each(|list| list.reserve(markers));
        regions.reserve(markers);
    }

    /// Finds the markers in contact, as [`Pressure::run`](super::Pressure::run). Markers that are not
    /// seen are never salient; those beside them are classified by their neighbours. No allocation once
    /// `out` and this have held as many.
    ///
    /// # Errors
    /// The same.
    pub fn run(
        &mut self,
        indentation_mm: &[f64],
        variance_mm2: impl Iterator<Item = f64>,
        state: &[MarkerState],
        out: &mut Vec<bool>,
    ) -> Result<(), ContactError> {
        out.clear();
        let sigma_mm = self.check(indentation_mm, variance_mm2, state)?;
        self.sigma_mm = sigma_mm;
        self.measure(indentation_mm, state, sigma_mm);
        out.extend(self.score.iter().map(|&score| score > START));
        if !self.begin(out, sigma_mm) {
            return Ok(());
        }
        let Self { next, evidence, score, .. } = self;
        next.clear();
        next.extend_from_slice(out);
        evidence.clear();
        evidence.extend(score.iter().map(|&score| score * abs(score)));
        for _ in 0..ROUNDS {
            for i in 0..out.len() {
                if self.asked[i] && (CERTAIN.1..CERTAIN.0).contains(&self.score[i]) {
                    self.next[i] = self.judge(i, indentation_mm[i], out, sigma_mm);
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

    /// Root mean square of the standard deviations of the seen markers' heights.
    fn check(
        &self,
        indentation_mm: &[f64],
        variance_mm2: impl Iterator<Item = f64>,
        state: &[MarkerState],
    ) -> Result<f64, ContactError> {
        let rest = self.noise.len();
        for found in [indentation_mm.len(), state.len()] {
            if found != rest {
                return Err(ContactError::LengthMismatch { rest, found });
            }
        }
        let (mut sum, mut count, mut found) = (0.0, 0.0, 0);
        for (index, variance) in variance_mm2.enumerate() {
            found = index + 1;
            if state.get(index) == Some(&MarkerState::Seen) {
                if !(indentation_mm[index].is_finite() && variance.is_finite() && variance >= 0.0) {
                    return Err(ContactError::NotFinite { index });
                }
                sum += variance;
                count += 1.0;
            }
        }
        if found != rest {
            return Err(ContactError::LengthMismatch { rest, found });
        }
        Ok(sqrt(sum / f64::max(count, 1.0)).max(MIN_SIGMA_MM))
    }

    /// Pressures and their scores; 0 where a height is missing.
    fn measure(&mut self, indentation_mm: &[f64], state: &[MarkerState], sigma_mm: f64) {
        let Self { stencils, noise, pressure_mm, valid, score, .. } = self;
        for list in [&mut *pressure_mm, &mut *score] {
            list.clear();
            list.reserve(noise.len());
        }
        valid.clear();
        valid.reserve(noise.len());
        let per_sigma = 1.0 / sigma_mm;
        for (i, &noise) in noise.iter().enumerate() {
            let (mut pressure, mut seen) = (0.0, true);
            for (k, weight) in stencils.taps(i) {
                pressure += weight * indentation_mm[k];
                seen &= state[k] == MarkerState::Seen;
            }
            let pressure = if seen { pressure } else { 0.0 };
            pressure_mm.push(pressure);
            score.push(pressure * per_sigma / sqrt(noise));
            valid.push(seen);
        }
    }

    /// Selects the markers on both sides of a contact's rim, and those that free neighbours do not
    /// explain; returns whether there are any.
    fn begin(&mut self, contact: &[bool], sigma_mm: f64) -> bool {
        self.asked.clear();
        self.asked.resize(contact.len(), false);
        let mut any = false;
        for i in 0..contact.len() {
            if contact[i] {
                any = true;
                for (k, _) in self.stencils.taps(i).filter(|&(k, _)| !contact[k]) {
                    (self.asked[i], self.asked[k]) = (true, true);
                }
            } else if self.score[i] > 0.0 && self.stands_out(i, sigma_mm) {
                any = true;
                self.asked[i] = true;
            }
        }
        any
    }

    /// Whether the pressure is significant after prediction from its neighbours, all taken as free.
    fn stands_out(&self, i: usize, sigma_mm: f64) -> bool {
        let (mut left, mut variance) = (self.pressure_mm[i], self.noise[i]);
        if self.stencils.is_inside(i, 3) {
            for (&(row, col), weight) in AROUND.iter().zip(&self.even.weights) {
                left -= weight * self.pressure_mm[self.stencils.beside(i, row, col)];
            }
            variance = self.even.left;
        }
        rule::stands_out(left, variance * sigma_mm * sigma_mm)
    }

    /// Whether a marker is in contact, given the labels of the others.
    fn judge(&mut self, i: usize, height_mm: f64, contact: &[bool], sigma_mm: f64) -> bool {
        let (mut pressure, mut variance) = (self.pressure_mm[i], self.noise[i]);
        if self.inner[i] {
            let (mut places, mut values, mut count) = ([0; 12], [0.0; 12], 0);
            for (place, &(row, col)) in AROUND.iter().enumerate() {
                let Some(k) = self.stencils.within(i, row, col) else { continue };
                if !contact[k] && self.inner[k] && self.valid[k] {
                    (places[count], values[count]) = (place, self.pressure_mm[k]);
                    count += 1;
                }
            }
            let (predicted, left) = self.even.predict(&places[..count], &values);
            (pressure, variance) = (pressure - predicted, left);
        }
        // Where a height is missing, the neighbours alone decide.
        let (pressure, height_mm) = if self.valid[i] { (pressure, height_mm) } else { (0.0, 0.0) };
        let variance_mm2 = variance * sigma_mm * sigma_mm;
        self.evidence[i] = rule::evidence(pressure, variance_mm2);
        let neighbours = self.stencils.taps(i).skip(1).map(|(k, _)| contact[k]);
        rule::gain(pressure, height_mm, variance_mm2, neighbours) > 0.0
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
