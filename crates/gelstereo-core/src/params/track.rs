//! Keeping the identity of markers over frames.

use super::{ParamsError, check};

/// Where a marker is expected in the next frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Motion {
    /// Where it was (the paper).
    #[default]
    Still,
    /// As far on as it has moved since the frame before.
    ConstantVelocity,
}

/// Keeping the identity of markers over frames.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct TrackParams {
    /// A detection farther than this from where a marker is expected is not that marker (Eq. 2); with
    /// `label.method` = `lattice` this only starts the search. Valid: 0.001 to 1 pitches. Default: `0.5`
    /// pitches. Lower it only where markers move little between frames.
    pub gate_pitches: f64,
    /// Where a marker is expected, with `label.method` = `lattice`; the others search where it was. Default:
    /// `still`. Change it to `constant_velocity` for fast motion at a steady frame rate.
    pub motion: Motion,
    /// A marker unseen for more frames than this is lost until it is seen again. Valid: 0 to 1000000 frames.
    /// Default: `15`, half a second. Change it with the frame rate.
    pub max_held_frames: u32,
}

impl Default for TrackParams {
    fn default() -> Self {
        Self { gate_pitches: 0.5, motion: Motion::Still, max_held_frames: 15 }
    }
}

impl TrackParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let gate = self.gate_pitches;
        check((1e-3..=1.0).contains(&gate), "track.gate_pitches", gate, "0.001 to 1 pitches")?;
        let held = self.max_held_frames;
        check(held <= 1_000_000, "track.max_held_frames", f64::from(held), "0 to 1000000 frames")
    }
}
