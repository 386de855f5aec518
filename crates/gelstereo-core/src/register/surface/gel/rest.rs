//! Gel parameters that are fitted with the pose: rest plane and decay length.

use crate::math::{DVec2, exp};

/// Bounds of the logarithm of l² over the nominal one: a twelfth of the nominal l to twice the nominal l.
/// With l = 2.5 mm and a pitch of 0.9 mm, gel at the lower bound sinks to 5 % of its height from an edge to
/// the next marker, as good as no shoulder. With a fifth of l it is 23 %, far above the noise.
pub(in crate::register::surface) const DECAY_LOGS: core::ops::RangeInclusive<f64> = -5.0..=1.5;
/// Standard deviation of that logarithm: a third of l.
const DECAY_SIGMA: f64 = 0.6;
/// Logarithm at which the prior ends: a fifth of l. A shorter shoulder lies between the markers, and all
/// lengths below are equally likely.
const RESOLVED_LOG: f64 = -3.0;

/// A decay length fitted with the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GelDecay {
    /// Best-fitting decay length.
    pub length_mm: f64,
    /// Whether the length is at a bound of its range, 0.08 and 2.1 times [`Contact::decay_mm`]. Then the
    /// gel differs from the given one, and the pose is less reliable.
    ///
    /// [`Contact::decay_mm`]: crate::register::surface::Contact::decay_mm
    pub is_at_limit: bool,
}

/// Unknown parameters of the gel.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Rest {
    /// Height of the rest plane at the patch's centroid, and its rise over a patch radius.
    pub plane_mm: [f64; 3],
    /// Logarithm of l² over the nominal one.
    pub log_decay: f64,
}

impl Rest {
    pub const UNKNOWN: Self = Self { plane_mm: [0.0; 3], log_decay: 0.0 };

    /// Before the first step, with this plane. The decay is in the middle of its range: from the nominal
    /// length on, the first steps of a gel without a shoulder would fit a long shoulder instead.
    pub fn begin(plane_mm: [f64; 3]) -> Self {
        Self { plane_mm, log_decay: 0.5 * (*DECAY_LOGS.start() + *DECAY_LOGS.end()) }
    }

    /// Prior cost of the decay length.
    pub fn decay_cost(&self) -> f64 {
        let resolved = self.log_decay.max(RESOLVED_LOG);
        0.5 * resolved * resolved * Self::decay_precision()
    }

    /// Derivative of [`Self::decay_cost`] by the logarithm.
    pub fn decay_slope(&self) -> f64 {
        if self.log_decay > RESOLVED_LOG { self.log_decay * Self::decay_precision() } else { 0.0 }
    }

    /// Precision of the logarithm in a step. It also shortens steps where the prior has ended.
    pub fn decay_precision() -> f64 {
        1.0 / (DECAY_SIGMA * DECAY_SIGMA)
    }

    /// The decay length, for a nominal one of `decay_mm`.
    pub fn decay(&self, decay_mm: f64) -> GelDecay {
        let is_within = *DECAY_LOGS.start() < self.log_decay && self.log_decay < *DECAY_LOGS.end();
        GelDecay { length_mm: decay_mm * exp(0.5 * self.log_decay), is_at_limit: !is_within }
    }

    /// Height of the plane at a position in patch radii.
    pub fn at(&self, across: DVec2) -> f64 {
        self.plane_mm[0] + self.plane_mm[1] * across.x + self.plane_mm[2] * across.y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest(log_decay: f64) -> Rest {
        Rest { log_decay, ..Rest::UNKNOWN }
    }

    /// Against finite differences, and flat down to the shortest length.
    #[test]
    fn shoulders_that_the_markers_do_not_resolve_are_equally_likely() {
        for k in -48..=14 {
            let log = 0.1 * f64::from(k) + 0.05;
            let slope = (rest(log + 1e-4).decay_cost() - rest(log - 1e-4).decay_cost()) / 2e-4;
            assert!((rest(log).decay_slope() - slope).abs() < 1e-6, "{log}");
        }
        assert_eq!(rest(*DECAY_LOGS.start()).decay_cost(), rest(RESOLVED_LOG).decay_cost());
        assert!(rest(RESOLVED_LOG + 0.1).decay_cost() < rest(RESOLVED_LOG).decay_cost());
    }
}
