//! Printed row and column of the places of a frame.

use super::found::{FoundLattice, Place};
use crate::math::{DVec2, atan2, round, sqrt};

/// Shifts tried on either side of the most likely one.
const REACH: i32 = 3;

/// Largest angle between found and predicted rows, beyond the nearest quarter turn, degrees. At 45
/// degrees the turn of a square lattice is ambiguous.
const MAX_TURN_DEG: f64 = 35.0;

/// Largest root mean square distance from the prediction, pitches, and smallest ratio of the second best
/// shift's distance to the best one's. At half a pitch, two shifts are equally near.
const MAX_OFF: f64 = 0.35;
const CLEARLY: f64 = 1.8;

/// Cap on a single distance, pitches: contact moves some markers far.
const CAP: f64 = 1.5;

/// Evidence that an anchor is unique.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorEvidence {
    /// Whether rows and columns follow from the ends of the print alone, independently of the prediction.
    pub by_extents: bool,
    /// Root mean square distance of the markers from their predictions, pitches, each capped at 1.5.
    /// Infinite without a prediction.
    pub off_pitches: f64,
    /// The same for the second best of the shifts that the extents allow; infinite when there is none.
    pub second_pitches: f64,
}

/// Turn and shift from places of a [`FoundLattice`] to labels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Quarter turns, as in [`Place::turned`].
    pub quarter_turns: u8,
    /// Rows and columns added after the turn.
    pub shift: (i32, i32),
    /// Evidence for this anchor.
    pub evidence: AnchorEvidence,
}

impl Anchor {
    /// Label `row * cols + col` of a place; `None` outside the print.
    #[must_use]
    pub fn label(&self, place: Place, rows: usize, cols: usize) -> Option<usize> {
        let place = place.turned(self.quarter_turns).step(self.shift);
        let (row, col) = (usize::try_from(place.row).ok()?, usize::try_from(place.col).ok()?);
        (row < rows && col < cols).then_some(row * cols + col)
    }
}

/// Finds the printed row and column of each place of `found`, or `None` where they are ambiguous.
///
/// `detected_px` are the detections from which `found` was made. `rows` and `cols` are those printed.
/// `predicted_px` holds the expected position of each marker (`row * cols + col`), or is empty without
/// history.
///
/// With a prediction, the turn is the one that aligns the rows with the predicted ones within 35 degrees.
/// Without one it is 0, the upright turn; if rows and columns differ in number, it is the upright one of
/// the turns that fit.
///
/// Rows are unique, independently of the prediction, in two cases: both of their ends are in view and as
/// many were found as are printed, or every printed marker was found. So a frame that moved by more than
/// half a pitch can still be anchored. Otherwise one shift must be clearly nearest to the prediction (the
/// second best at least 1.8 times as far off) and agree with the ends in view.
///
/// Linear in the markers, without allocation.
#[must_use]
pub fn anchor(
    found: &FoundLattice,
    detected_px: &[DVec2],
    rows: usize,
    cols: usize,
    predicted_px: &[DVec2],
) -> Option<Anchor> {
    let valid = rows > 1 && cols > 1 && found.places.len() == detected_px.len() && found.pitch_px > 0.0;
    let history = predicted_px.len() == rows.checked_mul(cols)?;
    if !valid || !(history || predicted_px.is_empty()) {
        return None;
    }
    let quarter_turns =
        if history { turn_as(found, rows, cols, predicted_px)? } else { turn_that_fits(found, rows, cols)? };
    let axes = axes(found, quarter_turns);
    let frame = Frame { found, detected_px, rows, cols, predicted_px, quarter_turns };
    // If every place has a marker, no other shift is possible, whatever the image border hides.
    let complete = found.placed == rows * cols;
    let [by_rows, by_cols] =
        [(axes[0], rows), (axes[1], cols)].map(|(axis, printed)| axis.shift(printed, complete));
    if let (Some(row), Some(col)) = (by_rows, by_cols) {
        let off_pitches = if history { frame.off_pitches((row, col)) } else { f64::INFINITY };
        let evidence = AnchorEvidence { by_extents: true, off_pitches, second_pitches: f64::INFINITY };
        return Some(Anchor { quarter_turns, shift: (row, col), evidence });
    }
    if !history {
        return None;
    }
    let (shift, evidence) = frame.nearest_shift(by_rows, by_cols)?;
    let agrees = axes[0].agrees(shift.0, rows) && axes[1].agrees(shift.1, cols);
    agrees.then_some(Anchor { quarter_turns, shift, evidence })
}

/// Range of rows or columns of the places after the turn, and whether each end is an end of the print.
#[derive(Clone, Copy)]
struct Axis {
    low: i32,
    high: i32,
    low_ends: bool,
    high_ends: bool,
}

impl Axis {
    /// Shift implied by both ends in view, or by a complete set of markers, if the extent equals the
    /// printed one.
    fn shift(self, printed: usize, complete: bool) -> Option<i32> {
        let ends = complete || (self.low_ends && self.high_ends);
        let fits = ends && (self.high - self.low + 1) as usize == printed;
        fits.then_some(-self.low)
    }

    /// Whether a shift agrees with the ends in view and keeps every place inside the print.
    fn agrees(self, shift: i32, printed: usize) -> bool {
        let (low, high, last) = (self.low + shift, self.high + shift, printed as i32 - 1);
        low >= 0 && high <= last && (!self.low_ends || low == 0) && (!self.high_ends || high == last)
    }
}

/// Rows and columns after a turn.
fn axes(found: &FoundLattice, quarter_turns: u8) -> [Axis; 2] {
    let corner = Place { row: found.rows as i32 - 1, col: found.cols as i32 - 1 }.turned(quarter_turns);
    // Upper, right, lower, left: a quarter turn makes the right side the upper one.
    let ends = |side: usize| found.sides[(side + usize::from(quarter_turns)) % 4].ends;
    let axis = |c: i32, low_ends, high_ends| Axis { low: c.min(0), high: c.max(0), low_ends, high_ends };
    [axis(corner.row, ends(0), ends(2)), axis(corner.col, ends(3), ends(1))]
}

/// Quarter turn that aligns the rows with the predicted ones.
fn turn_as(found: &FoundLattice, rows: usize, cols: usize, predicted_px: &[DVec2]) -> Option<u8> {
    let ends = (0..rows)
        .fold(DVec2::ZERO, |sum, r| sum + predicted_px[r * cols + cols - 1] - predicted_px[r * cols]);
    let columns =
        (0..cols).fold(DVec2::ZERO, |sum, c| sum + predicted_px[(rows - 1) * cols + c] - predicted_px[c]);
    let angle = frame_angle_deg(ends, columns) - frame_angle_deg(found.row_step_px, found.col_step_px);
    let turns = round(angle / 90.0);
    ((angle - 90.0 * turns).abs() < MAX_TURN_DEG).then(|| (turns as i32).rem_euclid(4) as u8)
}

/// Angle of a lattice, averaged over rows and columns, which shear turns in opposite directions.
fn frame_angle_deg(row: DVec2, col: DVec2) -> f64 {
    let (a, b) = (row.normalize_or_zero(), col.normalize_or_zero());
    atan2(a.y - b.x, a.x + b.y).to_degrees()
}

/// Smallest turn that gives the printed numbers of rows and columns.
fn turn_that_fits(found: &FoundLattice, rows: usize, cols: usize) -> Option<u8> {
    if (found.rows, found.cols) == (rows, cols) {
        Some(0)
    } else if (found.rows, found.cols) == (cols, rows) {
        Some(super::rest::sideways(found.row_step_px, found.col_step_px))
    } else {
        None
    }
}

struct Frame<'a> {
    found: &'a FoundLattice,
    detected_px: &'a [DVec2],
    rows: usize,
    cols: usize,
    predicted_px: &'a [DVec2],
    quarter_turns: u8,
}

impl Frame<'_> {
    /// Shift nearest to the prediction, if it is clearly nearer than all others that the extents allow.
    fn nearest_shift(
        &self,
        by_rows: Option<i32>,
        by_cols: Option<i32>,
    ) -> Option<((i32, i32), AnchorEvidence)> {
        let likely = self.likely_shift()?;
        let around =
            |fixed: Option<i32>, likely: i32| fixed.map_or(likely - REACH..=likely + REACH, |n| n..=n);
        let (mut best, mut second) = ((f64::INFINITY, (0, 0)), f64::INFINITY);
        for row in around(by_rows, likely.0) {
            for col in around(by_cols, likely.1) {
                let off = self.off_pitches((row, col));
                if off < best.0 {
                    second = best.0;
                    best = (off, (row, col));
                } else {
                    second = second.min(off);
                }
            }
        }
        let clear = best.0 < MAX_OFF && second > CLEARLY * best.0;
        let evidence = AnchorEvidence { by_extents: false, off_pitches: best.0, second_pitches: second };
        clear.then_some((best.1, evidence))
    }

    /// Label of the prediction nearest to the central detected marker, minus that marker's place.
    fn likely_shift(&self) -> Option<(i32, i32)> {
        let placed = || self.found.places.iter().enumerate().filter_map(|(m, p)| Some((m, (*p)?)));
        let middle = placed().fold(DVec2::ZERO, |sum, (m, _)| sum + self.detected_px[m])
            / self.found.placed.max(1) as f64;
        let nearer = |a: DVec2, b: DVec2| a.distance_squared(middle).total_cmp(&b.distance_squared(middle));
        let (m, place) = placed().min_by(|a, b| nearer(self.detected_px[a.0], self.detected_px[b.0]))?;
        let here = self.detected_px[m];
        let off = |n: usize| self.predicted_px[n].distance_squared(here);
        let label = (0..self.predicted_px.len()).min_by(|&a, &b| off(a).total_cmp(&off(b)))?;
        let place = place.turned(self.quarter_turns);
        Some(((label / self.cols) as i32 - place.row, (label % self.cols) as i32 - place.col))
    }

    /// Root mean square distance from the prediction; a marker outside the print counts as an outlier at
    /// the cap.
    fn off_pitches(&self, shift: (i32, i32)) -> f64 {
        let per_px2 = 1.0 / (self.found.pitch_px * self.found.pitch_px);
        let evidence = AnchorEvidence { by_extents: false, off_pitches: 0.0, second_pitches: 0.0 };
        let anchor = Anchor { quarter_turns: self.quarter_turns, shift, evidence };
        let (mut sum, mut count) = (0.0, 0.0);
        for (&at, place) in self.detected_px.iter().zip(&self.found.places) {
            let Some(place) = *place else { continue };
            let label = anchor.label(place, self.rows, self.cols);
            let off2 = label.map_or(f64::INFINITY, |n| self.predicted_px[n].distance_squared(at) * per_px2);
            // A non-finite prediction also counts as the cap.
            sum += if off2 < CAP * CAP { off2 } else { CAP * CAP };
            count += 1.0;
        }
        if count > 0.0 { sqrt(sum / count) } else { f64::INFINITY }
    }
}
