//! A marker as registration on a surface sees it.

use crate::math::{DVec3, sqrt};

/// A point about the patch's centroid, with its covariance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub p_mm: DVec3,
    /// xx, yy, zz, xy, xz, yz.
    pub covariance: [f64; 6],
    /// Whether the gel around it is curved as free gel is, and not as gel on a part.
    pub hangs: bool,
    /// No standard deviation is larger, along whatever direction; in every frame the same.
    pub most_sigma_mm: f64,
}

/// Share of the trace that a singular covariance is given along its null direction, more than rounding takes off it.
const FLOOR: f64 = 1e-6;

impl Sample {
    pub fn new(p_mm: DVec3, covariance: [f64; 6]) -> Self {
        let trace = covariance[0] + covariance[1] + covariance[2];
        Self { p_mm, covariance, hangs: false, most_sigma_mm: sqrt((1.0 + FLOOR) * trace) }
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
