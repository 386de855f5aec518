//! Shear and twist.

use super::check_decay;
use crate::lattice::Lattice;
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use crate::screened::{Motion, Node, Screened};
use crate::simulator::ContactState;
use gelstereo_core::math::{DVec2, cos, sin};

/// The surface follows the part's shear and twist: it sticks in the contact, and the motion decays
/// beside it.
///
/// Model: in the contact every marker moves with the part. Beside it u - l² Δu = 0 for both components,
/// a shear layer bonded to its plate. Limits: no slip; the two components do not mix; small strain.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Drag {
    /// l in gel thicknesses. Valid: 0.01 to 4 thicknesses. Default: `0.8`. A layer that follows its surface
    /// linearly has 1/√3 across the motion and, if incompressible, √(4/3) along it; this is their geometric
    /// mean. Change it to the gel that is simulated.
    pub decay_thicknesses: f64,
}

impl Default for Drag {
    fn default() -> Self {
        Self { decay_thicknesses: 0.8 }
    }
}

impl Effect for Drag {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        check_decay("effects.drag.decay_thicknesses", self.decay_thicknesses)
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let own_mm = self.sideways_mm(facts);
        if !(own_mm > 0.0) {
            return Bound::NONE;
        }
        // Drag changes which markers the part touches, and so how the gel spreads.
        let sideways_mm = own_mm.max(facts.sideways_mm);
        facts.moved(sideways_mm, facts.height_mm(sideways_mm))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        // Both components at once, plus the contact before the drag and the centre of the twist.
        1.5 * facts.relaxation_ns(self.decay_thicknesses) + 64.0 * facts.markers()
    }

    /// Each component lies between those of the sticking markers.
    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        core::f64::consts::SQRT_2 * facts.touch.grip_mm()
    }
}

/// The effect on a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Pull(Screened<Motion>);

impl Pull {
    pub(crate) fn new(drag: &Drag, lattice: &Lattice) -> Self {
        Self(Screened::new(lattice, drag.decay_thicknesses * lattice.thickness_mm))
    }

    /// Adds the motion of every marker when the `stuck` ones are carried along.
    pub(crate) fn pull(&mut self, carried: impl Fn(usize) -> DVec2, stuck: &[bool], motion: &mut [DVec2]) {
        let Self(membrane) = self;
        membrane.hold(|i| Motion::even(if stuck[i] { 0.0 } else { 1.0 }));
        membrane.start(|i| Motion(if stuck[i] { carried(i) } else { DVec2::ZERO }));
        membrane.settle_beside();
        motion.iter_mut().zip(membrane.values()).for_each(|(u, Motion(along))| *u += along);
    }
}

/// The part's rigid motion in the plane since it touched.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Grip {
    pub(crate) centre_mm: DVec2,
    shear_mm: DVec2,
    sine: f64,
    versine: f64,
}

impl Grip {
    /// Shear, and twist about `centre_mm` (the contact's centre at touch).
    pub(crate) fn new(contact: &ContactState, centre_mm: DVec2) -> Self {
        let half = sin(0.5 * contact.twist_rad);
        Self {
            centre_mm,
            shear_mm: DVec2::from_array(contact.shear_mm),
            sine: 2.0 * half * cos(0.5 * contact.twist_rad),
            versine: 2.0 * half * half,
        }
    }

    /// Motion of a point at rest position `rest` that moves with the part.
    pub(crate) fn motion_mm(&self, rest: DVec2) -> DVec2 {
        let arm = rest - self.centre_mm;
        self.shear_mm + arm.perp() * self.sine - arm * self.versine
    }
}
