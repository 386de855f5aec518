//! Compliances of an elastic layer by wave number.
//!
//! The layer is bonded to a rigid plate and free above. Traction and motion of the surface vary as
//! e^(ik·x). Pressure and its motion are positive into the layer, and "along" means parallel to k.
//! Displacements are
//!
//! - into the layer: normal · p + i cross · q_along,
//! - along k: in_plane · q_along - i cross · p,
//! - across k: anti_plane · q_across,
//!
//! (the two cross terms are equal by Betti's reciprocity). With x = k h, c = 2 (1 - ν²) / (E k) and D =
//! (3 - 4ν) cosh 2x + 2x² + 5 - 12ν + 8ν² they are
//!
//! - normal and in_plane: c [(3 - 4ν) sinh 2x ∓ 2x] / D,
//! - cross: c [x² - (1 - 2ν)(3 - 4ν) sinh² x] / (1 - ν) / D,
//! - anti_plane: 2 (1 + ν) tanh x / (E k).

use crate::math::{exp, expm1};

/// Material and thickness of an elastic layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Thickness h, mm.
    pub thickness_mm: f64,
    /// Poisson's ratio ν, 0 to 0.5; exactly 0.5 is an incompressible gel.
    pub poisson_ratio: f64,
}

/// Compliances at one wave number: mm of motion for a traction of one Young's modulus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compliance {
    /// Motion into the layer under a pressure.
    pub normal_mm: f64,
    /// Motion along the wave under a traction along it.
    pub in_plane_mm: f64,
    /// Motion across the wave under a traction across it.
    pub anti_plane_mm: f64,
    /// Motion along the wave under a pressure, and into the layer under a traction along the wave;
    /// positive where pressed gel moves away from the pressure.
    pub cross_mm: f64,
}

/// Beyond this x, e^(-2x) underflows.
const DEEP: f64 = 373.0;

impl Layer {
    /// Compliance at wave number `k_per_mm` (radians per millimetre, not negative); the limit at 0.
    #[must_use]
    pub fn compliance(&self, k_per_mm: f64) -> Compliance {
        let Self { thickness_mm: h, poisson_ratio: nu } = *self;
        let x = k_per_mm * h;
        if x > DEEP {
            return self.half_space(k_per_mm);
        }
        // All terms are scaled by 2 e^(-2x) against overflow.
        let e = exp(-2.0 * x);
        let hyperbolic_sine = -expm1(-4.0 * x);
        let (squeezed, stiff) = (1.0 - 2.0 * nu, 3.0 - 4.0 * nu);
        let rest = 5.0 - 12.0 * nu + 8.0 * nu * nu;
        let determinant = stiff * (1.0 + e * e) + (4.0 * x * x + 2.0 * rest) * e;
        // sinh² x = (e^x - e^-x)² / 4, scaled (1 - e)² / 2.
        let sinh_squared = 0.5 * expm1(-2.0 * x) * expm1(-2.0 * x);
        // Divided by x, with the limits at 0: sinh y / x at y = 2x.
        let sine_over_x = if x > 0.0 { hyperbolic_sine / x } else { 4.0 };
        let excess_over_x = excess(2.0 * x, e) / x.max(f64::MIN_POSITIVE);
        let scale = 2.0 * (1.0 - nu * nu) * h / determinant;
        let tanh_over_x = if x > 0.0 { hyperbolic_sine / ((1.0 + e) * (1.0 + e)) / x } else { 1.0 };
        Compliance {
            // (3 - 4ν) sinh y - y = 2 (1 - 2ν) sinh y + (sinh y - y): both positive, so there is no
            // cancellation.
            normal_mm: scale * (2.0 * squeezed * sine_over_x + excess_over_x),
            in_plane_mm: scale * (stiff * sine_over_x + 4.0 * e),
            anti_plane_mm: 2.0 * (1.0 + nu) * h * tanh_over_x,
            cross_mm: if x > 0.0 {
                scale * (2.0 * x * x * e - squeezed * stiff * sinh_squared) / ((1.0 - nu) * x)
            } else {
                0.0
            },
        }
    }

    /// Compliance of the half-space, the limit for short waves.
    #[must_use]
    pub fn half_space(&self, k_per_mm: f64) -> Compliance {
        let nu = self.poisson_ratio;
        let normal_mm = 2.0 * (1.0 - nu * nu) / k_per_mm;
        Compliance {
            normal_mm,
            in_plane_mm: normal_mm,
            anti_plane_mm: 2.0 * (1.0 + nu) / k_per_mm,
            cross_mm: -(1.0 + nu) * (1.0 - 2.0 * nu) / k_per_mm,
        }
    }
}

/// 2 e^(-y) (sinh y - y), where `e` is e^(-y).
fn excess(y: f64, e: f64) -> f64 {
    if y > 1.0 {
        return 1.0 - e * e - 2.0 * y * e;
    }
    // y³/6 (1 + y²/20 (1 + y²/42 (...))); the term after y^19 is 1e-17 of the first at y = 1.
    let y2 = y * y;
    let mut series = 1.0;
    for n in (2..=9).rev() {
        let n = f64::from(n);
        series = 1.0 + series * y2 / (2.0 * n * (2.0 * n + 1.0));
    }
    2.0 * e * y * y2 / 6.0 * series
}
