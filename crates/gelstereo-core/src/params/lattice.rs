//! The printed lattice.

use super::{ParamsError, Pitch, check};
use alloc::vec::Vec;

/// How the markers of a print stand beside each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum PrintLayout {
    /// Rows and columns at right angles, of one pitch or of two.
    #[default]
    Square,
    /// Every marker has six neighbours at one distance. Rows are lines of nearest neighbours. Of their three
    /// directions, it is the one whose rows fill the print, and rows run from left to right, or downwards in
    /// an upright print. Every second row is shifted by half a pitch, and columns count the places of a row.
    Hexagonal,
}

/// The printed lattice. Its rows and columns are counted in the rest frame; settings of them are only
/// checked.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct LatticeParams {
    /// How the markers stand beside each other; a rest frame of another layout is refused. Default: `square`.
    /// Change it for a print whose markers have six neighbours; those need
    /// `label.method = lattice`.
    pub layout: PrintLayout,
    /// Markers from top to bottom; a rest frame with another number is refused. Valid: 2 to 1000 markers.
    /// Default: none, they are counted. Set it where the print is known, so that a covered border is found
    /// out.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub rows: Option<usize>,
    /// Markers from left to right; a rest frame with another number is refused. Valid: 2 to 1000 markers.
    /// Default: none, they are counted. Set it where the print is known, so that a covered border is found
    /// out.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub cols: Option<usize>,
    /// Distance between nearest neighbours, or `[x, y]` of a rectangular print: along a row, and along a
    /// column. Valid: 0.001 to 1000 mm. Default: `0.9` mm. Change it to the pitch of the gel's print.
    pub pitch_mm: Pitch,
    /// Radius of the dots, for `triangulate.disc_bias = corrected`. Valid: 0.0001 to 500 mm, below half of
    /// `pitch_mm`. Default: none, it is told from the dots' areas in the rest frame. Set it where the print's
    /// radius is known.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub dot_radius_mm: Option<f64>,
    /// Depth of the print below the gel's skin, on the side of the part. The points of a frame are those of
    /// the skin over the markers, where the part is. Valid: 0 to 100 mm. Default: `0` mm, the print is the
    /// skin. Set it to what the maker states: without it, parts seem
    /// to lie this much nearer to the cameras.
    pub depth_mm: f64,
    /// Standard deviation of `depth_mm`. All points of a frame share the error along the gel's normal, so
    /// that it is part of the covariance of poses, and of points only where the gel is stretched or tilted.
    /// Valid: 0 to 100 mm. Default: `0` mm. Set it to what `gelstereo setup` states.
    pub depth_sigma_mm: f64,
    /// Share of the printed markers that may be missing in the rest frame; they are filled in from their
    /// neighbours, as the paper does for the corner that its print lacks (Fig. 4). Valid: 0 to 0.5. Default:
    /// `0.01`, 6 of 625. Raise it for a worn print; lower it so that a bad rest frame is refused sooner.
    pub max_missing_share: f64,
    /// Row and column, from 0, of markers that were never printed. They are filled in, do not count as
    /// missing, and tell which way a lattice is turned. Valid: 0 to 999, within the lattice. Default: none.
    /// Set it where the print has holes on purpose.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Vec::is_empty"))]
    pub missing: Vec<[usize; 2]>,
}

impl Default for LatticeParams {
    fn default() -> Self {
        Self {
            layout: PrintLayout::Square,
            rows: None,
            cols: None,
            pitch_mm: Pitch::square(0.9),
            dot_radius_mm: None,
            depth_mm: 0.0,
            depth_sigma_mm: 0.0,
            max_missing_share: 0.01,
            missing: Vec::new(),
        }
    }
}

impl LatticeParams {
    /// How many of so many markers may be missing, rounded.
    #[must_use]
    pub fn max_missing(&self, markers: usize) -> usize {
        crate::math::round(self.max_missing_share * markers as f64) as usize
    }

    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        for (name, side) in [("lattice.rows", self.rows), ("lattice.cols", self.cols)] {
            if let Some(n) = side {
                check((2..=1000).contains(&n), name, n as f64, "2 to 1000 markers")?;
            }
        }
        for &[row, col] in &self.missing {
            for (side, place) in [(self.rows, row), (self.cols, col)] {
                let valid = place < side.unwrap_or(1000);
                check(
                    valid,
                    "lattice.missing",
                    place as f64,
                    "rows and columns of the lattice, counted from 0",
                )?;
            }
        }
        if self.layout == PrintLayout::Hexagonal && self.pitch_mm.x_mm != self.pitch_mm.y_mm {
            let (setting, required) =
                ("lattice.layout = \"hexagonal\"", "one lattice.pitch_mm, the distance of nearest markers");
            return Err(ParamsError::Requires { setting, required });
        }
        for pitch_mm in self.pitch_mm.axes_mm() {
            check((1e-3..=1e3).contains(&pitch_mm), "lattice.pitch_mm", pitch_mm, "0.001 to 1000 mm")?;
        }
        if let Some(radius) = self.dot_radius_mm {
            let valid = radius >= 1e-4 && 2.0 * radius < self.pitch_mm.x_mm.min(self.pitch_mm.y_mm);
            check(valid, "lattice.dot_radius_mm", radius, "0.0001 mm to below half of lattice.pitch_mm")?;
        }
        for (name, mm) in
            [("lattice.depth_mm", self.depth_mm), ("lattice.depth_sigma_mm", self.depth_sigma_mm)]
        {
            check((0.0..=100.0).contains(&mm), name, mm, "0 to 100 mm")?;
        }
        let share = self.max_missing_share;
        check((0.0..=0.5).contains(&share), "lattice.max_missing_share", share, "from 0 to 0.5")
    }
}
