//! Soft shoulder beside a contact.

use super::check_decay;
use crate::lattice::Lattice;
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use crate::screened::Screened;
use alloc::vec::Vec;

/// The gel sags softly beside the contact instead of ending at the part's silhouette.
///
/// Model: a Pasternak foundation (springs joined by a shear layer; Pasternak 1954), h - l² Δh = p / k
/// with pressure p >= 0 only in contact: an obstacle problem, solved on the marker lattice. The surface
/// is never below the part, meets it without a kink, and decays as exp(-d / l) beside it. The contact is
/// smaller than the part's silhouette in the rest plane, as in Hertz's theory. Limits: no bulge beside
/// the contact (60 um for a 1 mm press on an incompressible layer); small strain; the contact is
/// resolved to one pitch only.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Shoulder {
    /// l in gel thicknesses. Valid: 0.01 to 4 thicknesses. Default: `0.5`. A layer whose interior follows its
    /// surface linearly has l² = t² / (3 M / G), 0.17 t at Poisson's ratio 0.45; a half-space has no length
    /// at all and decays slowly. Change it to the gel that is simulated.
    pub decay_thicknesses: f64,
}

impl Default for Shoulder {
    fn default() -> Self {
        Self { decay_thicknesses: 0.5 }
    }
}

impl Effect for Shoulder {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        check_decay("effects.shoulder.decay_thicknesses", self.decay_thicknesses)
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let sideways_mm = facts.when_contact_changes_mm();
        let depth_mm = facts.touch.depth_mm;
        // Beside the contact h is l² / (1 + n l²) times the sum of its n <= 4 neighbours (l in pitches of
        // each axis), none above the part's deepest point. In contact it is the part's height.
        let gel = &facts.scene.gel;
        let squares = Lattice::new(gel).squared_pitches(self.decay_thicknesses * gel.thickness_mm);
        let all = 2.0 * squares[0] + 2.0 * squares[1];
        let share = all / (1.0 + all);
        facts.moved(sideways_mm, if sideways_mm > 0.0 { depth_mm } else { share * depth_mm })
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        let imprints = if facts.sideways_mm > 0.0 { 2.0 } else { 1.0 };
        imprints * facts.relaxation_ns(self.decay_thicknesses)
    }
}

/// The effect on a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Sag(Screened<f64>);

impl Sag {
    pub(crate) fn new(shoulder: &Shoulder, lattice: &Lattice) -> Self {
        Self(Screened::new(lattice, shoulder.decay_thicknesses * lattice.thickness_mm))
    }

    /// Equilibrium heights of the surface over the part's heights (`obstacle`, negative where the part
    /// does not protrude).
    pub(crate) fn settle(&mut self, obstacle: &[f64], out: &mut Vec<f64>) {
        let Self(membrane) = self;
        membrane.start(|i| obstacle[i].max(0.0));
        membrane.hold(|i| obstacle[i]);
        membrane.settle_above();
        out.clear();
        out.extend(membrane.values());
    }
}
