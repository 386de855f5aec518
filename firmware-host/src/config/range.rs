//! Valid ranges of the configuration's numbers. A number outside is in another unit, or would make the job
//! wait forever.

use super::ConfigError;
use gelstereo_core::rig::Rig;

/// No arm reaches farther; such a number is in another unit.
pub(super) const FAR_MM: f64 = 1e4;
pub(super) const FULL_TURN_RAD: f64 = 6.3;
/// No stage can end within a tenth of a second; every stage ends within an hour.
pub(super) const STAGE_S: Range = Range { low: 0.1, high: 3600.0, words: "0.1 to 3600 s" };

pub(super) fn check(
    ok: bool,
    name: &'static str,
    found: f64,
    valid: &'static str,
) -> Result<(), ConfigError> {
    if ok { Ok(()) } else { Err(ConfigError::Value { name, found, valid }) }
}

/// Smallest and largest valid number, and both in words with the unit.
#[derive(Clone, Copy)]
pub(super) struct Range {
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) words: &'static str,
}

impl Range {
    pub(super) fn check(self, name: &'static str, found: f64) -> Result<(), ConfigError> {
        check(found >= self.low && found <= self.high, name, found, self.words)
    }
}

pub(super) const LENGTH_MM: Range = Range { low: 1e-3, high: 1e3, words: "0.001 to 1000 mm" };
pub(super) const SIGMA_MM: Range = Range { low: 1e-4, high: 100.0, words: "0.0001 to 100 mm" };
/// A standard deviation beyond half a turn has no meaning.
pub(super) const SIGMA_RAD: Range = Range { low: 1e-4, high: 3.2, words: "0.0001 to 3.2 rad" };
/// A wider hole accepts the part at any pose.
pub(super) const CLEARANCE_MM: Range = Range { low: 1e-3, high: 10.0, words: "0.001 to 10 mm" };
pub(super) const SPACING_MM: Range = Range { low: 0.01, high: 100.0, words: "0.01 to 100 mm" };
pub(super) const HOLE_MM: Range = Range { low: 0.1, high: 1e3, words: "0.1 to 1000 mm" };
pub(super) const SPEED_MM_S: Range = Range { low: 0.01, high: 1e4, words: "0.01 to 10000 mm/s" };
pub(super) const TIME_S: Range = Range { low: 1e-3, high: 3600.0, words: "0.001 to 3600 s" };
pub(super) const DEADLINE_MS: Range = Range { low: 0.01, high: 1e3, words: "0.01 to 1000 ms" };
pub(super) const PERIODS: Range = Range { low: 1.0, high: 1e3, words: "1 to 1000" };
/// Below this, noise alone would stop moves; see `task/noise.rs`.
pub(super) const SIGMAS: Range = Range { low: 7.3, high: 1e6, words: "7.3 to 1000000" };
pub(super) const RATE_HZ: Range = Range { low: 0.1, high: 1e3, words: "0.1 to 1000 Hz" };

/// The largest integer in TOML.
const MAX_SEED: u64 = i64::MAX as u64;

pub(super) fn check_seed(name: &'static str, seed: u64) -> Result<(), ConfigError> {
    check(seed <= MAX_SEED, name, seed as f64, "0 to 9223372036854775807")
}

/// Largest width and height of an image. No such sensor has larger ones, and buffers have this size.
const MAX_SIDE_PX: usize = 8192;

/// Largest baseline of a sensor.
const MAX_BASELINE_MM: f64 = 1e3;

/// Limits of a sensor's rig, in addition to the checks of every rig.
pub(super) fn check_rig(rig: &Rig) -> Result<(), ConfigError> {
    let sides = [
        ("rig.left.width_px", rig.left.width_px),
        ("rig.left.height_px", rig.left.height_px),
        ("rig.right.width_px", rig.right.width_px),
        ("rig.right.height_px", rig.right.height_px),
    ];
    sides.into_iter().try_for_each(|(name, side)| {
        check((16..=MAX_SIDE_PX).contains(&side), name, side as f64, "16 to 8192 px")
    })?;
    rig.t_right_left.translation_mm.to_array().into_iter().try_for_each(|found| {
        let (name, ok) = ("rig.t_right_left.translation_mm", found.abs() <= MAX_BASELINE_MM);
        check(ok, name, found, "-1000 to 1000 mm")
    })
}
