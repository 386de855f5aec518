//! What was found of a lattice in one frame.

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

    /// The place when the lattice is read with its columns as rows, so many times: what was down is then right, and what
    /// was right is up.
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
    /// Places one step farther out that lie in the image, half a pitch from its border or more, where no marker was
    /// found.
    pub empty_beyond: usize,
    /// Whether the print ends here: at least half of the row is there, and two fifths of the next one would be seen if it were
    /// printed.
    /// Otherwise the lattice may go on, out of the image or unseen.
    pub ends: bool,
}

/// The lattice found in one frame, up to its symmetry: which of the printed rows is row 0 here, and which of the four
/// quarter turns is the printed one, [`anchor`](super::anchor) tells. Of the four turns this is the one whose rows run most
/// nearly from left to right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundLattice {
    /// Place of each detection; none where it belongs to no place or to none with certainty.
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
    /// Largest distance of a placed marker from where its neighbours say, in pitches; one that slipped by a place is off
    /// by half a pitch or more.
    pub worst_pitches: f64,
    /// Detections that lost their place because their neighbours disagreed.
    pub dropped: usize,
}

impl FoundLattice {
    /// Which detection stands at each place.
    #[must_use]
    pub fn sites(&self) -> Sites {
        let Self { rows, cols, .. } = *self;
        let mut detection = alloc::vec![None; rows * cols];
        for (m, place) in (0..).zip(&self.places) {
            if let Some(place) = place {
                detection[place.row as usize * cols + place.col as usize] = Some(m);
            }
        }
        Sites { rows, cols, detection }
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
}

impl Sites {
    /// So many rows and columns, without a detection.
    pub(super) fn empty(rows: usize, cols: usize) -> Self {
        Self { rows, cols, detection: alloc::vec![None; rows * cols] }
    }

    /// Puts a detection, or none, at a place that there is.
    pub(super) fn set(&mut self, place: Place, detection: Option<usize>) {
        self.detection[place.row as usize * self.cols + place.col as usize] = detection.map(|m| m as u32);
    }

    /// The detection at a place, if one was found there.
    #[must_use]
    pub fn at(&self, place: Place) -> Option<usize> {
        let (row, col) = (usize::try_from(place.row).ok()?, usize::try_from(place.col).ok()?);
        let inside = row < self.rows && col < self.cols;
        if inside { self.detection[row * self.cols + col].map(|m| m as usize) } else { None }
    }
}
