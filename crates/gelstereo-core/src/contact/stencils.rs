//! The lattice of markers and the stencils of their pressures.

use super::{ContactError, RestSurface};
use crate::lattice::Topology;
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Smallest sum of squared standard deviations in excess of `WEAK` of a region; by chance one marker in a
/// million exceeds 4.75 standard deviations.
const SURE: f64 = 18.5;
/// Squared standard deviations of a marker up to which it contributes nothing to its region.
const WEAK: f64 = 4.0;

/// Weights of p = h - l² Δh for every marker of a lattice, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Stencils {
    pub topology: Topology,
    pub rows: usize,
    pub cols: usize,
    pub decay_mm: f64,
    /// Weights of the marker, and of those before and after it along the row and the second axis; 0 where
    /// there is none.
    pub weights: Vec<[f64; 5]>,
    /// The same of those before and after it along the third axis of a hexagonal print.
    leaning: Vec<[f64; 2]>,
}

/// The Laplacian of a hexagonal lattice is this share of the sum of the second differences along its axes.
const HEXAGONAL: f64 = 2.0 / 3.0;

impl Stencils {
    pub fn new(rest: &RestSurface, topology: Topology, decay_mm: f64) -> Result<Self, ContactError> {
        let points = rest.points_mm();
        let (rows, cols) = (topology.rows(), topology.cols());
        if rows.checked_mul(cols) != Some(points.len()) {
            return Err(ContactError::LengthMismatch {
                rest: points.len(),
                found: rows.saturating_mul(cols),
            });
        }
        check_decay(decay_mm)?;
        let l2 = decay_mm * decay_mm;
        let l2 = if topology.is_hexagonal() { HEXAGONAL * l2 } else { l2 };
        let differences = |i: usize, axis: usize| {
            let apart = |count| topology.step(i, axis, count).map(|j| points[i].distance(points[j]));
            second_difference(apart(-1), apart(1))
        };
        let third = |i: usize| if topology.is_hexagonal() { differences(i, 2) } else { [0.0; 2] };
        let stencil = |i: usize| {
            let ([left, right], [up, down]) = (differences(i, 0), differences(i, 1));
            let [before, after] = third(i);
            let sum = left + right + up + down + before + after;
            [1.0 + l2 * sum, -l2 * left, -l2 * right, -l2 * up, -l2 * down]
        };
        let weights = (0..points.len()).map(stencil).collect();
        let hexagonal = if topology.is_hexagonal() { points.len() } else { 0 };
        let leaning = (0..hexagonal).map(|i| third(i).map(|weight| -l2 * weight)).collect();
        Ok(Self { topology, rows, cols, decay_mm, weights, leaning })
    }

    /// Sets another decay length; the second differences scale with its square.
    pub fn set_decay(&mut self, decay_mm: f64) -> Result<(), ContactError> {
        check_decay(decay_mm)?;
        let times = (decay_mm / self.decay_mm) * (decay_mm / self.decay_mm);
        self.leaning.iter_mut().flatten().for_each(|weight| *weight *= times);
        for (i, [own, around @ ..]) in self.weights.iter_mut().enumerate() {
            around.iter_mut().for_each(|weight| *weight *= times);
            let leaning = self.leaning.get(i).map_or(0.0, |[before, after]| before + after);
            *own = 1.0 - (around.iter().sum::<f64>() + leaning);
        }
        self.decay_mm = decay_mm;
        Ok(())
    }

    /// Marker and neighbours of a stencil, with their weights.
    pub fn taps(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let beside = |axis: usize, count: isize| match self.topology.is_hexagonal() {
            true => self.topology.step(i, axis, count).unwrap_or(i),
            false => i.wrapping_add_signed(count * self.cols as isize),
        };
        let places = [i, i.wrapping_sub(1), i + 1, beside(1, -1), beside(1, 1)];
        let leaning =
            self.leaning.get(i).map(|&weights| [beside(2, -1), beside(2, 1)].into_iter().zip(weights));
        let taps = places.into_iter().zip(self.weights[i]).chain(leaning.into_iter().flatten());
        taps.filter(|&(_, weight)| weight != 0.0)
    }

    /// Whether a marker has neighbours on both sides along every axis.
    pub fn is_inner(&self, i: usize) -> bool {
        self.taps(i).count() == 1 + 2 * self.topology.axes()
    }

    /// Weight of a tap: 0 is the marker, then before and after it along each axis.
    pub fn weight(&self, i: usize, tap: usize) -> f64 {
        let weights = &self.weights[i];
        weights.get(tap).copied().unwrap_or_else(|| self.leaning[i][tap - weights.len()])
    }

    /// Markers up to `reach` rows and columns from one.
    pub fn window(&self, i: usize, reach: usize) -> impl Iterator<Item = usize> + use<> {
        let (row, col, cols) = (i / self.cols, i % self.cols, self.cols);
        let across = col.saturating_sub(reach)..(col + reach + 1).min(self.cols);
        let down = row.saturating_sub(reach)..(row + reach + 1).min(self.rows);
        down.flat_map(move |r| across.clone().map(move |c| r * cols + c))
    }

    /// Whether a marker is at least `reach` rows and columns from the border.
    pub fn is_inside(&self, i: usize, reach: usize) -> bool {
        let inside = |at: usize, end: usize| at >= reach && at + reach < end;
        inside(i / self.cols, self.rows) && inside(i % self.cols, self.cols)
    }
}

fn check_decay(found_mm: f64) -> Result<(), ContactError> {
    if (1e-3..=1e3).contains(&found_mm) { Ok(()) } else { Err(ContactError::Decay { found_mm }) }
}

/// Weights of the neighbours at these distances in a second difference; the surface is mirrored at the
/// border.
fn second_difference(before: Option<f64>, after: Option<f64>) -> [f64; 2] {
    match (before, after) {
        (Some(a), Some(b)) => [2.0 / (a * (a + b)), 2.0 / (b * (a + b))],
        (Some(a), None) => [1.0 / (a * a), 0.0],
        (None, Some(b)) => [0.0, 1.0 / (b * b)],
        (None, None) => [0.0; 2],
    }
}

/// Regions of markers that are connected by [`Topology::around`]; scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct Regions {
    seen: Vec<bool>,
    region: Vec<u32>,
}

impl Regions {
    /// Reserves memory for this many markers.
    pub fn reserve(&mut self, markers: usize) {
        self.seen.clear();
        self.seen.reserve(markers);
        self.region.clear();
        self.region.reserve(markers);
    }

    /// Removes regions that may be chance, given the signed squared standard deviations of every marker's
    /// pressure, and then the markers that are not seen.
    pub fn keep_sure(
        &mut self,
        lattice: &Stencils,
        evidence: &[f64],
        state: &[MarkerState],
        contact: &mut [bool],
    ) {
        self.drop_unsure(lattice, evidence, contact);
        for (contact, &state) in contact.iter_mut().zip(state) {
            *contact &= state == MarkerState::Seen;
        }
    }

    fn drop_unsure(&mut self, lattice: &Stencils, evidence: &[f64], contact: &mut [bool]) {
        self.reserve(contact.len());
        let Self { seen, region } = self;
        seen.resize(contact.len(), false);
        for seed in 0..contact.len() {
            if !contact[seed] || seen[seed] {
                continue;
            }
            region.clear();
            region.push(seed as u32);
            seen[seed] = true;
            let (mut next, mut excess) = (0, 0.0);
            while next < region.len() {
                let i = region[next] as usize;
                next += 1;
                excess += (evidence[i] - WEAK).max(0.0);
                for j in lattice.topology.around(i) {
                    if contact[j] && !seen[j] {
                        seen[j] = true;
                        region.push(j as u32);
                    }
                }
            }
            if excess < SURE {
                region.iter().for_each(|&i| contact[i as usize] = false);
            }
        }
    }
}
