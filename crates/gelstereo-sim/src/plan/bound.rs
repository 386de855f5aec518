//! How much an effect matters.

use crate::plan::Facts;
use crate::scene::{Gel, SceneError};

/// The most that an effect changes in any frame of the scene's trajectory, whichever of the scene's other effects
/// are on. (So the bounds of several that are off add up: take them away one after the other.)
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bound {
    /// Of a dot's position in an image: the centroid of its outline, for dots within the image.
    pub px: f64,
    /// Of a marker's position in space.
    pub um: f64,
    /// Of a pixel before it is rounded, grey levels.
    pub levels: f64,
}

impl Bound {
    /// Nothing changes.
    pub const NONE: Self = Self { px: 0.0, um: 0.0, levels: 0.0 };
    /// Nobody can say.
    pub const UNKNOWN: Self = Self { px: f64::INFINITY, um: f64::INFINITY, levels: f64::INFINITY };

    /// Pixels change, but no position.
    #[must_use]
    pub const fn of_levels(levels: f64) -> Self {
        Self { levels, ..Self::NONE }
    }
}

/// What every effect says of itself before anything is simulated.
pub(crate) trait Effect {
    /// Checks its settings.
    fn validate(&self, gel: &Gel) -> Result<(), SceneError>;

    /// The most that it changes; it costs no more than a few hundred operations.
    fn bound(&self, facts: &Facts<'_>) -> Bound;

    /// Estimated time for one stereo frame, nanoseconds: instructions as callgrind counts them for the example
    /// `effect_costs`, at 4 to a nanosecond, in proportion to markers or pixels.
    fn cost_ns(&self, facts: &Facts<'_>) -> f64;

    /// The most that it moves a marker sideways: for effects on gel and print.
    fn sideways_mm(&self, _facts: &Facts<'_>) -> f64 {
        0.0
    }

    /// The most that it stretches the gel between two neighbours, as a share.
    fn stretch(&self, facts: &Facts<'_>) -> f64 {
        2.0 * self.sideways_mm(facts) / facts.least_pitch_mm()
    }
}
