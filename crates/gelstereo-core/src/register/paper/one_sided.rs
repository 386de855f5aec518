//! Contact probability of patch points: the gel is on the part's surface or outside it, never inside.
//!
//! Around a contact the gel rises to the part in a shoulder, whose markers are salient but not in
//! contact. They may be the majority of the patch, and all are outside. A point at height h above the
//! surface is therefore modelled as a draw from
//!
//! ```text
//! ½ N(h; 0, σ²) + ½ U(h; 0, D),   D = register.max_distance_mm
//! ```
//!
//! and weighted by its probability of being in contact. A point below the surface means that the pose is
//! still wrong (or the marker was mismeasured, hence the limited influence). Such points push the part
//! back however many pull it outwards. σ shrinks from `sigma_start_mm` to `point_sigma_mm` by a fixed
//! ratio, not with the residuals, because these include the shoulder (graduated non-convexity, Blake and
//! Zisserman 1987).

use crate::math::{exp, ln, sqrt};
use crate::params::RegisterParams;

/// Ratio of σ between successive iterations.
const DECAY: f64 = 0.7;
/// Depth inside the part, in standard deviations, beyond which a point's influence is constant (Huber 1964).
const LIMIT: f64 = 3.0;

/// The mixture at one σ.
#[derive(Clone, Copy, Debug)]
pub(super) struct OneSided {
    sigma_mm: f64,
    /// ln of the shoulder's density over the contact's peak density.
    log_shoulder: f64,
}

impl OneSided {
    pub fn new(sigma_mm: f64, reach_mm: f64) -> Self {
        let greatest = 1.0 / (sigma_mm * sqrt(core::f64::consts::TAU));
        Self { sigma_mm, log_shoulder: -ln(reach_mm * greatest) }
    }

    /// Weight of a point. `residual_mm` is how far it should move along the outward normal: positive inside.
    pub fn weight(&self, residual_mm: f64) -> f64 {
        let r = residual_mm / self.sigma_mm;
        if r > 0.0 { LIMIT / r.max(LIMIT) } else { 1.0 / (1.0 + exp(self.log_shoulder + 0.5 * r * r)) }
    }
}

/// σ of the first iteration.
pub(super) fn first(params: &RegisterParams) -> f64 {
    params.filterreg.max_sigma_mm.max(params.point_sigma_mm)
}

/// σ of the iteration after one at `sigma_mm`.
pub(super) fn next(params: &RegisterParams, sigma_mm: f64) -> f64 {
    (DECAY * sigma_mm).max(params.point_sigma_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    #[test]
    fn outside_the_weight_is_the_probability_of_contact_and_inside_the_pull_is_limited() {
        let one_sided = OneSided::new(0.03, 1.0);
        // Normal density over uniform density, outside at h = 0.06: 13.298 e^-2 = 1.7997 to 1.
        assert!((one_sided.weight(-0.06) - 0.642818).abs() < 1e-6);
        assert!(one_sided.weight(-0.3) < 1e-20);
        assert_eq!(one_sided.weight(0.05), 1.0);
        for inside_mm in [0.09, 0.2, 1.0, 1e6] {
            let pull = one_sided.weight(inside_mm) * inside_mm;
            assert!((pull / 0.09 - 1.0).abs() < 1e-12, "{inside_mm}: {pull}");
        }
    }

    #[test]
    fn the_width_shrinks_to_the_points_noise_and_stays() {
        let params = RegisterParams::default();
        let mut widths = vec![first(&params)];
        for k in 0..20 {
            widths.push(next(&params, widths[k]));
        }
        assert!(widths.windows(2).all(|w| w[1] < w[0] || w[1] == params.point_sigma_mm));
        assert_eq!((widths[0], widths[20]), (params.filterreg.max_sigma_mm, params.point_sigma_mm));
    }
}
