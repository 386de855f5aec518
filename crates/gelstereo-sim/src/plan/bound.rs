//! Upper bounds of effects.

use crate::plan::Facts;
use crate::scene::{Gel, SceneError};

/// Largest change by an effect in any frame of the scene's trajectory, whichever of the scene's other
/// effects are on. (So the bounds of several switched-off effects add up: remove them one by one.)
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bound {
    /// Change of a dot's position in an image: the centroid of its outline, for dots within the image.
    pub px: f64,
    /// Change of a marker's position in space.
    pub um: f64,
    /// Change of a pixel before rounding, grey levels.
    pub levels: f64,
}

impl Bound {
    /// No change.
    pub const NONE: Self = Self { px: 0.0, um: 0.0, levels: 0.0 };
    /// No bound is known.
    pub const UNKNOWN: Self = Self { px: f64::INFINITY, um: f64::INFINITY, levels: f64::INFINITY };

    /// A change of pixels only, not of positions.
    #[must_use]
    pub const fn of_levels(levels: f64) -> Self {
        Self { levels, ..Self::NONE }
    }
}

/// Properties of an effect that are known before the simulation.
pub(crate) trait Effect {
    /// Checks its settings.
    fn validate(&self, gel: &Gel) -> Result<(), SceneError>;

    /// Upper bound of its change; costs at most a few hundred operations.
    fn bound(&self, facts: &Facts<'_>) -> Bound;

    /// Estimated time for one stereo frame, nanoseconds: callgrind's instruction counts for the example
    /// `effect_costs`, at 4 per nanosecond, proportional to markers or pixels.
    fn cost_ns(&self, facts: &Facts<'_>) -> f64;

    /// Largest sideways motion of a marker, for effects on gel and print.
    fn sideways_mm(&self, _facts: &Facts<'_>) -> f64 {
        0.0
    }

    /// Largest stretch of the gel between two neighbours, as a share.
    fn stretch(&self, facts: &Facts<'_>) -> f64 {
        2.0 * self.sideways_mm(facts) / facts.least_pitch_mm()
    }
}
