//! Dropped frames.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::random::Stream;

/// Frames that the camera took but did not deliver. The sequence skips them, which shows in the indices
/// and times of the other frames.
///
/// In a file: `[effects.dropped_frames] frames = [7, 8]` or `rate = 0.05`.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct DroppedFrames {
    /// These frames, counted from 0. Default: none.
    pub frames: Vec<usize>,
    /// Probability that any other frame is dropped; the first one never is. Default: `0`.
    pub rate: f64,
}

impl Effect for DroppedFrames {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let name = "effects.dropped_frames.rate";
        SceneError::check((0.0..=0.95).contains(&self.rate), name, self.rate, "0 to 0.95")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let _ = facts;
        // A dropped frame differs from any delivered one without bound.
        if self.frames.is_empty() && self.rate == 0.0 { Bound::NONE } else { Bound::UNKNOWN }
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        let _ = facts;
        0.0
    }
}

impl DroppedFrames {
    /// The delivered frames out of `count`.
    pub(crate) fn delivered(&self, seed: u64, count: usize) -> Vec<usize> {
        let mut stream = Stream::new(Digest::new().u64(seed).value(), "dropped_frames");
        let arrives = |frame: &usize| {
            let lost = stream.uniform() < self.rate && *frame > 0;
            !lost && !self.frames.contains(frame)
        };
        (0..count).filter(arrives).collect()
    }
}
