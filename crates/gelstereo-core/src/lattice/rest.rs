//! The rest lattice: counts rows and columns, labels every marker and fills in missing ones.

use super::beyond::with_lines_beyond;
use super::fill::Partial;
use super::found::{FoundLattice, Place, Sites};
use super::{LabelError, LatticeFinder, RestLattice, check_regular};
use crate::detect::Markers;
use crate::math::{DVec2, atan2};
use crate::params::LatticeParams;
use crate::spatial::Grid;
use alloc::vec::Vec;

/// A border row or column of at least this length with a single detection consists of false detections.
/// So does any row with at most one place in twelve detected. In a shorter row, one detection may be the
/// remainder of a printed row.
const LONG: usize = 8;

/// Counts the rows and columns of a frame, labels it, and fills in up to `lattice.max_missing_share` of
/// its markers where none was detected. The frame should be undisturbed, as later frames are compared
/// with it; a frame under contact is labelled as well.
///
/// The lattice is that of [`LatticeFinder`]. A border row counts if at least half of it is detected. It
/// is discarded as false detections if it has a single marker, or one in twelve. In between,
/// `lattice.rows` and `lattice.cols` decide; without them the frame is refused.
///
/// The labels can be turned in four ways (two where rows and columns are set and differ). The turn whose
/// rows run most nearly from left to right is taken, except that `lattice.missing` has priority: a turn
/// with a marker where none was printed is wrong. At 45 degrees two turns are equally near;
/// [`RestLattice::turned_like`] aligns the labels of one view with those of another.
///
/// # Errors
/// [`LabelError`] with what was found: a lattice whose rows or columns differ from the settings, if set,
/// one with too many gaps, or one with fewer than 3 x 3 markers.
pub fn rest_lattice(
    detected_px: &[DVec2],
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let finder = &mut LatticeFinder::default();
    label_all(finder, detected_px, detected_px.len(), lattice, tolerance_pitches)
}

/// As [`rest_lattice`], but if the whole markers form no valid lattice, markers cut by the image border
/// are added as evidence that their rows and columns are printed. The centre of a cut marker is not
/// measured: it is filled in and held until the marker is seen whole.
///
/// A border row without any whole marker counts only if `lattice.rows` or `lattice.cols` requires it: it
/// contributes no point.
///
/// # Errors
/// As [`rest_lattice`].
pub fn rest_lattice_of(
    detected: &Markers,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    rest_lattice_by(&mut LatticeFinder::default(), detected, lattice, tolerance_pitches)
}

/// As [`rest_lattice_of`], reusing the memory of a finder.
pub(crate) fn rest_lattice_by(
    finder: &mut LatticeFinder,
    detected: &Markers,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let whole = &detected.centres_px;
    let without = label_all(finder, whole, whole.len(), lattice, tolerance_pitches);
    if detected.cut.is_empty()
        || !matches!(without, Err(LabelError::Border { .. } | LabelError::Shape { .. }))
    {
        return without;
    }
    let all_px: Vec<DVec2> =
        whole.iter().copied().chain(detected.cut.iter().map(|cut| cut.centre_px)).collect();
    // If cut markers do not help, the error of the whole markers is the clearer one.
    label_all(finder, &all_px, whole.len(), lattice, tolerance_pitches).or(without)
}

/// Labels detections. The first `whole` are whole markers; the others only show that a marker exists.
fn label_all(
    finder: &mut LatticeFinder,
    detected_px: &[DVec2],
    whole: usize,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let mut found = FoundLattice::default();
    finder.run_with_specks(detected_px, &mut found)?;
    let most_px = tolerance_pitches * found.pitch_px;
    let sites = with_lines_beyond(found.sites(), detected_px, most_px);
    let window = Window::choose(&sites, whole, lattice)?;
    let (rows, cols) = (window.rows(), window.cols());
    let taken: Vec<Option<u32>> = window.places().map(|p| sites.at(p).map(|m| m as u32)).collect();
    let detection: Vec<Option<u32>> = taken.iter().map(|d| d.filter(|&m| (m as usize) < whole)).collect();
    let at = detection.iter().map(|d| d.map(|m| detected_px[m as usize])).collect();
    let partial = Partial { rows, cols, at };
    check_regular(rows, cols, most_px, |r, c| partial.at[r * cols + c])?;
    let positions_px = partial.filled().ok_or(LabelError::NoLattice { found: detected_px.len() })?;
    check_gaps(detected_px, &positions_px, &taken, most_px, cols)?;
    let rest = RestLattice { rows, cols, positions_px, detection, pitch_px: found.pitch_px };
    turn_as_printed(&rest, lattice)
}

/// Quarter turns that make columns rows. Of the two directions, the one nearer to left to right is taken.
/// If both are equally near, to 5 degrees, rows run from top to bottom, so that noise does not decide.
pub(super) fn sideways(row_step: DVec2, col_step: DVec2) -> u8 {
    // Direction of the columns without shear.
    let across = col_step.normalize_or_zero() + row_step.perp().normalize_or_zero();
    if across.x > -0.087 * across.length() { 1 } else { 3 }
}

/// A rectangle of places; ends are exclusive.
#[derive(Clone, Copy, Debug)]
struct Window {
    top: usize,
    bottom: usize,
    left: usize,
    right: usize,
}

impl Window {
    const fn rows(&self) -> usize {
        self.bottom - self.top
    }

    const fn cols(&self) -> usize {
        self.right - self.left
    }

    fn places(&self) -> impl Iterator<Item = Place> {
        let Self { top, bottom, left, right } = *self;
        (top..bottom).flat_map(move |r| (left..right).map(move |c| Place::new(r as i32, c as i32)))
    }

    /// Selects the printed rows and columns.
    fn choose(found: &Sites, whole_markers: usize, lattice: &LatticeParams) -> Result<Self, LabelError> {
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
        let upright = whole.with_settings(found, lattice, [lattice.rows, lattice.cols]);
        // After a quarter turn, the columns are the rows.
        upright.or_else(|error| {
            whole.with_settings(found, lattice, [lattice.cols, lattice.rows]).map_err(|_| error)
        })
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
                let Line { seen, length } = self.line(found, side);
                if 2 * seen < length {
                    let (rows, cols) = (self.rows(), self.cols());
                    return Err(LabelError::Border { side, seen, length, rows, cols });
                }
            }
        }
        let size = self.rows() * self.cols();
        let labelled = self.places().filter(|&p| found.at(p).is_some()).count();
        let enough = labelled + lattice.max_missing(size) + lattice.missing.len() >= size;
        if self.rows().min(self.cols()) < 3 || !enough { Err(self.error(found, lattice)) } else { Ok(self) }
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
        let seen = line.places().filter(|&p| found.at(p).is_some()).count();
        Line { seen, length: line.rows() * line.cols() }
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
            labelled: self.places().filter(|&p| found.at(p).is_some()).count(),
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
    const fn is_of_specks(&self) -> bool {
        self.seen == 0 || (self.seen == 1 && self.length >= LONG) || 12 * self.seen <= self.length
    }
}

/// Refuses a filled-in marker if an unlabelled detection lies within the tolerance of it: the labels
/// around it have slipped. (The midpoint of two merged dots is half a pitch from both.)
fn check_gaps(
    points: &[DVec2],
    positions_px: &[DVec2],
    detection: &[Option<u32>],
    most_px: f64,
    cols: usize,
) -> Result<(), LabelError> {
    if detection.iter().all(Option::is_some) {
        return Ok(());
    }
    let mut taken = alloc::vec![false; points.len()];
    for &m in detection.iter().flatten() {
        taken[m as usize] = true;
    }
    let mut grid = Grid::default();
    grid.build(points, most_px);
    for n in (0..detection.len()).filter(|&n| detection[n].is_none()) {
        if let Some(m) = grid.nearest(points, positions_px[n], most_px, |m| !taken[m]) {
            let off_px = positions_px[n].distance(points[m]);
            return Err(LabelError::Slipped { row: n / cols, col: n % cols, off_px });
        }
    }
    Ok(())
}

/// The turn that the settings allow and whose rows run most nearly from left to right.
fn turn_as_printed(rest: &RestLattice, lattice: &LatticeParams) -> Result<RestLattice, LabelError> {
    let fits = |turns: &u8| {
        let (rows, cols) =
            if turns.is_multiple_of(2) { (rest.rows, rest.cols) } else { (rest.cols, rest.rows) };
        lattice.rows.is_none_or(|n| n == rows) && lattice.cols.is_none_or(|n| n == cols)
    };
    let [row_step, col_step] = rest.directions();
    let aside = sideways(row_step, col_step);
    let mut error = LabelError::NoLattice { found: rest.detection.len() };
    for turns in [0, aside, (aside + 2) % 4, 2].iter().filter(|turns| fits(turns)) {
        let turned = rest.turned(*turns);
        let printed_anyway = lattice.missing.iter().find(|&&[row, col]| {
            row >= turned.rows || col >= turned.cols || turned.detection[row * turned.cols + col].is_some()
        });
        match printed_anyway {
            None => return Ok(turned),
            Some(&[row, col]) => {
                error = LabelError::NeverPrinted { row, col, rows: rest.rows, cols: rest.cols }
            }
        }
    }
    Err(error)
}

impl RestLattice {
    /// The same lattice after reading columns as rows `quarter_turns` times: down becomes right, and
    /// right becomes up.
    #[must_use]
    pub fn turned(&self, quarter_turns: u8) -> Self {
        if quarter_turns.is_multiple_of(4) {
            return self.clone();
        }
        let (rows, cols) =
            if quarter_turns.is_multiple_of(2) { (self.rows, self.cols) } else { (self.cols, self.rows) };
        let (last_row, last_col) = (self.rows.saturating_sub(1), self.cols.saturating_sub(1));
        let old = |n: usize| {
            let (row, col) = (n / cols, n % cols);
            let (r, c) = match quarter_turns % 4 {
                0 => (row, col),
                1 => (col, last_col - row),
                2 => (last_row - row, last_col - col),
                _ => (last_row - col, row),
            };
            r * self.cols + c
        };
        let order = || (0..rows * cols).map(old);
        Self {
            rows,
            cols,
            positions_px: order().map(|n| self.positions_px[n]).collect(),
            detection: order().map(|n| self.detection[n]).collect(),
            pitch_px: self.pitch_px,
        }
    }

    /// Mean direction of the rows from their first marker to their last, and of the columns; not unit
    /// vectors.
    #[must_use]
    pub fn directions(&self) -> [DVec2; 2] {
        let at = |r: usize, c: usize| self.positions_px.get(r * self.cols + c).copied().unwrap_or_default();
        let (last_row, last_col) = (self.rows.saturating_sub(1), self.cols.saturating_sub(1));
        let row = (0..self.rows).fold(DVec2::ZERO, |sum, r| sum + at(r, last_col) - at(r, 0));
        let col = (0..self.cols).fold(DVec2::ZERO, |sum, c| sum + at(last_row, c) - at(0, c));
        [row, col]
    }

    /// The lattice after the quarter turns that best align its rows with those of `other`. The two views
    /// of one print get the same labels, even at 45 degrees.
    #[must_use]
    pub fn turned_like(&self, other: &Self) -> Self {
        let angle = |[row, col]: [DVec2; 2]| {
            let (a, b) = (row.normalize_or_zero(), col.normalize_or_zero());
            atan2(a.y - b.x, a.x + b.y).to_degrees()
        };
        let off = angle(other.directions()) - angle(self.directions());
        self.turned((crate::math::round(off / 90.0) as i32).rem_euclid(4) as u8)
    }
}
