//! By how many whole pitches a lattice has moved, told by its border.

use super::extended_lattice::{ExtendedLattice, NONE};
use crate::math::DVec2;
use alloc::vec::Vec;
use core::ops::Range;

/// What a marker outside the lattice, or at a place that was never printed, costs against one that is not found.
const STRAY: u32 = 3;

/// Within so many pitches of the image's border a marker may be cut off: neither presence nor absence is expected.
const BORDER_PITCHES: f64 = 0.6;

/// A detection that belongs to no place is seen at one so near, in pitches.
const AT_PLACE: f64 = 0.5;

/// What is known of a marker beforehand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expectation {
    /// Found lately.
    Present,
    /// Hidden for some time.
    Unknown,
    /// Never found: not printed.
    Absent,
}

/// Compares the shifts that a labelled patch can have.
///
/// The inside of a lattice looks the same after a step of a pitch; what differs is its border, and places
/// without a print. A shift costs 1 for each marker that was expected in view and is not there, and [`STRAY`] for each
/// detection where nothing can be, besides what the jump costs. The best is certain when all others cost clearly more.
///
/// Every detection counts, whether it was matched or not: whether it is this marker or another one, or two in one, it is no
/// empty gel. Matches alone would be biased, since a border row in poor sight is matched less easily where it is not expected.
///
/// A sum over a shifted lattice is a difference of sums from the first place on; what is missing, misprinted or without a
/// place is little.
#[derive(Clone, Debug, Default)]
pub(super) struct PitchShift {
    taken: Vec<bool>,
    present: Vec<u8>,
    /// Places in view that show nothing.
    empty: Vec<bool>,
    /// How many are present, and how many empty, above and to the left of each place, itself not counted; a row and a column more
    /// than places.
    before: Vec<[u32; 2]>,
    /// Cost of each shift, rows first.
    costs: Vec<u32>,
    stretches: Vec<Stretch>,
}

/// Places in a row, and where they lie.
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

/// What a jump costs: up to a row of markers, from a pitch on. A border that disappears at once may have moved on, or be
/// hidden.
fn surprise(canvas: &ExtendedLattice, shift: [isize; 2], pitch_px: f64) -> u32 {
    let side = canvas.rows.min(canvas.cols) as f64;
    let middle = canvas.rows / 2 * canvas.cols + canvas.cols / 2;
    let (Some(from), Some(to)) = (canvas.site(middle, [0, 0]), canvas.site(middle, shift)) else { return 0 };
    let moved_px = canvas.position_px(to).distance(canvas.predicted_px[from]);
    (side * (moved_px / pitch_px).min(1.0)) as u32
}

/// The cheapest shift and what the next one costs.
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

/// The answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shifted {
    /// Marker (row, col) stands at place (row, col) + shift.
    pub shift: [isize; 2],
    /// No other shift comes near.
    pub certain: bool,
}

impl PitchShift {
    /// Makes room for a lattice with so many rows and columns on a canvas with up to so many rings, and for so many detections.
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

    /// The cheapest shift of at most the canvas's rings along rows and columns.
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
        // With what a jump costs and without: both must give the same answer.
        let mut ranks = [Rank::default(); 2];
        let shifts = (-most..=most).flat_map(|row| (-most..=most).map(move |col| [row, col]));
        for (shift, &cost) in shifts.zip(&self.costs) {
            ranks[0].add(cost, shift);
            ranks[1].add(cost + surprise(canvas, shift, pitch_px), shift);
        }
        // Half a border row tells two shifts apart; a few specks do not.
        let margin = (canvas.rows.min(canvas.cols) as u32 / 2).max(6);
        let clear = ranks.iter().all(|rank| rank.second - rank.best >= margin);
        // The best of all tried, at the end of what was tried, may be second to one that was not.
        let inside = ranks[1].shift.iter().all(|along| along.abs() < most);
        let certain =
            clear && inside && ranks[0].shift == ranks[1].shift && self.on_edge(canvas) <= margin / 2;
        Shifted { shift: ranks[1].shift, certain }
    }

    /// Something is present where a detection without a place lies.
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

    /// Of all shifts, rows first: 1 for each marker that is missing, [`STRAY`] for each detection that is none of the lattice's or
    /// where none was printed.
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
            // Of the places that the lattice covers, moved so far.
            let before = |row: usize, col: usize| before[row * (width + 1) + col];
            let (low, high) = (before(row, col), before(row + rows, col + cols));
            let (right, below) = (before(row, col + cols), before(row + rows, col));
            let [present, empty] = [0, 1].map(|k| high[k] + low[k] - right[k] - below[k]);
            STRAY * (all - present) + empty
        }));
        for (n, expectation) in expectations.enumerate().filter(|&(_, e)| e != Expectation::Present) {
            for ((row, col), cost) in shifts().zip(costs.iter_mut()) {
                let place = (n / cols + row) * width + n % cols + col;
                // It may be empty; and must be, if none was printed.
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

    /// Detections on the outermost ring: where there are some, the lattice may go on beyond.
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
