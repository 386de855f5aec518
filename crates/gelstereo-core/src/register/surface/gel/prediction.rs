//! Prediction of the gel at every node for a pose of the part, and its buffers.

use super::lattice::Sweeps;
use super::model::Gel;
use crate::register::observe::Vector6;
use crate::register::surface::distances::{Foot, Line};
use crate::register::verdict::MeanSquare;
use alloc::vec::Vec;
use core::mem::swap;

/// Unknowns: rotation and translation of the part, rest plane, and the logarithm of l².
pub(in crate::register::surface) const UNKNOWN: usize = 10;
pub(in crate::register::surface) const PLANE: usize = 6;
pub(in crate::register::surface) const DECAY: usize = 9;
pub(in crate::register::surface) type Row = [f64; UNKNOWN];

/// Standard deviations from which the gel counts as lifted.
pub(in crate::register::surface) const LIFTED: f64 = 3.0;
/// Limit of a squared deviation: an outlier weighs no more than a marker four standard deviations off.
pub(in crate::register::surface) const MAX_SQUARE: f64 = 16.0;

/// Prediction for one node.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Sight {
    /// The part's surface under the node; `None` without one.
    pub foot: Option<Foot>,
    /// Distance of the part from the line through the node, if that misses it.
    pub clear_mm: f64,
    pub touches: bool,
    /// Measured minus predicted height.
    pub residual_mm: f64,
    /// Gap between the gel and the part.
    pub gap_mm: f64,
    pub variance_mm2: f64,
    /// Inlier probability.
    pub weight: f64,
}

impl Sight {
    /// Squared residual over its variance.
    pub fn square(&self) -> f64 {
        self.residual_mm * self.residual_mm / self.variance_mm2
    }
}

/// Predictions of all nodes at one state.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct Prediction {
    /// Whether it belongs to the current contact.
    pub is_known: bool,
    pub sights: Vec<Sight>,
    pub heights_mm: Vec<f64>,
    pub cost: f64,
}

impl Prediction {
    /// Inlier share of the markers at the part.
    pub fn explained(&self) -> f64 {
        mean(self.at_part().map(|sight| sight.weight)).unwrap_or(0.0)
    }

    /// Mean squared residual over variance of the markers at the part. An outlier carries no information
    /// and counts as 1, the value expected from noise.
    pub fn misfit(&self) -> f64 {
        mean(self.at_part().map(|s| s.weight * s.square() + 1.0 - s.weight)).unwrap_or(f64::INFINITY)
    }

    /// As [`Self::misfit`], for the markers in contact and those selected by their index. Outliers beyond the
    /// expected share are not due to chance; each counts `MAX_SQUARE`.
    pub fn touching_misfit(&self, outlier_share: f64, and: impl Fn(usize) -> bool) -> MeanSquare {
        let tested = || {
            let all = self.sights.iter().enumerate();
            all.filter(|(k, sight)| sight.touches || and(*k)).map(|(_, sight)| sight)
        };
        let good = mean(tested().map(|s| s.weight * s.square() + 1.0 - s.weight)).unwrap_or(1.0);
        let outliers = mean(tested().map(|s| 1.0 - s.weight)).unwrap_or(0.0);
        let unexpected = (outliers - outlier_share).max(0.0);
        MeanSquare { mean: good + unexpected * (MAX_SQUARE - 1.0), count: tested().count() as f64 }
    }

    /// The markers in contact with the part or lifted.
    fn at_part(&self) -> impl Iterator<Item = &Sight> {
        let is_lifted = |(sight, height_mm): &(&Sight, &f64)| {
            *height_mm * *height_mm > LIFTED * LIFTED * sight.variance_mm2
        };
        let all = self.sights.iter().zip(&self.heights_mm);
        all.filter(move |one| one.0.touches || is_lifted(one)).map(|(sight, _)| sight)
    }

    /// Takes the initial heights from another prediction.
    pub fn begin_as(&mut self, other: &Self) {
        self.heights_mm.clear();
        self.heights_mm.extend_from_slice(&other.heights_mm);
    }
}

/// `None` if empty.
fn mean(all: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = all.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Number of predictions kept, one per candidate.
pub(in crate::register::surface) const KEPT: usize = 8;

/// Buffers reused between runs.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct GelFitScratch {
    pub here: Prediction,
    pub there: Prediction,
    /// Predictions of the candidates, by slot.
    pub kept: [Prediction; KEPT],
    pub obstacle_mm: Vec<f64>,
    pub changes: Vec<Row>,
    pub sweeps: Sweeps,
    pub cells: Vec<Row>,
    pub rows: Vec<Row>,
    pub hints: Vec<u32>,
    /// Lines through the nodes.
    pub lines: Vec<Line>,
    /// Weight of every node's height in the information matrix, per mm².
    pub counts_per_mm2: Vec<f64>,
    /// Bounds from the edges.
    pub walls: Vec<Wall>,
}

impl GelFitScratch {
    /// Prepares for another contact. All predictions are swapped with one another, so each gets capacity
    /// for every node.
    pub fn clear(&mut self, gel: &Gel) {
        let count = gel.nodes.len();
        for one in self.kept.iter_mut().chain([&mut self.here, &mut self.there]) {
            one.sights.reserve(count.saturating_sub(one.sights.len()));
            one.heights_mm.reserve(count.saturating_sub(one.heights_mm.len()));
            one.is_known = false;
        }
        self.hints.clear();
        self.hints.resize(count, 0);
        self.changes.resize(count, [0.0; UNKNOWN]);
        self.lines.clear();
        self.lines.reserve(count);
        self.walls.clear();
        self.walls.reserve(count);
        gel.lay_out(&mut self.sweeps);
    }

    pub fn kept(&self, slot: usize) -> &Prediction {
        &self.kept[slot]
    }

    /// Moves a kept prediction to `here`, and resets the derivatives of the previous one.
    pub fn show(&mut self, slot: usize) {
        self.changes.fill([0.0; UNKNOWN]);
        swap(&mut self.kept[slot], &mut self.here);
    }
}

/// One-sided bound on the pose z: `row` · z is less than `room_mm`.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Wall {
    pub row: Vector6,
    pub room_mm: f64,
    /// Standard deviation of the bound.
    pub sigma_mm: f64,
    /// Contribution of the wall: a precision, and that times the mean.
    pub precision: f64,
    pub pull: f64,
}
