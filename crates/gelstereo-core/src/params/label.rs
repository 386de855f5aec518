//! Row and column of every marker.

use super::{ParamsError, check};

/// How rows and columns are kept after the rest frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum LabelMethod {
    /// Foresight sort of every frame (the paper, Algorithm 1): exact to about 5 degrees of lattice rotation.
    #[default]
    Foresight,
    /// A marker keeps its row and column through its track as long as that is certain: matches agree with
    /// their neighbours, and the lattice's border tells motions by a whole pitch. Otherwise it is held.
    Lattice,
}

/// Row and column of every marker.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct LabelParams {
    /// How rows and columns are kept after the rest frame. Default: `foresight`. Keep `lattice`, the safest,
    /// except to compare with the paper.
    pub method: LabelMethod,
    /// l of Algorithm 1: markers of one row are at least this far apart in x. Valid: 0.001 to 0.999 pitches.
    /// Default: `1/3` pitch. Raise it for a lattice that is turned in the image.
    pub tolerance_pitches: f64,
}

impl Default for LabelParams {
    fn default() -> Self {
        Self { method: LabelMethod::Foresight, tolerance_pitches: 1.0 / 3.0 }
    }
}

impl LabelParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let l = self.tolerance_pitches;
        check((1e-3..=0.999).contains(&l), "label.tolerance_pitches", l, "0.001 to 0.999 pitches")
    }
}
