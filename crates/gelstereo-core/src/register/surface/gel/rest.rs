//! The gel at rest, as far as a contact has to find it out: its plane and its decay length.

use crate::math::{DVec2, exp};

/// The logarithm of l² over the nominal one goes no farther: a fifth of the nominal l to twice that.
pub(in crate::register::surface) const DECAY_LOGS: core::ops::RangeInclusive<f64> = -3.0..=1.5;

/// A decay length that was fitted with the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GelDecay {
    /// The length that explains the contact best.
    pub length_mm: f64,
    /// Whether it stands at an end of where it is looked for, 0.22 and 2.1 times [`Contact::decay_mm`]: the gel is another
    /// than it is said to be, and the pose is to be believed the less.
    ///
    /// [`Contact::decay_mm`]: crate::register::surface::Contact::decay_mm
    pub is_at_limit: bool,
}

/// What is unknown of the gel.
#[derive(Clone, Copy, Debug)]
pub(in crate::register::surface) struct Rest {
    /// Height of the plane of rest at the patch's centroid, and its rise over a radius of the patch.
    pub plane_mm: [f64; 3],
    /// Logarithm of l² over the nominal one.
    pub log_decay: f64,
}

impl Rest {
    pub const UNKNOWN: Self = Self { plane_mm: [0.0; 3], log_decay: 0.0 };

    /// The decay length, of a gel whose nominal one is `decay_mm`.
    pub fn decay(&self, decay_mm: f64) -> GelDecay {
        let is_within = *DECAY_LOGS.start() < self.log_decay && self.log_decay < *DECAY_LOGS.end();
        GelDecay { length_mm: decay_mm * exp(0.5 * self.log_decay), is_at_limit: !is_within }
    }

    /// Height of the plane at a place, in radii of the patch.
    pub fn at(&self, across: DVec2) -> f64 {
        self.plane_mm[0] + self.plane_mm[1] * across.x + self.plane_mm[2] * across.y
    }
}
