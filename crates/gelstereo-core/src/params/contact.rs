//! Saliency and the stop triggers.

use super::{ParamsError, check, length, motion, share};

/// How the markers in contact are told from the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Saliency {
    /// Indented by more than `saliency_mm` (the paper, Eq. 4). It misses shallow contacts and takes the
    /// shoulder beside deep ones.
    #[default]
    Depth,
    /// The gel carries pressure there, beyond what the measured noise explains:
    /// [`Pressure`](crate::contact::Pressure).
    Pressure,
    /// By pressure for several decay lengths up to `decay_mm`, and by several shares of the deepest
    /// indentation: the candidate whose border parts concave from convex gel best:
    /// [`AdaptiveSaliency`](crate::contact::AdaptiveSaliency).
    Adaptive,
}

/// Saliency and the stop triggers.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct ContactParams {
    /// The rule that decides which markers the part touches. Default: `depth`. Set `pressure` if you know the
    /// gel's decay length `decay_mm`.
    pub saliency: Saliency,
    /// Length over which the gel's surface comes back to rest beside a contact, for `saliency = pressure`,
    /// and the longest that `adaptive` tries: half of the gel's thickness is a fair guess.
    /// Rather too long than too short: 20 % too short takes half of the shoulder. A few presses of any part
    /// tell it to some percent: [`DecayFit`](crate::contact::DecayFit). Valid: 0.001 to 1000 mm. Default:
    /// `2.5` mm. Change it to your gel's own length.
    pub decay_mm: f64,
    /// Whether to learn the decay length from contacts, for `saliency = pressure`, beginning with `decay_mm`,
    /// which should then be too long rather than too short. What was learned counts once it is known to 2 %,
    /// and is what [`Pipeline::decay`](crate::pipeline::Pipeline::decay) says. Default: `false`. Set it for a
    /// gel whose length is unknown.
    pub learn_decay: bool,
    /// Indentation from which a marker is salient, for `saliency = depth` (Eq. 4). Valid: 0.000001 to 10000
    /// mm. Default: `0.35` mm. Lower it for shallow contacts; keep it above the noise of heights at rest.
    pub saliency_mm: f64,
    /// Share of the deepest indentation that a salient marker must reach to belong to the contact patch,
    /// which is what is registered. For `saliency = depth`: beside a deep press the gel is lifted too, but
    /// shows no surface of the part; where a ball or a cylinder leaves the gel, that has sunk about half as
    /// deep as in the middle (Hertz). By pressure the shoulder is not salient, and a share would only cut off
    /// what a tilted part presses less. Valid: 0 to 0.999. Default: `0`, all of them. Raise it to 0.5 for
    /// round parts with `saliency = depth`.
    pub patch_share: f64,
    /// Mean marker motion at which the gripper stops closing. Valid: 0.000001 to 10000 px. Default: `10` px.
    /// Lower it for fragile parts, raise it for a firmer grip.
    pub grasp_trigger_px: f64,
    /// Mean marker motion at which insertion stops. Valid: 0.000001 to 10000 px. Default: `5` px. Lower it
    /// for soft parts; raise it when friction ends insertions early.
    pub insertion_trigger_px: f64,
}

impl Default for ContactParams {
    fn default() -> Self {
        Self {
            saliency: Saliency::Depth,
            decay_mm: Self::DECAY_MM,
            learn_decay: false,
            saliency_mm: 0.35,
            patch_share: 0.0,
            grasp_trigger_px: 10.0,
            insertion_trigger_px: 5.0,
        }
    }
}

impl ContactParams {
    /// Default of [`Self::decay_mm`].
    pub(crate) const DECAY_MM: f64 = 2.5;

    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        length("contact.saliency_mm", self.saliency_mm)?;
        let decay = self.decay_mm;
        check((1e-3..=1e3).contains(&decay), "contact.decay_mm", decay, "0.001 to 1000 mm")?;
        if self.learn_decay && self.saliency != Saliency::Pressure {
            let (setting, required) = ("contact.learn_decay = true", "contact.saliency = \"pressure\"");
            return Err(ParamsError::Requires { setting, required });
        }
        share("contact.patch_share", self.patch_share)?;
        motion("contact.grasp_trigger_px", self.grasp_trigger_px)?;
        motion("contact.insertion_trigger_px", self.insertion_trigger_px)
    }
}
