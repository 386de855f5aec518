//! A marker for registration on a surface.

use crate::math::{DVec3, sqrt};

/// A point relative to the patch's centroid, with its covariance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub p_mm: DVec3,
    /// xx, yy, zz, xy, xz, yz.
    pub covariance: [f64; 6],
    /// Whether the surrounding gel behaves like free gel, and not like gel on a part.
    pub hangs: bool,
    /// Upper limit of the standard deviation along any direction, independent of the frame.
    pub max_sigma_mm: f64,
}

/// Share of the trace that is added to every variance. It exceeds the rounding of a singular covariance
/// along its null direction.
const FLOOR: f64 = 1e-6;

impl Sample {
    pub fn new(p_mm: DVec3, covariance: [f64; 6]) -> Self {
        let trace = covariance[0] + covariance[1] + covariance[2];
        Self { p_mm, covariance, hangs: false, max_sigma_mm: sqrt((1.0 + FLOOR) * trace) }
    }

    /// Variance along a unit vector.
    #[inline]
    pub fn variance(&self, n: DVec3) -> f64 {
        let [xx, yy, zz, xy, xz, yz] = self.covariance;
        let floor = FLOOR * (xx + yy + zz);
        let along = floor + xx * n.x * n.x + yy * n.y * n.y + zz * n.z * n.z;
        along + 2.0 * (xy * n.x * n.y + xz * n.x * n.z + yz * n.y * n.z)
    }
}
