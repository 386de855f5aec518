//! Viscoelastic relaxation.

use crate::layer::PronyTerm;
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;

/// The elastic layer relaxes under load and creeps back after release: an imprint remains for a while.
///
/// Model: linear viscoelasticity with one Poisson's ratio, as a Prony series (Christensen 1982).
/// Contacts are those of the trajectory, frame by frame from its start; the surface moves linearly
/// between frames. The final surface under a part that is held does not change: strains stay, tractions
/// relax. It acts on [`super::ElasticLayer`] and needs it. A frame rendered out of order requires all
/// frames before it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Relaxation {
    /// Prony series: fractions of the modulus, and the time constants with which they relax. The fractions
    /// sum to less than 1. Default: `0.1` over `0.3` s and `0.1` over `3` s.
    pub terms: Vec<PronyTerm>,
}

impl Default for Relaxation {
    fn default() -> Self {
        let term = |time_s| PronyTerm { share: 0.1, time_s };
        Self { terms: Vec::from([term(0.3), term(3.0)]) }
    }
}

impl Effect for Relaxation {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let check = SceneError::check;
        let count = self.terms.len();
        check((1..=16).contains(&count), "effects.relaxation.terms' number", count as f64, "1 to 16")?;
        for &PronyTerm { share, time_s } in &self.terms {
            check((0.0..1.0).contains(&share), "effects.relaxation.terms.share", share, "0 to below 1")?;
            let name = "effects.relaxation.terms.time_s";
            check((1e-3..=1e6).contains(&time_s), name, time_s, "0.001 to 1000000 s")?;
        }
        let sum = self.terms.iter().map(|term| term.share).sum::<f64>();
        check(sum <= 0.99, "effects.relaxation.terms' shares together", sum, "at most 0.99")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        super::within_layer(facts)
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        // Surface of the previous frame, cell by cell.
        super::cells_of_layer(facts) * (840.0 + 6.0 * self.terms.len() as f64)
    }

    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        facts.scene.effects.elastic_layer.as_ref().map_or(0.0, |layer| layer.sideways_mm(facts))
    }
}
