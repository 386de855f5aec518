//! Worn dots.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::random::Stream;

/// Dots shrink from their rims with use, some faster than others.
///
/// A dot's radius is the printed one times 1 - u (`share` + `share_per_s` · time), at least a hundredth.
/// The dot's own u is uniform between 1 - `uneven_share` and 1 + `uneven_share`. Limit: every dot stays
/// round and equally dark, and wear depends on time, not on contacts.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Wear {
    /// Mean fraction of the radius worn off at time 0. Default: `0.2`.
    pub share: f64,
    /// Mean fraction of the radius worn off per second. Default: `0`.
    pub share_per_s: f64,
    /// Spread of the wear between dots, as a fraction of the mean. Default: `0.5`.
    pub uneven_share: f64,
}

impl Default for Wear {
    fn default() -> Self {
        Self { share: 0.2, share_per_s: 0.0, uneven_share: 0.5 }
    }
}

/// Least remaining share of a radius: a ten thousandth of the area, large enough to keep the outline's
/// directions.
const LEAST: f64 = 0.01;

impl Wear {
    /// Remaining share of the radius of a dot that wears `pace` times as fast as average.
    fn left(&self, pace: f64, time_s: f64) -> f64 {
        (1.0 - pace * (self.share + self.share_per_s * time_s.max(0.0))).max(LEAST)
    }
}

impl Effect for Wear {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let check = SceneError::check;
        check((0.0..=1.0).contains(&self.share), "effects.wear.share", self.share, "0 to 1")?;
        let rate = self.share_per_s;
        check((0.0..=10.0).contains(&rate), "effects.wear.share_per_s", rate, "0 to 10 per second")?;
        let uneven = self.uneven_share;
        check((0.0..=1.0).contains(&uneven), "effects.wear.uneven_share", uneven, "0 to 1")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        // Wear at the trajectory's end, or at time 0 without a trajectory.
        let scene = facts.scene;
        let end_s =
            if self.share_per_s > 0.0 { crate::trajectory::Trajectory::new(scene).span_s()[1] } else { 0.0 };
        let gone = 1.0 - self.left(1.0 + self.uneven_share, end_s);
        if !(gone > 0.0) {
            return Bound::NONE;
        }
        let rim_px = gone * facts.dot_radius_mm() * (1.0 + facts.stretch) * facts.optics.lateral_px_per_mm;
        // Ink between dots is as wide as they are; no pixel changes by more than the contrast.
        Bound { px: facts.ellipse_px(), um: 0.0, levels: facts.levels_of_outlines(rim_px) }
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        2.0 * facts.markers()
    }
}

/// Rate of wear of every dot.
#[derive(Clone, Debug)]
pub(crate) struct Worn {
    wear: Wear,
    pace: Vec<f64>,
}

impl Worn {
    pub(crate) fn new(wear: &Wear, seed: u64, markers: usize) -> Self {
        let mut stream = Stream::new(Digest::new().u64(seed).value(), "wear");
        let pace = (0..markers).map(|_| 1.0 + wear.uneven_share * (2.0 * stream.uniform() - 1.0));
        Self { pace: pace.collect(), wear: wear.clone() }
    }

    /// A dot's radius over the printed one.
    pub(crate) fn radius(&self, marker: usize, time_s: f64) -> f64 {
        self.wear.left(self.pace[marker], time_s)
    }
}
