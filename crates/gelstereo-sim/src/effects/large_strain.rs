//! Strains that are not small.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};

/// The part meets the gel where the gel has moved to, not where it was.
///
/// Model: the elastic layer's contact is solved again with the part's heights above the places to which the cells have
/// moved sideways, until they move no more: the contact of large displacements. The gel's law stays linear (a soft silicone's does up to
/// some 30 % of strain), and so does the layer's thickness. It acts on [`super::ElasticLayer`] and needs it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct LargeStrain {
    /// Most solves after the first. Default: `8`.
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
        // Of a part that sticks; others take a fifth.
        self.rounds as f64 * super::cells_of_layer(facts) * 1200.0
    }

    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        facts.scene.effects.elastic_layer.as_ref().map_or(0.0, |layer| layer.sideways_mm(facts))
    }
}
