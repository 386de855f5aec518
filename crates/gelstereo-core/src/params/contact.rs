//! Saliency and the stop triggers.

use super::{ParamsError, check, positive};

/// Saliency and the stop triggers.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct ContactParams {
    /// Indentation from which a marker is salient (Eq. 4). Default: `0.35` mm.
    pub saliency_mm: f64,
    /// Share of the deepest indentation that a salient marker must reach to belong to the contact patch, which is what is
    /// registered. Beside a deep press the gel is lifted too, but shows no surface of the part; where a ball or a
    /// cylinder leaves the gel, that has sunk about half as deep as in the middle (Hertz). Default: `0`, all of them.
    pub patch_share: f64,
    /// Mean marker motion at which the gripper stops closing. Default: `10` px.
    pub grasp_trigger_px: f64,
    /// Mean marker motion at which insertion stops. Default: `5` px.
    pub insertion_trigger_px: f64,
}

impl Default for ContactParams {
    fn default() -> Self {
        Self { saliency_mm: 0.35, patch_share: 0.0, grasp_trigger_px: 10.0, insertion_trigger_px: 5.0 }
    }
}

impl ContactParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        positive("contact.saliency_mm", self.saliency_mm)?;
        let share = self.patch_share;
        check((0.0..1.0).contains(&share), "contact.patch_share", share, "from 0 to below 1")?;
        positive("contact.grasp_trigger_px", self.grasp_trigger_px)?;
        positive("contact.insertion_trigger_px", self.insertion_trigger_px)
    }
}
