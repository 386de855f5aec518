//! Row and column of every marker: foresight sort (Algorithm 1) and the rest lattice.
//!
//! Both return an error rather than wrong labels: in a returned lattice, every marker agrees with its
//! neighbours.

mod anchor;
mod beyond;
mod bounds;
mod cells;
mod common;
mod consistency;
mod described;
mod detection_grid;
mod extrapolate;
mod fill;
mod finder;
mod foresight;
mod found;
mod hexagonal;
mod hexagonal_rest;
mod layout;
mod rest;
mod seed;
mod topology;
mod view_lattice;
mod window;

pub use anchor::{Anchor, AnchorEvidence, anchor};
pub(crate) use common::{SharedCell, Shift, TwoViews};
pub use described::{LayoutKind, PrintDescription};
pub use finder::LatticeFinder;
pub use foresight::foresight_sort;
pub use found::{FoundLattice, Place, Side, Sites};
pub use layout::Layout;
pub(crate) use rest::rest_lattice_by;
pub use rest::{rest_lattice, rest_lattice_of};
pub use topology::Topology;
pub(crate) use topology::{Offset, STEPS};
pub(crate) use view_lattice::ViewLattice;

use crate::math::DVec2;
use crate::params::PrintLayout;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

/// Why markers could not be labelled.
#[derive(Clone, Debug, PartialEq)]
pub enum LabelError {
    /// Too few or too many markers.
    Count {
        /// Markers found.
        found: usize,
        /// Markers of the lattice.
        expected: usize,
        /// How many of them may be missing.
        max_missing: usize,
    },
    /// A position is NaN or infinite.
    NotFinite {
        /// Which position.
        index: usize,
    },
    /// A row of the foresight sort did not fill.
    RowNotFilled {
        /// Which row, from the top.
        row: usize,
        /// Markers found for it.
        found: usize,
        /// Markers of a row.
        expected: usize,
    },
    /// No marker has the regular neighbours of a lattice.
    NoLattice {
        /// Markers found.
        found: usize,
    },
    /// The markers are laid out in another way than `lattice.layout`.
    Layout {
        /// Markers found.
        found: usize,
        /// How they are laid out.
        layout: Layout,
        /// How they should be.
        expected: PrintLayout,
    },
    /// The lattice found differs from the configured one.
    Shape {
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
        /// Markers found on it.
        labelled: usize,
        /// Rows configured, if any.
        expected_rows: Option<usize>,
        /// Columns configured, if any.
        expected_cols: Option<usize>,
        /// How many markers may be missing.
        max_missing: usize,
    },
    /// Neighbours disagree in many places.
    Torn {
        /// Markers whose neighbours agree.
        placed: usize,
        /// Markers that lost their place.
        dropped: usize,
    },
    /// A border row or column that may or may not be printed.
    Border {
        /// Upper row, left column, lower row, right column.
        side: usize,
        /// Markers found in it.
        seen: usize,
        /// Markers it would have.
        length: usize,
        /// Rows found, including this one.
        rows: usize,
        /// Columns found, including this one.
        cols: usize,
    },
    /// No turn of the lattice leaves all places of `lattice.missing` empty.
    NeverPrinted {
        /// Row of a place where a marker was found.
        row: usize,
        /// Its column.
        col: usize,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// A marker disagrees with its neighbours.
    Irregular {
        /// Its row.
        row: usize,
        /// Its column.
        col: usize,
        /// Distance from its prediction by its neighbours, pixels; infinite where the lattice folds over.
        off_px: f64,
        /// Largest valid one.
        most_px: f64,
    },
    /// A marker was filled in although an unlabelled detection lies there: labels have slipped.
    Slipped {
        /// Its row.
        row: usize,
        /// Its column.
        col: usize,
        /// Distance of the detection from the filled-in position, pixels.
        off_px: f64,
    },
}

impl core::fmt::Display for LabelError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Count { found, expected, max_missing } => {
                write!(
                    f,
                    "found {found} markers; the lattice has {expected}, of which {max_missing} may be missing"
                )
            }
            Self::NotFinite { index } => write!(f, "the position of marker {index} is NaN or infinite"),
            Self::RowNotFilled { row, found, expected } => write!(
                f,
                "row {row} filled with {found} of {expected} markers: the lattice is turned or deformed too \
                 far for the foresight sort; label.method = \"lattice\" keeps labels through tracks"
            ),
            Self::NoLattice { found } => write!(
                f,
                "none of the {found} markers found has four neighbours as in a lattice; check \
                 detect.threshold_levels and detect.polarity"
            ),
            Self::Layout { found, layout, expected } => {
                let hint = match (expected, layout) {
                    (PrintLayout::Square, Layout::Hexagonal) => "set lattice.layout = \"hexagonal\"",
                    (PrintLayout::Square, _) => "rows and columns are those of a square lattice of dots",
                    (PrintLayout::Hexagonal, _) => "lattice.layout is \"hexagonal\"",
                };
                write!(f, "found {found} markers, but {layout}; {hint}")
            }
            Self::Torn { placed, dropped } => write!(
                f,
                "{dropped} markers do not stand where their neighbours say, and {placed} do: at most a tenth \
                 may disagree; the gel is folded, or much is detected that is no marker"
            ),
            Self::Border { side, seen, length, rows, cols } => write!(
                f,
                "found {rows} rows x {cols} columns, but of the {} only {seen} of {length} markers: it may \
                 be specks or a row of the print that the view cuts; set lattice.rows and lattice.cols, or \
                 let both cameras see the whole lattice",
                ["upper row", "left column", "lower row", "right column"][side % 4]
            ),
            Self::NeverPrinted { row, col, rows, cols } => write!(
                f,
                "found {rows} rows x {cols} columns, and whichever way they are turned a marker where \
                 lattice.missing says that none was printed, last at row {row}, column {col}; correct \
                 lattice.missing"
            ),
            Self::Shape { rows, cols, labelled, expected_rows, expected_cols, max_missing } => {
                write!(f, "found a lattice of {rows} rows x {cols} columns with {labelled} markers")?;
                for (name, expected) in [("lattice.rows", expected_rows), ("lattice.cols", expected_cols)] {
                    if let Some(expected) = expected {
                        write!(f, "; {name} is {expected}")?;
                    }
                }
                write!(f, "; at least 3 x 3 are needed, and {max_missing} may be missing")
            }
            Self::Irregular { row, col, off_px, most_px } if off_px.is_finite() => {
                let (off, most) = told_apart(off_px, most_px);
                write!(
                    f,
                    "the marker labelled row {row}, column {col} lies {off} px from where its neighbours \
                     say; at most {most} px is a lattice"
                )
            }
            Self::Slipped { row, col, off_px } => write!(
                f,
                "no marker was labelled row {row}, column {col}, but one without a label stands {off_px:.1} \
                 px from there: the labels around it have slipped; take the rest frame while nothing touches \
                 the gel"
            ),
            Self::Irregular { row, col, .. } => {
                write!(f, "the lattice folds over at the marker labelled row {row}, column {col}")
            }
        }
    }
}

impl core::error::Error for LabelError {}

/// Two different numbers, with as many decimals as are needed to distinguish them.
fn told_apart(one: f64, other: f64) -> (String, String) {
    let with = |decimals: usize| (format!("{one:.decimals$}"), format!("{other:.decimals$}"));
    (1..=DECIMALS).map(with).find(|(a, b)| a != b).unwrap_or_else(|| (format!("{one}"), format!("{other}")))
}

/// Most decimals of a pixel to try before all are printed.
const DECIMALS: usize = 6;

/// The rest lattice, complete.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestLattice {
    /// Markers from top to bottom.
    pub rows: usize,
    /// Markers from left to right.
    pub cols: usize,
    /// Position of marker `row * cols + col`, pixels.
    pub positions_px: Vec<DVec2>,
    /// Its detection index; `None` where it was filled in from its neighbours (never printed or not
    /// detected).
    pub detection: Vec<Option<u32>>,
    /// Median distance of neighbours, pixels.
    pub pitch_px: f64,
    /// Rows or columns with markers that were left out at the upper, right, lower and left side: those seen
    /// in part, and those beyond `lattice.rows` and `lattice.cols`. Rows of a single speck do not count.
    pub left_out: [usize; 4],
}

/// Checks that a labelling is a lattice: no cell folds over, and every marker lies within `most_px` of
/// the midpoint of its left and right, and of its upper and lower, neighbours. `at(row, col)` may be
/// unknown; such markers are not checked.
///
/// A marker with its neighbour's label, or a row that slips into the next one, is at least half a pitch
/// off.
fn check_regular(
    rows: usize,
    cols: usize,
    most_px: f64,
    at: impl Fn(usize, usize) -> Option<DVec2>,
) -> Result<(), LabelError> {
    let off = |row: usize, col: usize, before: Option<DVec2>, after: Option<DVec2>| {
        let (Some(here), Some(before), Some(after)) = (at(row, col), before, after) else {
            return Ok(());
        };
        let off_px = here.distance((before + after) * 0.5);
        if off_px <= most_px { Ok(()) } else { Err(LabelError::Irregular { row, col, off_px, most_px }) }
    };
    for row in 0..rows {
        for col in 0..cols {
            if row > 0 && row + 1 < rows {
                off(row, col, at(row - 1, col), at(row + 1, col))?;
            }
            if col > 0 && col + 1 < cols {
                off(row, col, at(row, col - 1), at(row, col + 1))?;
            }
            if row + 1 < rows
                && col + 1 < cols
                && folds([at(row, col), at(row, col + 1), at(row + 1, col + 1), at(row + 1, col)])
            {
                return Err(LabelError::Irregular { row, col, off_px: f64::INFINITY, most_px });
            }
        }
    }
    Ok(())
}

/// Whether a cell, given in the order of its outline, has a reversed orientation at one of its corners.
fn folds(corners: [Option<DVec2>; 4]) -> bool {
    if let [Some(a), Some(b), Some(c), Some(d)] = corners {
        let sides = [b - a, c - b, d - c, a - d];
        return (0..4).any(|k| sides[k].perp_dot(sides[(k + 1) % 4]) <= 0.0);
    }
    (0..4).any(|k| match (corners[(k + 3) % 4], corners[k], corners[(k + 1) % 4]) {
        (Some(before), Some(here), Some(after)) => (after - here).perp_dot(before - here) <= 0.0,
        _ => false,
    })
}
