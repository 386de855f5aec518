//! Large strains.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};

/// The part contacts the gel at its displaced position, not at its rest position.
///
/// Model: the elastic layer's contact is solved again with the part's heights above the displaced cells,
/// until they stop moving (contact with large displacements). The gel's law stays linear (valid for a
/// soft silicone up to some 30 % of strain), and the layer's thickness is constant. It acts on
/// [`super::ElasticLayer`] and needs it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct LargeStrain {
    /// Largest number of solves after the first. Default: `8`.
    pub rounds: usize,
}

impl Default for LargeStrain {
    fn default() -> Self {
        Self { rounds: 8 }
    }
}

impl Effect for LargeStrain {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let rounds = self.rounds;
        SceneError::check(
            (1..=100).contains(&rounds),
            "effects.large_strain.rounds",
            rounds as f64,
            "1 to 100",
        )
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        super::within_layer(facts)
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        // For a part that sticks; others take a fifth.
        self.rounds as f64 * super::cells_of_layer(facts) * 1200.0
    }

    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        facts.scene.effects.elastic_layer.as_ref().map_or(0.0, |layer| layer.sideways_mm(facts))
    }
}
