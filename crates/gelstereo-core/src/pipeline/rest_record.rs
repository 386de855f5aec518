//! Record of a rest frame, from which a later run can start under contact.

use super::epipolar::TERMS;
use crate::math::{DVec2, DVec3};
use crate::params::{DetectParams, LatticeParams, TriangulateParams};
use crate::rig::{Rig, View};
use alloc::vec::Vec;

/// A sensor's rest state: marker positions without contact, and the configuration they were measured
/// with.
///
/// It is valid as long as gel and cameras do not move in the sensor. It is made by
/// [`super::Pipeline::rest_record`] and used by [`super::Pipeline::resume`].
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct RestRecord {
    /// Markers from top to bottom.
    pub rows: usize,
    /// Markers from left to right.
    pub cols: usize,
    /// Rest surface, marker `row * cols + col` at that index (sensor frame, millimetres).
    pub points_mm: Vec<DVec3>,
    /// Variances of the points along the rest plane's normal, mm².
    pub variance_mm2: Vec<f64>,
    /// Radius of the dots in pitches; absent unless `triangulate.disc_bias` corrects for it.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub dot_radius_pitches: Option<f64>,
    /// Factor applied to the variances of the centres ([`super::Pipeline::noise_scale`]); 1 when absent.
    #[cfg_attr(feature = "serde", serde(default = "unscaled", skip_serializing_if = "is_unscaled"))]
    pub noise_scale: f64,
    /// Calibration residual of the epipolar residuals, px: coefficients of a polynomial over rows and
    /// columns, or empty where unknown.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Vec::is_empty"))]
    pub epipolar_px: Vec<f64>,
    /// The left view.
    pub left: RestView,
    /// The right view.
    pub right: RestView,
    /// The rig used for triangulation.
    pub rig: Rig,
    /// Settings of the lattice.
    pub lattice: LatticeParams,
    /// Settings of detection.
    pub detect: DetectParams,
    /// Settings of triangulation.
    pub triangulate: TriangulateParams,
}

/// One view of the rest frame.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct RestView {
    /// Median distance of neighbours, pixels.
    pub pitch_px: f64,
    /// Positions of all markers, row by row, pixels.
    pub positions_px: Vec<DVec2>,
    /// Whether the rest frame showed each marker; the others were filled in, as they are not printed or
    /// were hidden.
    pub shown: Vec<bool>,
}

/// Why a record of a rest frame cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub enum RestRecordError {
    /// Too few or too many rows or columns.
    Lattice {
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// A list does not have one entry per marker.
    Length {
        /// Which list.
        list: &'static str,
        /// Entries found.
        found: usize,
        /// Rows times columns.
        expected: usize,
    },
    /// A number is NaN, infinite, or negative where it may not be.
    Value {
        /// Which list.
        list: &'static str,
        /// Which marker.
        index: usize,
    },
    /// A pitch is not between 1 pixel and the image's width.
    Pitch {
        /// In which view.
        view: View,
        /// What was found, pixels.
        pitch_px: f64,
    },
    /// It was made with another rig.
    Rig,
    /// It was made with other settings.
    Settings {
        /// Which table of settings differs.
        table: &'static str,
    },
}

impl core::fmt::Display for RestRecordError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Lattice { rows, cols } => {
                write!(f, "the rest record has {rows} rows x {cols} columns; valid is 3 to 1000 of both")
            }
            Self::Length { list, found, expected } => write!(
                f,
                "the rest record's {list} has {found} entries but the lattice {expected} markers: the file \
                is damaged"
            ),
            Self::Value { list, index } => write!(
                f,
                "the rest record's {list} is not finite, or negative where it may not be, at marker {index}: \
                 the file is damaged"
            ),
            Self::Pitch { view, pitch_px } => write!(
                f,
                "the rest record's pitch in the {view} view is {pitch_px} px; valid is 1 px to the image's \
                width"
            ),
            Self::Rig => write!(
                f,
                "the rest record was made with another rig: use that one, or record a rest frame with this \
                one"
            ),
            Self::Settings { table } => write!(
                f,
                "the rest record was made with other settings of [{table}]: use those, or record a rest \
                frame with these"
            ),
        }
    }
}

impl core::error::Error for RestRecordError {}

impl RestRecord {
    /// Checks that the values describe a rest state.
    ///
    /// # Errors
    /// [`RestRecordError`], except the two variants about another pipeline.
    pub fn validate(&self) -> Result<(), RestRecordError> {
        let Self { rows, cols, .. } = *self;
        if !(3..=1000).contains(&rows) || !(3..=1000).contains(&cols) {
            return Err(RestRecordError::Lattice { rows, cols });
        }
        let finite = |p: &DVec2| p.is_finite();
        check("points_mm", rows * cols, &self.points_mm, DVec3::is_finite)?;
        check("variance_mm2", rows * cols, &self.variance_mm2, |v| v.is_finite() && v >= 0.0)?;
        check("left.positions_px", rows * cols, &self.left.positions_px, |p| finite(&p))?;
        check("right.positions_px", rows * cols, &self.right.positions_px, |p| finite(&p))?;
        let radius = self.dot_radius_pitches.as_slice();
        check("dot_radius_pitches", radius.len(), radius, |r| r > 0.0 && r < 1.0)?;
        check("noise_scale", 1, &[self.noise_scale], |scale| scale.is_finite() && scale > 0.0)?;
        let terms = if self.epipolar_px.is_empty() { 0 } else { TERMS };
        check("epipolar_px", terms, &self.epipolar_px, f64::is_finite)?;
        check("left.shown", rows * cols, &self.left.shown, |_| true)?;
        check("right.shown", rows * cols, &self.right.shown, |_| true)?;
        for (view, rest, camera) in
            [(View::Left, &self.left, &self.rig.left), (View::Right, &self.right, &self.rig.right)]
        {
            if !(1.0..=camera.width_px as f64).contains(&rest.pitch_px) {
                return Err(RestRecordError::Pitch { view, pitch_px: rest.pitch_px });
            }
        }
        Ok(())
    }
}

#[cfg(feature = "serde")]
const fn unscaled() -> f64 {
    1.0
}

#[cfg(feature = "serde")]
fn is_unscaled(scale: &f64) -> bool {
    *scale == 1.0
}

fn check<T: Copy>(
    list: &'static str,
    expected: usize,
    values: &[T],
    valid: impl Fn(T) -> bool,
) -> Result<(), RestRecordError> {
    let found = values.len();
    if found != expected {
        return Err(RestRecordError::Length { list, found, expected });
    }
    match values.iter().position(|&value| !valid(value)) {
        Some(index) => Err(RestRecordError::Value { list, index }),
        None => Ok(()),
    }
}
