//! Errors of finding slip.

use crate::params::ParamsError;

/// Why slip cannot be found.
#[derive(Clone, Debug, PartialEq)]
pub enum SlipError {
    /// An invalid setting.
    Params(ParamsError),
    /// The markers do not fill whole rows.
    Lattice {
        /// Markers found.
        markers: usize,
        /// Markers from left to right.
        cols: usize,
    },
    /// Lists of different lengths.
    Lengths {
        /// Markers at rest.
        rest: usize,
        /// The length found.
        found: usize,
    },
}

impl core::fmt::Display for SlipError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Params(error) => error.fmt(f),
            Self::Lattice { markers, cols } => {
                write!(
                    f,
                    "{markers} markers do not fill rows of {cols}; give the number of columns of the print"
                )
            }
            Self::Lengths { rest, found } => write!(
                f,
                "a list has {found} entries, but there are {rest} markers at rest; give one for each marker"
            ),
        }
    }
}

impl core::error::Error for SlipError {}
