//! The rectangle of a lattice that is labelled: which rows and columns are printed, and which are seen whole.

use super::LabelError;
use super::found::{Place, Sites};
use crate::params::LatticeParams;
use core::cmp::Reverse;
use core::ops::Range;

/// A border row or column of at least this length with a single detection consists of false detections.
/// So does any row with at most one place in twelve detected. In a shorter row, one detection may be the
/// remainder of a printed row.
const LONG: usize = 8;

/// A run of so many undetected places makes a border row or column incomplete.
const GAP: usize = 3;

/// Smallest share of the labelled markers that is kept when border rows and columns are left out. Of a
/// lattice turned by 45 degrees, the largest rectangle in a view of 16 to 9 has 0.28 of them.
const MIN_KEPT: f64 = 0.25;

/// What to do with border rows and columns that are seen in part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PartialBorders {
    /// The frame is refused, unless `lattice.rows` and `lattice.cols` decide. Two views of one lattice that
    /// each leave out other columns would be labelled unlike.
    Refuse,
    /// They are left out where that gives a valid lattice.
    LeaveOut,
}

/// A rectangle of places; ends are exclusive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    top: usize,
    bottom: usize,
    left: usize,
    right: usize,
}

/// The rectangle chosen, and the rows and columns beside it that were left out: above, right, below, left.
pub(super) struct Chosen {
    pub window: Window,
    pub left_out: [usize; 4],
}

impl Window {
    /// First row.
    pub const fn top(&self) -> usize {
        self.top
    }

    pub const fn rows(&self) -> usize {
        self.bottom - self.top
    }

    pub const fn cols(&self) -> usize {
        self.right - self.left
    }

    pub fn places(&self) -> impl Iterator<Item = Place> {
        let Self { top, bottom, left, right } = *self;
        (top..bottom).flat_map(move |r| (left..right).map(move |c| Place::new(r as i32, c as i32)))
    }

    /// Selects the printed rows and columns.
    pub fn choose(
        found: &Sites,
        whole_markers: usize,
        lattice: &LatticeParams,
        borders: PartialBorders,
    ) -> Result<Chosen, LabelError> {
        let whole = Self::without_specks(found, whole_markers, lattice)?;
        let upright = whole.with_settings(found, lattice, [lattice.rows, lattice.cols]);
        // After a quarter turn, the columns are the rows, except in a hexagonal print.
        let aside = [lattice.cols, lattice.rows];
        let window = upright.or_else(|error| {
            let turned = (!found.is_offset).then(|| whole.with_settings(found, lattice, aside));
            turned.and_then(Result::ok).ok_or(error)
        });
        let window = match window {
            Err(error) if borders == PartialBorders::LeaveOut => whole
                .best_seen(found, lattice, [lattice.rows, lattice.cols])
                .or_else(|| if found.is_offset { None } else { whole.best_seen(found, lattice, aside) })
                .ok_or(error),
            window => window,
        }?;
        Ok(Chosen { window, left_out: whole.beside(&window) })
    }

    /// Removes outer rows and columns that consist of false detections or of cut markers.
    fn without_specks(
        found: &Sites,
        whole_markers: usize,
        lattice: &LatticeParams,
    ) -> Result<Self, LabelError> {
        let counted = lattice.rows.is_none() && lattice.cols.is_none();
        let mut whole = Self { top: 0, bottom: found.rows, left: 0, right: found.cols };
        let is_none = |within: &Self, side: usize| {
            within.line(found, side).is_of_specks()
                || (counted && within.side(side).is_cut(found, whole_markers))
        };
        while let Some(side) = (0..4).find(|&side| is_none(&whole, side)) {
            whole = whole.without(side);
            if whole.rows().min(whole.cols()) < 3 {
                return Err(whole.error(found, lattice));
            }
        }
        Ok(whole)
    }

    /// The rectangle of the configured rows and columns in which most markers are seen; of equals, the one
    /// nearest to the middle. Where a number is not configured, incomplete outer rows or columns are left
    /// out.
    fn best_seen(&self, found: &Sites, lattice: &LatticeParams, printed: [Option<usize>; 2]) -> Option<Self> {
        let counted = printed.map(|printed| printed.is_none());
        let kept = |axis: usize| printed[axis].unwrap_or(self.sides()[axis]);
        let (rows, cols) = (kept(0), kept(1));
        let (down, right) = (self.rows().checked_sub(rows)?, self.cols().checked_sub(cols)?);
        let mut best = None;
        for (top, left) in (0..=down).flat_map(|down| (0..=right).map(move |right| (down, right))) {
            let (top, left) = (self.top + top, self.left + left);
            let window = Self { top, bottom: top + rows, left, right: left + cols };
            let Some(window) = window.with_whole_borders(found, lattice, counted) else { continue };
            let key = (window.seen(found), Reverse(window.off_middle(self)));
            if best.is_none_or(|(most, _)| key > most) {
                best = Some((key, window));
            }
        }
        let ((seen, _), window) = best?;
        let enough = counted != [true; 2] || seen as f64 >= MIN_KEPT * self.seen(found) as f64;
        enough.then_some(window)
    }

    /// Removes incomplete outer rows (if the first is `counted`) and columns (the second), the least seen
    /// first, until no more are missing than allowed.
    fn with_whole_borders(
        mut self,
        found: &Sites,
        lattice: &LatticeParams,
        counted: [bool; 2],
    ) -> Option<Self> {
        loop {
            let enough = self.is_enough(found, lattice);
            let share = |side: usize| {
                let line = self.line(found, side);
                let incomplete = line.lacks_half() || (!enough && self.side(side).has_gap(found));
                (counted[side % 2] && incomplete).then(|| line.seen as f64 / line.length as f64)
            };
            let least = (0..4)
                .filter_map(|side| Some((share(side)?, side)))
                .min_by(|(one, _), (other, _)| one.total_cmp(other));
            let Some((_, side)) = least else { return enough.then_some(self) };
            self = self.without(side);
            if self.rows().min(self.cols()) < 3 {
                return None;
            }
        }
    }

    /// Whether no more markers are missing than the settings allow.
    fn is_enough(&self, found: &Sites, lattice: &LatticeParams) -> bool {
        let size = self.rows() * self.cols();
        let enough = self.seen(found) + lattice.max_missing(size) + lattice.missing.len() >= size;
        self.rows().min(self.cols()) >= 3 && enough
    }

    /// Whether a row or column lacks an end, or several neighbours in a run.
    fn has_gap(&self, found: &Sites) -> bool {
        let (mut run, mut longest, mut is_first, mut last) = (0, 0, true, false);
        for place in self.places() {
            let seen = found.at(place).is_some();
            if is_first && !seen {
                return true;
            }
            run = if seen { 0 } else { run + 1 };
            (longest, is_first, last) = (run.max(longest), false, seen);
        }
        !last || longest >= GAP
    }

    fn seen(&self, found: &Sites) -> usize {
        self.places().filter(|&place| found.at(place).is_some()).count()
    }

    /// Distance between the middles of two rectangles, in half rows and columns.
    const fn off_middle(&self, other: &Self) -> usize {
        (self.top + self.bottom).abs_diff(other.top + other.bottom)
            + (self.left + self.right).abs_diff(other.left + other.right)
    }

    /// Rows and columns of these ranges beside this rectangle: above, right, below, left.
    pub fn beside_in(&self, rows: &Range<i32>, cols: &Range<i32>) -> [usize; 4] {
        let count = |from: usize, to: usize| to.saturating_sub(from);
        let [top, bottom, left, right] =
            [rows.start, rows.end, cols.start, cols.end].map(|n| n.max(0) as usize);
        [count(top, self.top), count(self.right, right), count(self.bottom, bottom), count(left, self.left)]
    }

    /// Rows and columns of this rectangle beside a smaller one: above, right, below, left.
    const fn beside(&self, inner: &Self) -> [usize; 4] {
        [inner.top - self.top, self.right - inner.right, self.bottom - inner.bottom, inner.left - self.left]
    }

    /// Removes outer rows and columns that exceed the configured numbers, if these are set.
    fn with_settings(
        mut self,
        found: &Sites,
        lattice: &LatticeParams,
        printed: [Option<usize>; 2],
    ) -> Result<Self, LabelError> {
        for (axis, printed) in printed.into_iter().enumerate() {
            while printed.is_some_and(|n| n < self.sides()[axis]) {
                let [low, high] = [self.line(found, axis), self.line(found, axis + 2)];
                let side = if low.seen < high.seen { axis } else { axis + 2 };
                let (few, more) = (low.seen.min(high.seen), low.seen.max(high.seen));
                if 2 * few >= low.length || 4 * (more - few) < low.length {
                    return Err(self.error(found, lattice));
                }
                self = self.without(side);
            }
            if printed.is_some_and(|n| n != self.sides()[axis]) {
                return Err(self.error(found, lattice));
            }
            for side in [axis, axis + 2].into_iter().filter(|_| printed.is_none()) {
                let line = self.line(found, side);
                if line.lacks_half() {
                    let Line { seen, length } = line;
                    let (rows, cols) = (self.rows(), self.cols());
                    return Err(LabelError::Border { side, seen, length, rows, cols });
                }
            }
        }
        if self.is_enough(found, lattice) { Ok(self) } else { Err(self.error(found, lattice)) }
    }

    const fn sides(&self) -> [usize; 2] {
        [self.rows(), self.cols()]
    }

    /// An outer row or column: upper, left, lower, right.
    const fn side(&self, side: usize) -> Self {
        let Self { top, bottom, left, right } = *self;
        match side {
            0 => Self { bottom: top + 1, ..*self },
            1 => Self { right: left + 1, ..*self },
            2 => Self { top: bottom - 1, ..*self },
            _ => Self { left: right - 1, ..*self },
        }
    }

    fn line(&self, found: &Sites, side: usize) -> Line {
        let line = self.side(side);
        // Every second place of a column is beside the print where rows have a marker less in turn.
        let is_shared = found.is_offset && side % 2 == 1;
        let length = line.rows() * line.cols();
        Line { seen: line.seen(found), length: if is_shared { length.div_ceil(2) } else { length } }
    }

    /// Whether none of its markers is whole.
    fn is_cut(&self, found: &Sites, whole_markers: usize) -> bool {
        self.places().all(|p| found.at(p).is_none_or(|m| m >= whole_markers))
    }

    const fn without(mut self, side: usize) -> Self {
        match side {
            0 => self.top += 1,
            1 => self.left += 1,
            2 => self.bottom -= 1,
            _ => self.right -= 1,
        }
        self
    }

    fn error(&self, found: &Sites, lattice: &LatticeParams) -> LabelError {
        let (rows, cols) = (self.rows(), self.cols());
        LabelError::Shape {
            rows,
            cols,
            labelled: self.seen(found),
            expected_rows: lattice.rows,
            expected_cols: lattice.cols,
            max_missing: lattice.max_missing(rows * cols),
        }
    }
}

/// An outer row or column: upper, left, lower, right.
struct Line {
    seen: usize,
    length: usize,
}

impl Line {
    /// Whether fewer than half of its markers are seen.
    const fn lacks_half(&self) -> bool {
        2 * self.seen < self.length
    }

    const fn is_of_specks(&self) -> bool {
        self.seen == 0 || (self.seen == 1 && self.length >= LONG) || 12 * self.seen <= self.length
    }
}
