//! Why a frame gave no result.

use super::rest_record::RestRecordError;
use crate::contact::ContactError;
use crate::detect::DetectError;
use crate::force::ForceError;
use crate::lattice::LabelError;
use crate::params::{ParamsError, Pitch};
pub use crate::rig::View;
use crate::slip::SlipError;
use crate::triangulate::TriangulateError;

/// Why a frame gave no result. Tracks and rest surface are unchanged since the last good frame.
#[derive(Clone, Debug, PartialEq)]
pub enum PipelineError {
    /// A setting is invalid.
    Params(ParamsError),
    /// An image is not of the size that the rig was calibrated for.
    Size {
        /// Which view.
        view: View,
        /// Width and height found, pixels.
        found: (usize, usize),
        /// Width and height of the rig's camera, pixels.
        expected: (usize, usize),
    },
    /// Detection failed in one view.
    Detect {
        /// Which view.
        view: View,
        /// Why.
        error: DetectError,
    },
    /// The rest frame could not be labelled in one view.
    Label {
        /// Which view.
        view: View,
        /// Why.
        error: LabelError,
    },
    /// Triangulation of the rest frame failed, or the rig is invalid.
    Triangulate(TriangulateError),
    /// The rest frame's points span no surface.
    Contact(ContactError),
    /// Forces cannot be estimated on this lattice.
    Force(ForceError),
    /// Slip cannot be found on this print.
    Slip(SlipError),
    /// The views' rest frames show lattices of different sizes.
    Lattices {
        /// Rows and columns found in the left view.
        left: (usize, usize),
        /// Rows and columns found in the right view.
        right: (usize, usize),
    },
    /// Both views show a part of the lattice, and which markers are the same is not clear.
    Views {
        /// Pitch along rows and along columns for the two likeliest assignments, millimetres.
        nearest_mm: [Option<[f64; 2]>; 2],
        /// Configured pitch.
        expected: Pitch,
    },
    /// A record of a rest frame is invalid, or from another pipeline.
    Record(RestRecordError),
    /// The rest frame's rows disagree between the views.
    Epipolar {
        /// Median distance of the rectified rows of one marker, pixels.
        median_px: f64,
        /// Largest valid one, pixels.
        max_px: f64,
    },
    /// The markers' pitch in the rest frame differs strongly from `lattice.pitch_mm`.
    Pitch {
        /// Median distance of neighbours along rows and along columns, millimetres.
        found_mm: [f64; 2],
        /// Configured value.
        expected: Pitch,
    },
}

impl core::fmt::Display for PipelineError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Params(error) => error.fmt(f),
            Self::Size { view, found, expected } => write!(
                f,
                "the {view} image is {} x {} pixels but the rig was calibrated for {} x {}",
                found.0, found.1, expected.0, expected.1
            ),
            Self::Detect { view, error } => write!(f, "{view} view: {error}"),
            Self::Label { view, error } => write!(f, "{view} view: {error}"),
            Self::Triangulate(error) => error.fmt(f),
            Self::Contact(error) => error.fmt(f),
            Self::Force(error) => error.fmt(f),
            Self::Slip(error) => error.fmt(f),
            Self::Record(error) => error.fmt(f),
            Self::Lattices { left, right } => write!(
                f,
                "the left view shows {} rows x {} columns of markers but the right one {} x {}: both must \
                 see the whole lattice",
                left.0, left.1, right.0, right.1
            ),
            Self::Views { nearest_mm, expected } => {
                write!(f, "neither view shows a whole border of the lattice, and ")?;
                match nearest_mm {
                    [Some([x, y]), second] => {
                        write!(f, "the pitch would be [{x:.4}, {y:.4}] mm")?;
                        if let Some([x, y]) = second {
                            write!(f, " or [{x:.4}, {y:.4}] mm")?;
                        }
                    }
                    _ => write!(f, "no columns of both agree in their rows")?,
                }
                write!(
                    f,
                    ", while lattice.pitch_mm is {expected}: set it to 1 %, check the rig and its layers, or \
                     let both cameras see the whole lattice"
                )
            }
            Self::Epipolar { median_px, max_px } => write!(
                f,
                "the rows of the two views disagree by {median_px:.2} px in the median; valid is at most \
                 {max_px} px: the rig does not belong to these cameras, or a row was lost in one view"
            ),
            Self::Pitch { found_mm: [x, y], expected } => write!(
                f,
                "the markers stand {x:.3} mm apart along rows and {y:.3} mm along columns in the median, but \
                 lattice.pitch_mm is {expected}; valid is half to twice what is seen: set lattice.pitch_mm \
                 to the print's pitch, or check the rig's baseline and focal lengths"
            ),
        }
    }
}

impl core::error::Error for PipelineError {}
