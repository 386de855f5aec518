//! Square root of a centre's covariance, so that derived covariances remain positive semi-definite.

use crate::math::linalg::Symmetric;
use crate::math::{DVec2, DVec3, sqrt};

/// The lower triangle L of a covariance L Lᵀ (Cholesky), px.
#[derive(Clone, Copy, Debug)]
pub(super) struct Root {
    pub xx: f64,
    pub yx: f64,
    pub yy: f64,
}

impl Root {
    /// `None` when the covariance is not positive definite, or its determinant is not a normal number.
    #[inline]
    pub fn new(covariance_px2: &Symmetric<2>) -> Option<Self> {
        let [[a, b], [c, d]] = *covariance_px2;
        let determinant = a * d - b * c;
        if !(a > 0.0 && (f64::MIN_POSITIVE..=f64::MAX).contains(&determinant)) {
            return None;
        }
        let xx = sqrt(a);
        let inverse = 1.0 / xx;
        Some(Self { xx, yx: b * inverse, yy: sqrt(determinant) * inverse })
    }

    /// For independent noise of variance 1.
    pub const fn unit() -> Self {
        Self { xx: 1.0, yx: 0.0, yy: 1.0 }
    }

    /// L⁻¹ times two rows and a residual.
    pub fn whiten(&self, [u, v]: &[DVec3; 2], residual: DVec2) -> ([DVec3; 2], DVec2) {
        let (x, y) = (1.0 / self.xx, 1.0 / self.yy);
        let (first, at) = (*u * x, residual.x * x);
        ([first, (*v - first * self.yx) * y], DVec2::new(at, (residual.y - at * self.yx) * y))
    }

    /// L times a vector.
    pub fn colour(&self, at: DVec2) -> DVec2 {
        DVec2::new(self.xx * at.x, self.yx * at.x + self.yy * at.y)
    }
}
