//! Motion of every marker under a unit traction on every cell, as computed beforehand by finite elements.

use crate::layer::{FreeSides, Layer};
use crate::math::abs;
use alloc::vec::Vec;

/// Largest difference of a lattice's pitch from that of the matrix, relative: forces are then wrong by at
/// most this share, because the force of a displacement is proportional to all lengths of a gel.
const SAME_PITCH: f64 = 0.01;
/// The same for settings that are typed in, whose digits may have been rounded.
const SAME_NUMBER: f64 = 1e-3;
/// Most rows and columns: a matrix of 64 by 64 cells takes 151 MB.
const MOST: usize = 64;

/// Which gel a [`Compliance`] is of: a rectangular block, bonded at its back, with the lattice in its middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComplianceGel {
    /// Markers from top to bottom.
    pub rows: usize,
    /// Markers from left to right.
    pub cols: usize,
    /// Distance of neighbours along rows and columns.
    pub pitch_mm: f64,
    /// Thickness and Poisson's ratio.
    pub layer: Layer,
    /// Gel beyond the outermost markers, along rows and along columns.
    pub rim_mm: [f64; 2],
}

/// Why a matrix cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ComplianceError {
    /// Not the bytes of a compliance matrix.
    NotACompliance,
    /// A version that this program does not read.
    Version {
        /// The version found.
        found: u32,
    },
    /// The bytes are cut off or were changed.
    Damaged,
    /// A number of the gel is out of its range.
    Gel {
        /// Which.
        name: &'static str,
        /// The value found.
        found: f64,
        /// The range.
        valid: &'static str,
    },
    /// Not one entry for each pair of components, each cell, and each marker of a quarter.
    Length {
        /// Entries found.
        found: usize,
        /// Entries of a lattice of this size.
        expected: usize,
    },
    /// An entry is NaN or infinite.
    NotFinite {
        /// Which entry.
        index: usize,
    },
    /// The matrix is of another gel or lattice.
    Differs {
        /// In what.
        name: &'static str,
        /// The sensor's.
        found: f64,
        /// The matrix's.
        expected: f64,
    },
}

impl core::fmt::Display for ComplianceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        const REMEDY: &str = "make one with gelstereo.force.compute_compliance";
        match self {
            Self::NotACompliance => write!(f, "these are not the bytes of a compliance matrix; {REMEDY}"),
            Self::Version { found } => {
                write!(
                    f,
                    "the compliance matrix has version {found}; valid is {}: {REMEDY}",
                    Compliance::VERSION
                )
            }
            Self::Damaged => write!(f, "the compliance matrix is damaged or cut off; {REMEDY}"),
            Self::Gel { name, found, valid } => {
                write!(f, "{name} of the compliance matrix is {found}; valid is {valid}")
            }
            Self::Length { found, expected } => write!(
                f,
                "the compliance matrix has {found} entries; a lattice of this size has {expected}, nine for \
                 each cell and each marker of a quarter"
            ),
            Self::NotFinite { index } => {
                write!(f, "entry {index} of the compliance matrix is NaN or infinite; {REMEDY}")
            }
            Self::Differs { name, found, expected } => write!(
                f,
                "{name} is {found}, but the compliance matrix is of a gel where it is {expected}; {REMEDY} \
                 for this sensor"
            ),
        }
    }
}

impl core::error::Error for ComplianceError {}

/// Motion of the markers of a finite gel under uniform tractions on the cells around them, for a Young's
/// modulus of 1.
///
/// Gel and lattice have the same two planes of symmetry, so that the markers of one quarter are enough.
#[derive(Clone, Debug, PartialEq)]
pub struct Compliance {
    gel: ComplianceGel,
    values: Vec<f32>,
}

impl Compliance {
    /// Of its bytes.
    pub const VERSION: u32 = 1;

    /// From motion, mm: for each marker of the first quarter (the first half of the rows and of the columns,
    /// and the middle ones), row by row; for each cell, row by row; motion into the layer, along rows and
    /// along columns; under a pressure, and tractions along rows and along columns.
    ///
    /// # Errors
    /// [`ComplianceError::Gel`], [`ComplianceError::Length`] or [`ComplianceError::NotFinite`].
    pub fn new(gel: ComplianceGel, values: Vec<f32>) -> Result<Self, ComplianceError> {
        gel.check()?;
        let (found, expected) = (values.len(), gel.entries());
        if found != expected {
            return Err(ComplianceError::Length { found, expected });
        }
        match values.iter().position(|value| !value.is_finite()) {
            Some(index) => Err(ComplianceError::NotFinite { index }),
            None => Ok(Self { gel, values }),
        }
    }

    /// The gel.
    #[must_use]
    pub const fn gel(&self) -> &ComplianceGel {
        &self.gel
    }

    /// Entries, in the order of [`Self::new`].
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Motion of a marker (row, column) into the layer, along rows and along columns (rows of the answer)
    /// under a pressure and under tractions along rows and along columns of a cell (row, column).
    #[must_use]
    pub fn effect(&self, marker: (usize, usize), cell: (usize, usize)) -> [[f64; 3]; 3] {
        let ComplianceGel { rows, cols, .. } = self.gel;
        let is_below = marker.0 >= rows.div_ceil(2);
        let is_right = marker.1 >= cols.div_ceil(2);
        let folded = |(row, col)| {
            (if is_below { rows - 1 - row } else { row }, if is_right { cols - 1 - col } else { col })
        };
        let ((row, col), (cell_row, cell_col)) = (folded(marker), folded(cell));
        let at = ((row * cols.div_ceil(2) + col) * rows + cell_row) * cols + cell_col;
        let values = &self.values[9 * at..][..9];
        // A mirror image reverses what is across the mirror, of motion and of traction.
        let signs = [1.0, if is_right { -1.0 } else { 1.0 }, if is_below { -1.0 } else { 1.0 }];
        core::array::from_fn(|i| {
            core::array::from_fn(|k| f64::from(values[3 * i + k]) * (signs[i] * signs[k]))
        })
    }

    /// Whether the matrix is of this lattice and gel. Without `rim_mm`, any sides are right.
    ///
    /// # Errors
    /// [`ComplianceError::Differs`].
    pub fn check_fit(
        &self,
        counts: [usize; 2],
        pitch_mm: f64,
        layer: &Layer,
        rim_mm: Option<f64>,
    ) -> Result<(), ComplianceError> {
        let own = &self.gel;
        let near = |found: f64, expected: f64, share: f64| abs(found - expected) <= share * expected;
        let pairs = [
            ("the number of columns", counts[0] as f64, own.cols as f64, 0.0),
            ("the number of rows", counts[1] as f64, own.rows as f64, 0.0),
            ("the lattice's pitch in mm", pitch_mm, own.pitch_mm, SAME_PITCH),
            ("force.thickness_mm", layer.thickness_mm, own.layer.thickness_mm, SAME_NUMBER),
            ("force.poisson_ratio", layer.poisson_ratio, own.layer.poisson_ratio, SAME_NUMBER),
        ];
        let rims = own.rim_mm.map(|own| ("force.rim_mm", rim_mm.unwrap_or(own), own, SAME_NUMBER));
        match pairs.into_iter().chain(rims).find(|&(_, found, expected, share)| !near(found, expected, share))
        {
            Some((name, found, expected, _)) => Err(ComplianceError::Differs { name, found, expected }),
            None => Ok(()),
        }
    }

    /// The sides of the gel for its derivatives, at most so many pitches away.
    pub(super) fn sides(&self, max_pitches: f64) -> FreeSides {
        let ComplianceGel { rows, cols, pitch_mm, rim_mm, .. } = self.gel;
        FreeSides::new([cols, rows], [pitch_mm; 2], rim_mm.map(|mm| mm.min(max_pitches * pitch_mm)))
    }
}

impl ComplianceGel {
    /// Number of entries of its matrix.
    #[must_use]
    pub const fn entries(&self) -> usize {
        9 * self.rows.div_ceil(2) * self.cols.div_ceil(2) * self.rows * self.cols
    }

    pub(super) fn check(&self) -> Result<(), ComplianceError> {
        let Self { rows, cols, pitch_mm, layer, rim_mm } = *self;
        let counts = 2.0..=MOST as f64;
        let lengths = 1e-3..=1e3;
        let numbers = [
            ("rows", rows as f64, &counts, "2 to 64"),
            ("cols", cols as f64, &counts, "2 to 64"),
            ("pitch_mm", pitch_mm, &lengths, "0.001 to 1000 mm"),
            ("thickness_mm", layer.thickness_mm, &(0.1..=1e3), "0.1 to 1000 mm"),
            ("poisson_ratio", layer.poisson_ratio, &(0.0..=0.5), "0 to 0.5"),
            ("rim_mm along rows", rim_mm[0], &lengths, "0.001 to 1000 mm"),
            ("rim_mm along columns", rim_mm[1], &lengths, "0.001 to 1000 mm"),
        ];
        match numbers.into_iter().find(|(_, found, range, _)| !range.contains(found)) {
            Some((name, found, _, valid)) => Err(ComplianceError::Gel { name, found, valid }),
            None => Ok(()),
        }
    }
}
