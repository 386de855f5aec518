//! Gel parameters that are fitted with the pose: rest plane and decay length.

use crate::math::{DVec2, exp};

/// Bounds of the logarithm of l² over the nominal one: a fifth of the nominal l to twice the nominal l.
pub(in crate::register::surface) const DECAY_LOGS: core::ops::RangeInclusive<f64> = -3.0..=1.5;

/// A decay length fitted with the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GelDecay {
    /// Best-fitting decay length.
    pub length_mm: f64,
    /// Whether the length is at a bound of its range, 0.22 and 2.1 times [`Contact::decay_mm`]. Then the
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
