//! Errors of force estimation.

use super::compliance::ComplianceError;
use crate::params::ParamsError;

/// Why forces cannot be estimated.
#[derive(Clone, Debug, PartialEq)]
pub enum ForceError {
    /// An invalid setting, or `force.method = none`.
    Params(ParamsError),
    /// The markers do not fill whole rows, or there are fewer than two rows or columns.
    Lattice {
        /// Markers found.
        markers: usize,
        /// Markers from left to right.
        cols: usize,
    },
    /// The lattice is not square: the influence of its cells is not known.
    Pitch {
        /// Distances of neighbours along a row and down a column, mm.
        found_mm: [f64; 2],
    },
    /// The compliance matrix is not of this sensor.
    Compliance(ComplianceError),
    /// A seen marker has a position that is NaN or infinite.
    NotFinite {
        /// Which marker.
        index: usize,
    },
    /// Lists of different lengths.
    Lengths {
        /// Markers at rest.
        rest: usize,
        /// The length found.
        found: usize,
    },
}

impl core::fmt::Display for ForceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Params(error) => error.fmt(f),
            Self::Lattice { markers, cols } => write!(
                f,
                "{markers} markers in rows of {cols} are no lattice; forces need at least two whole rows and \
                 two columns"
            ),
            Self::Pitch { found_mm: [x, y] } => write!(
                f,
                "the lattice's pitch is {x:.3} mm along rows and {y:.3} mm along columns; forces need a \
                 square lattice, with pitches that differ by less than 5 %: set force.method = \"none\""
            ),
            Self::Compliance(error) => error.fmt(f),
            Self::NotFinite { index } => write!(
                f,
                "marker {index} is seen, but has a coordinate that is NaN or infinite; give markers that are \
                 not seen as lost"
            ),
            Self::Lengths { rest, found } => write!(
                f,
                "a list has {found} entries, but there are {rest} markers at rest; give one for each marker"
            ),
        }
    }
}

impl core::error::Error for ForceError {}
