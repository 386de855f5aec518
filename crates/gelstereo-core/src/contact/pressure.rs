//! Saliency by pressure: the gel rises beside a contact too, but carries pressure only where something touches it.
//!
//! Model: a Pasternak foundation (Pasternak 1954), p = h - l² Δh, in which h is the indentation at the marker's place of
//! rest (as in all linear elasticity) and p the pressure per stiffness, in mm. Beside the contact p = 0 whatever
//! the part.
//!
//! One stencil multiplies the noise of h by 1 + 8 l² / pitch², so that a plain threshold on p fails. But where a marker
//! is known to be free, its p *is* noise, and neighbouring stencils share markers, so that the noise of p at a marker is
//! predicted from the free markers around it (simple kriging) and taken away. Which markers are free is found by
//! iterated conditional modes (Besag 1986) on a Markov random field that holds neighbours together.

use super::{ContactError, RestSurface};
use crate::math::sqrt;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Markers on either side of the one that is judged whose noise is used to predict its own; stencils share none beyond.
const REACH: usize = 2;
const SIDE: usize = 2 * REACH + 1;
const WINDOW: usize = SIDE * SIDE;
/// What a marker in contact costs, in units of squared standard deviations: by this much must its pressure stand out.
const COST: f64 = 2.0;
/// What a pair of neighbours costs of which one is in contact.
const EDGE_COST: f64 = 3.0;
/// Squared standard deviations beyond `WEAK` that a region must show in all; by chance one marker in a million shows 4.75
/// standard deviations.
const SURE: f64 = 18.5;
/// Squared standard deviations of a marker that say nothing about its region.
const WEAK: f64 = 4.0;
/// Standard deviations of the plain stencil from which a marker is taken to be in contact at first.
const START: f64 = 4.0;
/// A marker that keeps changing stays as it is: the windows make the energy approximate, so that there can be cycles.
const MOST_CHANGES: u8 = 4;
/// Variance of a height that was not measured, mm²: as good as unknown, and still 10 digits above round-off.
const UNKNOWN_MM2: f64 = 100.0;
/// Standard deviation below which no height is believed to be, mm: a nanometre.
const LEAST_SIGMA_MM: f64 = 1e-6;

/// Finds the markers in contact by the pressure of the gel; scratch is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Pressure {
    rows: usize,
    cols: usize,
    /// Weights of p = h - l² Δh: the marker, left, right, up, down; 0 where there is none.
    stencils: Vec<[f64; 5]>,
    variance_mm2: Vec<f64>,
    pressure_mm: Vec<f64>,
    /// Covariances of the stencils with those around.
    covariance: Vec<[f64; WINDOW]>,
    /// Signed squared standard deviations of the pressure.
    evidence: Vec<f64>,
    gain: Vec<f64>,
    stale: Vec<bool>,
    changes: Vec<u8>,
    region: Vec<u32>,
}

/// Free markers around the one that is judged.
struct Around {
    count: usize,
    index: [usize; WINDOW],
}

impl Pressure {
    /// For this rest surface of `rows * cols` markers, row by row, and this decay length of the gel beside a contact.
    ///
    /// # Errors
    /// [`ContactError::LengthMismatch`] when the rest surface has not `rows * cols` markers, [`ContactError::Decay`] for what
    /// is no length.
    pub fn new(rest: &RestSurface, rows: usize, cols: usize, decay_mm: f64) -> Result<Self, ContactError> {
        let points = rest.points_mm();
        if rows.checked_mul(cols) != Some(points.len()) {
            return Err(ContactError::LengthMismatch {
                rest: points.len(),
                found: rows.saturating_mul(cols),
            });
        }
        if !(1e-3..=1e3).contains(&decay_mm) {
            return Err(ContactError::Decay { found_mm: decay_mm });
        }
        let l2 = decay_mm * decay_mm;
        let stencil = |i: usize| {
            let (row, col) = (i / cols, i % cols);
            let apart = |exists: bool, j: usize| exists.then(|| points[i].distance(points[j]));
            let [left, right] =
                second_difference(apart(col > 0, i.wrapping_sub(1)), apart(col + 1 < cols, i + 1));
            let [up, down] =
                second_difference(apart(row > 0, i.wrapping_sub(cols)), apart(row + 1 < rows, i + cols));
            [1.0 + l2 * (left + right + up + down), -l2 * left, -l2 * right, -l2 * up, -l2 * down]
        };
        let stencils = (0..points.len()).map(stencil).collect();
        Ok(Self { rows, cols, stencils, ..Self::default() })
    }

    /// Markers in contact, from the indentations and their variances (mm²); markers that are not seen are never salient,
    /// and their heights are taken as unknown. `out` is cleared first; no allocation once it has held this many.
    ///
    /// # Errors
    /// [`ContactError::LengthMismatch`] when a list has not `rows * cols` entries, [`ContactError::NotFinite`] for a seen
    /// marker whose indentation or variance is NaN, infinite or negative; `out` is then empty.
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
            let least = LEAST_SIGMA_MM * LEAST_SIGMA_MM;
            *variance = if state == MarkerState::Seen { variance.max(least) } else { UNKNOWN_MM2 };
        }
        self.measure(indentation_mm, state);
        out.extend(
            (0..self.len()).map(|i| self.pressure_mm[i] > START * sqrt(self.covariance[i][WINDOW / 2])),
        );
        self.settle(out);
        self.drop_unsure(out);
        for (salient, &state) in out.iter_mut().zip(state) {
            *salient &= state == MarkerState::Seen;
        }
        Ok(())
    }

    /// Pressure of every marker by its own stencil, mm, in the frame of the last run; noisy, see the module.
    #[must_use]
    pub fn pressure_mm(&self) -> &[f64] {
        &self.pressure_mm
    }

    fn len(&self) -> usize {
        self.stencils.len()
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

    /// The stencil's marker, left, right, upper and lower neighbour, with their weights.
    fn taps(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let places = [i, i.wrapping_sub(1), i + 1, i.wrapping_sub(self.cols), i + self.cols];
        places.into_iter().zip(self.stencils[i]).filter(|&(_, weight)| weight != 0.0)
    }

    /// Weight of marker `k`, a neighbour of `j` or `j` itself, in the stencil of `j`.
    fn weight(&self, j: usize, k: usize) -> f64 {
        let tap = if k == j {
            0
        } else if k + 1 == j && self.stencils[j][1] != 0.0 {
            1
        } else if k == j + 1 && self.stencils[j][2] != 0.0 {
            2
        } else if k < j {
            3
        } else {
            4
        };
        self.stencils[j][tap]
    }

    /// Pressures, and the covariances of their noise.
    fn measure(&mut self, indentation_mm: &[f64], state: &[MarkerState]) {
        // A height that is unknown may be anything, so 0.
        let height = |k: usize| if state[k] == MarkerState::Seen { indentation_mm[k] } else { 0.0 };
        let mut pressure_mm = core::mem::take(&mut self.pressure_mm);
        pressure_mm.clear();
        pressure_mm.extend((0..self.len()).map(|i| self.taps(i).map(|(k, w)| w * height(k)).sum::<f64>()));
        self.pressure_mm = pressure_mm;
        let mut covariance = core::mem::take(&mut self.covariance);
        covariance.clear();
        covariance.extend((0..self.len()).map(|i| {
            let mut around = [0.0; WINDOW];
            for (k, w) in self.taps(i) {
                for (j, _) in self.taps(k) {
                    around[self.slot(i, j)] += w * self.variance_mm2[k] * self.weight(j, k);
                }
            }
            around
        }));
        self.covariance = covariance;
    }

    /// Where marker `j` stands in the window about marker `i`.
    fn slot(&self, i: usize, j: usize) -> usize {
        let row = j / self.cols + REACH - i / self.cols;
        let col = j % self.cols + REACH - i % self.cols;
        row * SIDE + col
    }

    /// Rows and columns of the window about a marker.
    fn window(&self, i: usize, reach: usize) -> impl Iterator<Item = usize> + use<> {
        let (row, col, cols) = (i / self.cols, i % self.cols, self.cols);
        let across = col.saturating_sub(reach)..(col + reach + 1).min(self.cols);
        let down = row.saturating_sub(reach)..(row + reach + 1).min(self.rows);
        down.flat_map(move |r| across.clone().map(move |c| r * cols + c))
    }

    /// Covariance of the noise of two stencils.
    fn shared(&self, i: usize, j: usize) -> f64 {
        let down = (j / self.cols).abs_diff(i / self.cols);
        let across = (j % self.cols).abs_diff(i % self.cols);
        if down + across <= REACH { self.covariance[i][self.slot(i, j)] } else { 0.0 }
    }

    /// Changes labels until none gains: in each round those that gain most within their windows, so that no order of
    /// the markers is preferred.
    fn settle(&mut self, contact: &mut [bool]) {
        for list in [&mut self.evidence, &mut self.gain] {
            list.clear();
            list.resize(contact.len(), 0.0);
        }
        self.stale.clear();
        self.stale.resize(contact.len(), true);
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
                // Of equal gains the first.
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

    /// What the energy falls by when this marker's label changes.
    fn judge(&mut self, i: usize, contact: &[bool]) {
        let (pressure, variance) = self.predict(i, contact);
        let evidence = pressure * pressure.abs() / variance;
        let (mut touching, mut neighbours) = (0.0, 0.0);
        for (j, _) in self.taps(i).skip(1) {
            neighbours += 1.0;
            touching += if contact[j] { 1.0 } else { 0.0 };
        }
        let score = evidence - COST - EDGE_COST * (neighbours - 2.0 * touching);
        self.evidence[i] = evidence;
        let gain = if contact[i] { -score } else { score };
        self.gain[i] = if self.changes[i] < MOST_CHANGES { gain } else { 0.0 };
    }

    /// Pressure and its variance when the free markers around carry none.
    fn predict(&self, i: usize, contact: &[bool]) -> (f64, f64) {
        let mut around = Around { count: 0, index: [0; WINDOW] };
        for j in self.window(i, REACH).filter(|&j| j != i && !contact[j]) {
            around.index[around.count] = j;
            around.count += 1;
        }
        let free = &around.index[..around.count];
        let mut lower = [[0.0; WINDOW]; WINDOW];
        let (mut pressure, mut variance) = (self.pressure_mm[i], self.covariance[i][WINDOW / 2]);
        let least = 1e-9 * variance;
        let (mut share, mut white) = ([0.0; WINDOW], [0.0; WINDOW]);
        for (a, &j) in free.iter().enumerate() {
            // One more row of the Cholesky factor of the free markers' covariance, and of both right sides.
            for (b, &k) in free[..a].iter().enumerate() {
                let sum: f64 = (0..b).map(|c| lower[a][c] * lower[b][c]).sum();
                lower[a][b] = (self.shared(j, k) - sum) / lower[b][b];
            }
            let own = self.covariance[j][WINDOW / 2];
            let sum: f64 = lower[a][..a].iter().map(|x| x * x).sum();
            lower[a][a] = sqrt((own - sum).max(1e-12 * own));
            let row = &lower[a];
            let dot = |x: &[f64; WINDOW]| (0..a).map(|c| row[c] * x[c]).sum::<f64>();
            share[a] = (self.shared(i, j) - dot(&share)) / row[a];
            white[a] = (self.pressure_mm[j] - dot(&white)) / row[a];
            pressure -= share[a] * white[a];
            variance -= share[a] * share[a];
        }
        (pressure, variance.max(least))
    }

    /// Takes away regions (of 8-connected markers) that could be chance.
    fn drop_unsure(&mut self, contact: &mut [bool]) {
        self.region.clear();
        self.region.reserve(contact.len());
        self.stale.clear();
        self.stale.resize(contact.len(), false);
        for seed in 0..contact.len() {
            if !contact[seed] || self.stale[seed] {
                continue;
            }
            self.region.clear();
            self.region.push(seed as u32);
            self.stale[seed] = true;
            let (mut next, mut excess) = (0, 0.0);
            while next < self.region.len() {
                let i = self.region[next] as usize;
                next += 1;
                excess += (self.evidence[i] - WEAK).max(0.0);
                for j in self.window(i, 1) {
                    if contact[j] && !self.stale[j] {
                        self.stale[j] = true;
                        self.region.push(j as u32);
                    }
                }
            }
            if excess < SURE {
                self.region.iter().for_each(|&i| contact[i as usize] = false);
            }
        }
    }
}

/// Weights of the neighbours at these distances in a second difference; beyond the border the surface goes on as its
/// mirror image.
fn second_difference(before: Option<f64>, after: Option<f64>) -> [f64; 2] {
    match (before, after) {
        (Some(a), Some(b)) => [2.0 / (a * (a + b)), 2.0 / (b * (a + b))],
        (Some(a), None) => [1.0 / (a * a), 0.0],
        (None, Some(b)) => [0.0, 1.0 / (b * b)],
        (None, None) => [0.0; 2],
    }
}
