//! What a pose of the part predicts of the gel at every node, and the room for it.

use super::lattice::Sweeps;
use super::model::Gel;
use crate::register::observe::Vector6;
use crate::register::surface::distances::{Foot, Line};
use alloc::vec::Vec;
use core::mem::swap;

/// Turn and shift of the part, the plane of rest, and the logarithm of l².
pub(in crate::register::surface) const UNKNOWN: usize = 10;
pub(in crate::register::surface) const PLANE: usize = 6;
pub(in crate::register::surface) const DECAY: usize = 9;
pub(in crate::register::surface) type Row = [f64; UNKNOWN];

/// Standard deviations from which gel is lifted.
pub(in crate::register::surface) const LIFTED: f64 = 3.0;
/// A squared deviation counts up to this: an outlier weighs no more than a marker four standard deviations off.
pub(in crate::register::surface) const MAX_SQUARE: f64 = 16.0;

/// What a pose predicts of one node.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Sight {
    /// Where the part is under it; `None` where there is none.
    pub foot: Option<Foot>,
    /// How near the part is to the line through the node that does not meet it.
    pub clear_mm: f64,
    pub touches: bool,
    /// Measured over predicted height.
    pub residual_mm: f64,
    /// Between the gel and the part.
    pub gap_mm: f64,
    pub variance_mm2: f64,
    /// Probability that it is no outlier.
    pub weight: f64,
}

/// All of that at one state.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct Prediction {
    /// Whether it is of this contact.
    pub is_known: bool,
    pub sights: Vec<Sight>,
    pub heights_mm: Vec<f64>,
    pub cost: f64,
}

impl Prediction {
    /// Share of the markers at the part which are no outliers.
    pub fn explained(&self) -> f64 {
        mean(self.at_part().map(|sight| sight.weight)).unwrap_or(0.0)
    }

    /// Mean square of what the markers at the part miss it by over its variance; of an outlier nothing is known, and it
    /// counts as one that is as wrong as its noise.
    pub fn misfit(&self) -> f64 {
        let squared = |sight: &Sight| sight.residual_mm * sight.residual_mm / sight.variance_mm2;
        mean(self.at_part().map(|s| s.weight * squared(s) + 1.0 - s.weight)).unwrap_or(f64::INFINITY)
    }

    /// As [`Self::misfit`], of the markers that touch the part, and of others by their place in the list, and how many they
    /// are. Outliers beyond the expected share are no chance: each counts as much as an outlier may.
    pub fn touching_misfit(&self, outlier_share: f64, and: impl Fn(usize) -> bool) -> (f64, f64) {
        let tested = || {
            let all = self.sights.iter().enumerate();
            all.filter(|(k, sight)| sight.touches || and(*k)).map(|(_, sight)| sight)
        };
        let squared = |sight: &Sight| sight.residual_mm * sight.residual_mm / sight.variance_mm2;
        let good = mean(tested().map(|s| s.weight * squared(s) + 1.0 - s.weight)).unwrap_or(1.0);
        let outliers = mean(tested().map(|s| 1.0 - s.weight)).unwrap_or(0.0);
        let unexpected = (outliers - outlier_share).max(0.0);
        (good + unexpected * (MAX_SQUARE - 1.0), tested().count() as f64)
    }

    /// The markers that touch it or are lifted.
    fn at_part(&self) -> impl Iterator<Item = &Sight> {
        let is_lifted = |(sight, height_mm): &(&Sight, &f64)| {
            *height_mm * *height_mm > LIFTED * LIFTED * sight.variance_mm2
        };
        let all = self.sights.iter().zip(&self.heights_mm);
        all.filter(move |one| one.0.touches || is_lifted(one)).map(|(sight, _)| sight)
    }

    /// Heights to begin from are those of another.
    pub fn begin_as(&mut self, other: &Self) {
        self.heights_mm.clear();
        self.heights_mm.extend_from_slice(&other.heights_mm);
    }
}

/// `None` of nothing.
fn mean(all: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = all.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Predictions that are kept: those of as many candidates.
pub(in crate::register::surface) const KEPT: usize = 8;

/// Vectors that are kept from run to run.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct GelFitScratch {
    pub here: Prediction,
    pub there: Prediction,
    /// Of candidates, by their slots.
    pub kept: [Prediction; KEPT],
    pub obstacle_mm: Vec<f64>,
    pub changes: Vec<Row>,
    pub sweeps: Sweeps,
    pub cells: Vec<Row>,
    pub rows: Vec<Row>,
    pub hints: Vec<u32>,
    /// Through the nodes.
    pub lines: Vec<Line>,
    /// What every node's height counts for in the information, per mm².
    pub counts_per_mm2: Vec<f64>,
    /// What edges leave room for.
    pub walls: Vec<Wall>,
}

impl GelFitScratch {
    /// Starts another contact. All predictions are swapped with one another, so each gets room for every node.
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

    /// Brings a kept prediction to `here`; how another one changed does not count.
    pub fn show(&mut self, slot: usize) {
        self.changes.fill([0.0; UNKNOWN]);
        swap(&mut self.kept[slot], &mut self.here);
    }
}

/// A pose z is on this side of the wall where `row` · z is less than `room_mm`.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Wall {
    pub row: Vector6,
    pub room_mm: f64,
    /// How sharp it is.
    pub sigma_mm: f64,
    /// What it adds: a precision, and that times where it would have the pose.
    pub precision: f64,
    pub pull: f64,
}
