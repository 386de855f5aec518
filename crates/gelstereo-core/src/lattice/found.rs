//! The part of a lattice found in one frame.

use crate::math::DVec2;
use alloc::vec::Vec;

/// A place in the lattice, counted from the first row and column found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Place {
    /// Row, downwards from 0.
    pub row: i32,
    /// Column, to the right from 0.
    pub col: i32,
}

impl Place {
    pub(super) const fn new(row: i32, col: i32) -> Self {
        Self { row, col }
    }

    pub(super) const fn step(self, (rows, cols): (i32, i32)) -> Self {
        Self { row: self.row + rows, col: self.col + cols }
    }

    /// The place after reading columns as rows `quarter_turns` times: down becomes right, and right
    /// becomes up.
    #[must_use]
    pub const fn turned(self, quarter_turns: u8) -> Self {
        let Self { row, col } = self;
        match quarter_turns % 4 {
            0 => self,
            1 => Self { row: -col, col: row },
            2 => Self { row: -row, col: -col },
            _ => Self { row: col, col: -row },
        }
    }
}

/// One of the four outer rows and columns of what was found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Side {
    /// Markers placed in it.
    pub placed: usize,
    /// Places one step farther out that lie in the image, at least half a pitch from its border, without
    /// a detected marker.
    pub empty_beyond: usize,
    /// Whether the print ends here: at least half of the row is present, and at least two fifths of the
    /// next row would be visible if it were printed. Otherwise the lattice may continue outside the image
    /// or undetected.
    pub ends: bool,
}

/// The lattice found in one frame, up to its symmetry. The printed row of row 0 and the printed quarter
/// turn are determined by [`anchor`](super::anchor). Of the four turns, this is the one whose rows run
/// most nearly from left to right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundLattice {
    /// Place of each detection; `None` where it has no place or an ambiguous one.
    pub places: Vec<Option<Place>>,
    /// Rows found, from the first to the last with a marker.
    pub rows: usize,
    /// Columns found.
    pub cols: usize,
    /// Detections with a place.
    pub placed: usize,
    /// Upper, right, lower and left side.
    pub sides: [Side; 4],
    /// Mean step from a marker to the next one of its row, pixels.
    pub row_step_px: DVec2,
    /// Mean step from a marker to the next one of its column, pixels.
    pub col_step_px: DVec2,
    /// Median distance of neighbours, pixels.
    pub pitch_px: f64,
    /// Largest distance of a placed marker from its prediction by its neighbours, pitches. A slip by one
    /// place gives half a pitch or more.
    pub worst_pitches: f64,
    /// Detections that lost their place because their neighbours disagreed.
    pub dropped: usize,
}

impl FoundLattice {
    /// Detection at each place.
    #[must_use]
    pub fn sites(&self) -> Sites {
        let Self { rows, cols, .. } = *self;
        let mut detection = alloc::vec![None; rows * cols];
        for (m, place) in (0..).zip(&self.places) {
            if let Some(place) = place {
                detection[place.row as usize * cols + place.col as usize] = Some(m);
            }
        }
        Sites { rows, cols, detection, is_offset: false }
    }
}

/// The rows and columns of a [`FoundLattice`], and the detection at each of their places.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sites {
    /// Rows found.
    pub rows: usize,
    /// Columns found.
    pub cols: usize,
    /// Row by row.
    detection: Vec<Option<u32>>,
    /// Whether every second row is shifted by half a step.
    pub(super) is_offset: bool,
}

impl Sites {
    /// An empty set of sites.
    pub(super) fn empty(rows: usize, cols: usize) -> Self {
        Self { rows, cols, detection: alloc::vec![None; rows * cols], is_offset: false }
    }

    /// The same places with other detections.
    pub(super) fn map(&self, detection: impl Fn(usize) -> Option<usize>) -> Self {
        let one = |m: &Option<u32>| m.and_then(|m| detection(m as usize)).map(|m| m as u32);
        Self { detection: self.detection.iter().map(one).collect(), ..*self }
    }

    /// The same places after quarter turns, as in [`Place::turned`].
    pub(super) fn turned(&self, quarter_turns: u8) -> Self {
        let is_upright = quarter_turns.is_multiple_of(2);
        let (rows, cols) = if is_upright { (self.rows, self.cols) } else { (self.cols, self.rows) };
        let mut out = Self::empty(rows, cols);
        let far = Place::new(self.rows as i32 - 1, self.cols as i32 - 1).turned(quarter_turns);
        for place in self.places() {
            let to = place.turned(quarter_turns);
            out.set(to.step((-far.row.min(0), -far.col.min(0))), self.at(place));
        }
        out
    }

    /// Sets or clears the detection at an existing place.
    pub(super) fn set(&mut self, place: Place, detection: Option<usize>) {
        self.detection[place.row as usize * self.cols + place.col as usize] = detection.map(|m| m as u32);
    }

    /// Detection at a place, if any.
    #[must_use]
    pub fn at(&self, place: Place) -> Option<usize> {
        let (row, col) = (usize::try_from(place.row).ok()?, usize::try_from(place.col).ok()?);
        let inside = row < self.rows && col < self.cols;
        if inside { self.detection[row * self.cols + col].map(|m| m as usize) } else { None }
    }
}
