//! Input and output of triangulation: marker centres in both views, and the resulting point.

use super::error::TriangulateError;
use super::root::Root;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, DVec3};

/// The centre of a marker in one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Centre {
    /// Position, pixels.
    pub at_px: DVec2,
    /// Its covariance, px².
    pub covariance_px2: Symmetric<2>,
}

/// The centres of all markers in one view, in the same order in every list.
#[derive(Clone, Copy, Debug)]
pub struct Centres<'a> {
    /// Positions, pixels.
    pub positions_px: &'a [DVec2],
    /// Their covariances, px².
    pub covariance_px2: &'a [Symmetric<2>],
}

impl Centres<'_> {
    /// The centre of one marker; `index` must be below the number of markers.
    #[must_use]
    pub fn at(&self, index: usize) -> Centre {
        Centre { at_px: self.positions_px[index], covariance_px2: self.covariance_px2[index] }
    }
}

/// A point in the sensor frame and the agreement of its two centres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoPoint {
    /// Position in the sensor (left camera) frame, millimetres.
    pub point_mm: DVec3,
    /// Covariance, mm², to first order in those of the two centres, which are independent.
    pub covariance_mm2: Symmetric<3>,
    /// Epipolar residual, pixels: the left row minus the row that corresponds to the right centre. Noise
    /// alone makes it a few tenths. Q uses the difference of the rectified rows, the exact rung the sum
    /// of the residuals in both views.
    pub epipolar_px: f64,
}

/// Two centres with their rays.
pub(super) struct Pair<'a> {
    pub centres: [&'a Centre; 2],
    /// Roots of the centres' covariances.
    pub roots: [Root; 2],
    /// Undistorted normalised coordinates.
    pub normalised: [DVec2; 2],
    pub rectified: [DVec2; 2],
}

/// Sum of the columns' outer products: positive semi-definite to rounding, and exactly symmetric.
pub(super) fn sum_of_squares<const N: usize>(columns: &[DVec3; N]) -> Symmetric<3> {
    // Entries (i, j) and (j, i) are sums of the same products in the same order.
    let mut sum = [[0.0; 3]; 3];
    for c in columns {
        for (row, factor) in sum.iter_mut().zip(c.to_array()) {
            row[0] += factor * c.x;
            row[1] += factor * c.y;
            row[2] += factor * c.z;
        }
    }
    sum
}

/// Returns the point if it and its covariance are finite.
pub(super) fn finite(index: usize, found: StereoPoint) -> Result<StereoPoint, TriangulateError> {
    let [[xx, xy, xz], [_, yy, yz], [.., zz]] = found.covariance_mm2;
    // A sum is finite only when all its terms are.
    let sum = xx + yy + zz + xy + xz + yz + found.epipolar_px;
    if (sum + found.point_mm.element_sum()).is_finite() {
        Ok(found)
    } else {
        Err(TriangulateError::Unknown { index })
    }
}
