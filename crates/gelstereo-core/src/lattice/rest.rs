//! The rest lattice: counts rows and columns, labels every marker and fills in missing ones.

use super::layout::Layout;
use super::view_lattice::ViewLattice;
use super::window::PartialBorders;
use super::{LabelError, LatticeFinder, RestLattice};
use crate::detect::Markers;
use crate::math::{DVec2, atan2};
use crate::params::{LatticeParams, PrintLayout};
use alloc::vec::Vec;

/// Counts the rows and columns of a frame, labels it, and fills in up to `lattice.max_missing_share` of
/// its markers where none was detected. The frame should be undisturbed, as later frames are compared
/// with it; a frame under contact is labelled as well.
///
/// The lattice is that of [`LatticeFinder`]. A border row counts if at least half of it is detected. It
/// is discarded as false detections if it has a single marker, or one in twelve. In between,
/// `lattice.rows` and `lattice.cols` decide. Without them, border rows and columns that are seen in part
/// are left out, the least seen first, until no more markers are missing than allowed:
/// [`RestLattice::left_out`] counts them. With fewer rows or columns set than are seen, the rectangle with
/// the most markers is labelled; of equals, the one in the middle.
///
/// So the lattice may be wider than the field of view. A pipeline of two views leaves none out, as its views
/// might then differ by a column.
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
    let asked = Asked { lattice, tolerance_pitches, borders: PartialBorders::LeaveOut, other: None };
    label_all(finder, detected_px, detected_px.len(), &asked)
        .map_err(|error| named(error, detected_px, lattice.layout))
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
    let finder = &mut LatticeFinder::default();
    match rest_lattice_by(finder, detected, lattice, tolerance_pitches, None) {
        Err(LabelError::Border { .. } | LabelError::Shape { .. }) => {
            rest_lattice(&detected.centres_px, lattice, tolerance_pitches)
        }
        labelled => labelled,
    }
}

/// As [`rest_lattice_of`], reusing the memory of a finder. No border row or column that is seen in part is
/// left out. With another view's lattice, rows and columns are turned as there.
pub(crate) fn rest_lattice_by(
    finder: &mut LatticeFinder,
    detected: &Markers,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
    other: Option<&RestLattice>,
) -> Result<RestLattice, LabelError> {
    let whole = &detected.centres_px;
    let asked = Asked { lattice, tolerance_pitches, borders: PartialBorders::Refuse, other };
    let without =
        label_all(finder, whole, whole.len(), &asked).map_err(|error| named(error, whole, lattice.layout));
    if detected.cut.is_empty()
        || !matches!(without, Err(LabelError::Border { .. } | LabelError::Shape { .. }))
    {
        return without;
    }
    let all_px: Vec<DVec2> =
        whole.iter().copied().chain(detected.cut.iter().map(|cut| cut.centre_px)).collect();
    // If cut markers do not help, the error of the whole markers is the clearer one.
    label_all(finder, &all_px, whole.len(), &asked).or(without)
}

/// Labels detections. The first `whole` are whole markers; the others only show that a marker exists.
fn label_all(
    finder: &mut LatticeFinder,
    detected_px: &[DVec2],
    whole: usize,
    asked: &Asked<'_>,
) -> Result<RestLattice, LabelError> {
    let Asked { lattice, tolerance_pitches, borders, other } = *asked;
    let is_hexagonal = lattice.layout == PrintLayout::Hexagonal;
    let rows = other.filter(|_| is_hexagonal).map(|other| other.directions()[0]);
    let detected_px = detected_px.to_vec();
    let view = ViewLattice::find(finder, detected_px, whole, lattice.layout, tolerance_pitches, rows)?;
    let rest = view.label(lattice, tolerance_pitches, borders)?;
    match other {
        Some(_) if is_hexagonal => Ok(rest),
        Some(other) => turn_as_printed(&rest, lattice).map(|rest| rest.turned_like(other)),
        None => turn_as_printed(&rest, lattice),
    }
}

/// How a frame is to be labelled.
#[derive(Clone, Copy)]
struct Asked<'a> {
    lattice: &'a LatticeParams,
    tolerance_pitches: f64,
    borders: PartialBorders,
    /// Lattice of the other view.
    other: Option<&'a RestLattice>,
}

/// Names the layout of markers that form no square lattice.
fn named(error: LabelError, detected_px: &[DVec2], expected: PrintLayout) -> LabelError {
    let layout = match error {
        LabelError::NoLattice { .. } | LabelError::Torn { .. } => Layout::of(detected_px),
        _ => None,
    };
    let other = layout.filter(|layout| !layout.is(expected));
    other.map_or(error, |layout| LabelError::Layout { found: detected_px.len(), layout, expected })
}

/// Quarter turns that make columns rows. Of the two directions, the one nearer to left to right is taken.
/// If both are equally near, to 5 degrees, rows run from top to bottom, so that noise does not decide.
pub(super) fn sideways(row_step: DVec2, col_step: DVec2) -> u8 {
    // Direction of the columns without shear.
    let across = col_step.normalize_or_zero() + row_step.perp().normalize_or_zero();
    if across.x > -0.087 * across.length() { 1 } else { 3 }
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
    // Rows of a hexagonal print are no columns.
    let all = [0, aside, (aside + 2) % 4, 2];
    let turns = if lattice.layout == PrintLayout::Hexagonal { &[0, 2][..] } else { &all[..] };
    let mut error = LabelError::NoLattice { found: rest.detection.len() };
    for turns in turns.iter().filter(|turns| fits(turns)) {
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
            // After a quarter turn, the right side is the upper one.
            left_out: core::array::from_fn(|side| self.left_out[(side + usize::from(quarter_turns)) % 4]),
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
