//! Shift of a lattice by whole pitches, determined from its border.

use super::extended_lattice::{ExtendedLattice, NONE};
use crate::math::DVec2;
use alloc::vec::Vec;
use core::ops::Range;

/// Cost of a detection outside the lattice, or at a place that was never printed, relative to a missing
/// marker.
const STRAY: u32 = 3;

/// A marker this close to the image border, in pitches, may be cut off: it is neither expected nor
/// excluded.
const BORDER_PITCHES: f64 = 0.6;

/// An unmatched detection counts at a place within this distance, in pitches.
const AT_PLACE: f64 = 0.5;

/// Prior knowledge of a marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expectation {
    /// Found recently.
    Present,
    /// Hidden for some time.
    Unknown,
    /// Never found: not printed.
    Absent,
}

/// Compares the possible shifts of a labelled patch.
///
/// A lattice is periodic, so shifts by a pitch differ only at its border and at unprinted places. A shift
/// costs 1 for each expected marker in view that is missing, [`STRAY`] for each detection where none can
/// be, and the cost of the jump. The best shift is certain when all others cost clearly more.
///
/// Every detection counts, matched or not: any detection shows that the gel is not empty there. Counting
/// matches alone would be biased, since a poorly visible border row is matched less easily where it is
/// not expected.
///
/// Sums over a shifted lattice are differences of prefix sums; only missing, unprinted or unplaced
/// markers need corrections.
#[derive(Clone, Debug, Default)]
pub(super) struct PitchShift {
    taken: Vec<bool>,
    present: Vec<u8>,
    /// Places in view without a detection.
    empty: Vec<bool>,
    /// Prefix sums of `present` and `empty` above and to the left of each place, exclusive; one more row
    /// and column than places.
    before: Vec<[u32; 2]>,
    /// Cost of each shift, rows first.
    costs: Vec<u32>,
    stretches: Vec<Stretch>,
}

/// Consecutive places of a row, and their bounding box.
#[derive(Clone, Debug)]
struct Stretch {
    places: Range<usize>,
    low_px: DVec2,
    high_px: DVec2,
}

/// Places of a stretch.
const STRETCH: usize = 16;

/// Whether a marker at a position is whole in the image.
pub(super) fn in_view(size_px: (usize, usize), pitch_px: f64) -> impl Fn(DVec2) -> bool {
    let border = DVec2::splat(BORDER_PITCHES * pitch_px);
    let far = DVec2::new(size_px.0 as f64 - 1.0, size_px.1 as f64 - 1.0) - border;
    move |p| p.cmpge(border).all() && p.cmple(far).all()
}

/// Cost of a jump, proportional to its length up to one pitch and at most one row of markers. A border
/// that disappears suddenly may have moved away or be hidden.
fn surprise(canvas: &ExtendedLattice, shift: [isize; 2], pitch_px: f64) -> u32 {
    let side = canvas.rows.min(canvas.cols) as f64;
    let middle = canvas.rows / 2 * canvas.cols + canvas.cols / 2;
    let (Some(from), Some(to)) = (canvas.site(middle, [0, 0]), canvas.site(middle, shift)) else { return 0 };
    let moved_px = canvas.position_px(to).distance(canvas.predicted_px[from]);
    (side * (moved_px / pitch_px).min(1.0)) as u32
}

/// The cheapest shift and the cost of the second.
#[derive(Clone, Copy, Debug)]
struct Rank {
    best: u32,
    second: u32,
    shift: [isize; 2],
}

impl Default for Rank {
    fn default() -> Self {
        Self { best: u32::MAX, second: u32::MAX, shift: [0, 0] }
    }
}

impl Rank {
    fn add(&mut self, cost: u32, shift: [isize; 2]) {
        if cost < self.best {
            *self = Self { best: cost, second: self.best, shift };
        } else {
            self.second = self.second.min(cost);
        }
    }
}

/// Result of the search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shifted {
    /// Marker (row, col) lies at place (row, col) + shift.
    pub shift: [isize; 2],
    /// Whether no other shift has a similar cost.
    pub certain: bool,
}

impl PitchShift {
    /// Reserves memory for a lattice of this size, a canvas with up to `rings` rings, and this many
    /// detections.
    pub fn reserve(&mut self, (rows, cols): (usize, usize), rings: usize, detections: usize) {
        let (height, width) = (rows + 2 * rings, cols + 2 * rings);
        self.taken.clear();
        self.taken.reserve(detections);
        self.present.clear();
        self.present.reserve(height * width);
        self.empty.clear();
        self.empty.reserve(height * width);
        self.before.clear();
        self.before.reserve((height + 1) * (width + 1));
        self.costs.clear();
        self.costs.reserve((2 * rings + 1) * (2 * rings + 1));
        self.stretches.clear();
        self.stretches.reserve(height * width.div_ceil(STRETCH));
    }

    /// Cheapest shift of at most the canvas's rings along rows and columns.
    pub fn run(
        &mut self,
        canvas: &ExtendedLattice,
        detected_px: &[DVec2],
        expectations: impl Iterator<Item = Expectation>,
        size_px: (usize, usize),
        pitch_px: f64,
    ) -> Shifted {
        self.present.clear();
        self.present.extend(canvas.found.iter().map(|&m| u8::from(m != NONE)));
        self.add_unmatched(canvas, detected_px, AT_PLACE * pitch_px);
        self.add_up_costs(canvas, expectations, in_view(size_px, pitch_px));
        let most = canvas.rings as isize;
        // With and without the cost of the jump: both must give the same shift.
        let mut ranks = [Rank::default(); 2];
        let shifts = (-most..=most).flat_map(|row| (-most..=most).map(move |col| [row, col]));
        for (shift, &cost) in shifts.zip(&self.costs) {
            ranks[0].add(cost, shift);
            ranks[1].add(cost + surprise(canvas, shift, pitch_px), shift);
        }
        // Half a border row separates two shifts; a few false detections do not.
        let margin = (canvas.rows.min(canvas.cols) as u32 / 2).max(6);
        let clear = ranks.iter().all(|rank| rank.second - rank.best >= margin);
        // A best shift at the limit of the search range may be worse than one outside it.
        let inside = ranks[1].shift.iter().all(|along| along.abs() < most);
        let certain =
            clear && inside && ranks[0].shift == ranks[1].shift && self.on_edge(canvas) <= margin / 2;
        Shifted { shift: ranks[1].shift, certain }
    }

    /// Marks the nearest place of each unmatched detection as present.
    fn add_unmatched(&mut self, canvas: &ExtendedLattice, detected_px: &[DVec2], reach_px: f64) {
        self.taken.clear();
        self.taken.resize(detected_px.len(), false);
        for &m in canvas.found.iter().filter(|&&m| m != NONE) {
            self.taken[m as usize] = true;
        }
        if !self.taken.contains(&false) {
            return;
        }
        self.lay_stretches(canvas);
        for (&at, _) in detected_px.iter().zip(&self.taken).filter(|&(_, &taken)| !taken) {
            let mut nearest = (reach_px * reach_px, None);
            let about =
                |s: &&Stretch| at.cmpge(s.low_px - reach_px).all() && at.cmple(s.high_px + reach_px).all();
            for stretch in self.stretches.iter().filter(about) {
                for site in stretch.places.clone().filter(|&s| canvas.located[s]) {
                    let distance2 = canvas.position_px(site).distance_squared(at);
                    if distance2 < nearest.0 {
                        nearest = (distance2, Some(site));
                    }
                }
            }
            if let Some(site) = nearest.1 {
                self.present[site] = 1;
            }
        }
    }

    fn lay_stretches(&mut self, canvas: &ExtendedLattice) {
        self.stretches.clear();
        let width = canvas.width();
        for row in (0..canvas.found.len()).step_by(width) {
            for first in (row..row + width).step_by(STRETCH) {
                let places = first..(first + STRETCH).min(row + width);
                let (mut low_px, mut high_px) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
                for at in places.clone().filter(|&s| canvas.located[s]).map(|s| canvas.position_px(s)) {
                    (low_px, high_px) = (low_px.min(at), high_px.max(at));
                }
                self.stretches.push(Stretch { places, low_px, high_px });
            }
        }
    }

    /// Costs of all shifts, rows first: 1 for each missing marker, [`STRAY`] for each detection outside
    /// the lattice or where none was printed.
    fn add_up_costs(
        &mut self,
        canvas: &ExtendedLattice,
        expectations: impl Iterator<Item = Expectation>,
        in_view: impl Fn(DVec2) -> bool,
    ) {
        let (rows, cols, rings) = (canvas.rows, canvas.cols, canvas.rings);
        let (width, side) = (canvas.width(), 2 * rings + 1);
        self.empty.clear();
        self.empty.resize(self.present.len(), false);
        for site in (0..self.present.len()).filter(|&s| self.present[s] == 0) {
            self.empty[site] = canvas.located[site] && in_view(canvas.position_px(site));
        }
        self.sum_up(width);
        let Self { present, empty, before, costs, .. } = self;
        let shifts = || (0..side).flat_map(|row| (0..side).map(move |col| (row, col)));
        let [all, _] = before.last().copied().unwrap_or_default();
        costs.clear();
        costs.extend(shifts().map(|(row, col)| {
            // Sums over the places that the shifted lattice covers.
            let before = |row: usize, col: usize| before[row * (width + 1) + col];
            let (low, high) = (before(row, col), before(row + rows, col + cols));
            let (right, below) = (before(row, col + cols), before(row + rows, col));
            let [present, empty] = [0, 1].map(|k| high[k] + low[k] - right[k] - below[k]);
            STRAY * (all - present) + empty
        }));
        for (n, expectation) in expectations.enumerate().filter(|&(_, e)| e != Expectation::Present) {
            for ((row, col), cost) in shifts().zip(costs.iter_mut()) {
                let place = (n / cols + row) * width + n % cols + col;
                // It may be empty, and must be if none was printed.
                *cost -= u32::from(empty[place]);
                if expectation == Expectation::Absent {
                    *cost += STRAY * u32::from(present[place]);
                }
            }
        }
    }

    fn sum_up(&mut self, width: usize) {
        let Self { present, empty, before, .. } = self;
        before.clear();
        before.resize(width + 1, [0; 2]);
        for (present, empty) in present.chunks_exact(width).zip(empty.chunks_exact(width)) {
            let above = before.len() - width;
            before.push([0; 2]);
            let mut sums = [0; 2];
            for (col, (&present, &empty)) in present.iter().zip(empty).enumerate() {
                sums[0] += u32::from(present);
                sums[1] += u32::from(empty);
                let [above, above_empty] = before[above + col];
                before.push([above + sums[0], above_empty + sums[1]]);
            }
        }
    }

    /// Number of detections on the outermost ring: if there are any, the lattice may continue outside.
    fn on_edge(&self, canvas: &ExtendedLattice) -> u32 {
        let width = canvas.width();
        let line = |line: &[u8]| line.iter().map(|&p| u32::from(p)).sum::<u32>();
        let height = self.present.len() / width;
        self.present.chunks_exact(width).enumerate().fold(0, |sum, (row, places)| {
            sum + if row == 0 || row + 1 == height {
                line(places)
            } else {
                u32::from(places[0]) + u32::from(places[width - 1])
            }
        })
    }
}
