//! What a number of the configuration may be. A number outside is in another unit, or would make the job wait for ever.

use super::ConfigError;

/// Farther than this no arm reaches: such a number is in another unit.
pub(super) const FAR_MM: f64 = 1e4;
pub(super) const FULL_TURN_RAD: f64 = 2.0 * core::f64::consts::PI;

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

pub(super) const LENGTH_MM: Range = Range { low: 1e-6, high: FAR_MM, words: "0.000001 to 10000 mm" };
pub(super) const ANGLE_RAD: Range = Range { low: 1e-6, high: FULL_TURN_RAD, words: "0.000001 to 6.2832 rad" };
pub(super) const SPEED_MM_S: Range = Range { low: 0.01, high: 1e4, words: "0.01 to 10000 mm/s" };
pub(super) const TIME_S: Range = Range { low: 1e-3, high: 3600.0, words: "0.001 to 3600 s" };
pub(super) const RATE_HZ: Range = Range { low: 0.1, high: 1e4, words: "0.1 to 10000 Hz" };
