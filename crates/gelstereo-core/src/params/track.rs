//! Keeping the identity of markers over frames.

use super::{ParamsError, check};

/// Keeping the identity of markers over frames.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct TrackParams {
    /// A detection farther than this from a marker's last position is not that marker (Eq. 2). Default: `0.5` pitches.
    pub gate_pitches: f64,
    /// A marker unseen for more frames than this is lost until it is seen again. Default: `15`, half a second.
    pub max_held_frames: u32,
}

impl Default for TrackParams {
    fn default() -> Self {
        Self { gate_pitches: 0.5, max_held_frames: 15 }
    }
}

impl TrackParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let gate = self.gate_pitches;
        check(gate > 0.0 && gate <= 1.0, "track.gate_pitches", gate, "above 0, at most 1")
    }
}
