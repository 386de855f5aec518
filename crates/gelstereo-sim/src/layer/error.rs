//! Errors of a layer, a grid or their inputs.

/// Why a contact cannot be solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LayerError {
    /// A number is outside its range.
    Invalid {
        /// Name of the parameter.
        name: &'static str,
        /// Value found.
        found: f64,
        /// Valid values.
        valid: &'static str,
    },
    /// A field and the grid have different numbers of cells.
    Cells {
        /// Numbers found.
        found: usize,
        /// Cells of the grid.
        cells: usize,
    },
    /// The caller stopped the work ([`gelstereo_core::stop`]).
    Stopped,
}

impl core::fmt::Display for LayerError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Stopped => gelstereo_core::stop::Stopped.fmt(f),
            Self::Invalid { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::Cells { found, cells } => {
                write!(
                    f,
                    "a field has {found} numbers, but the grid has {cells} cells; give one for each, row \
                    after row"
                )
            }
        }
    }
}

impl core::error::Error for LayerError {}

impl LayerError {
    pub(crate) fn check(ok: bool, name: &'static str, found: f64, valid: &'static str) -> Result<(), Self> {
        if ok { Ok(()) } else { Err(Self::Invalid { name, found, valid }) }
    }
}
