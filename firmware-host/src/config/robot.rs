//! The robot.

use super::ConfigError;
use super::range::{Range, check};
use crate::robot::{BridgeRobot, Robot, RobotError};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Kind of robot, and its connection.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum RobotConfig {
    /// The simulated robot.
    #[default]
    Simulated,
    /// Any robot behind a TCP connection; docs/robot-bridge.md has the protocol.
    Bridge {
        /// `host:port` of the program that drives the robot. Set it to yours.
        address: String,
        /// Time limit of an answer. Valid: 1 to 60000 ms. Default: `500` ms. Raise it for a slow controller.
        #[serde(default = "timeout_ms")]
        timeout_ms: f64,
        /// Time without a request after which the robot stops by itself; at least `timeout_ms`. Valid: 1 to
        /// 60000 ms. Default: `1000` ms. Lower it where the robot must stop sooner.
        #[serde(default = "watchdog_ms")]
        watchdog_ms: f64,
    },
}

const fn timeout_ms() -> f64 {
    500.0
}
const fn watchdog_ms() -> f64 {
    1000.0
}

const TIME_MS: Range = Range { low: 1.0, high: 60_000.0, words: "1 to 60000 ms" };

impl RobotConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let Self::Bridge { timeout_ms, watchdog_ms, .. } = self else {
            return Ok(());
        };
        TIME_MS.check("robot.timeout_ms", *timeout_ms)?;
        TIME_MS.check("robot.watchdog_ms", *watchdog_ms)?;
        check(watchdog_ms >= timeout_ms, "robot.watchdog_ms", *watchdog_ms, "robot.timeout_ms or more")
    }

    /// Connection of a real robot.
    #[must_use]
    pub fn address(&self) -> Option<&str> {
        match self {
            Self::Simulated => None,
            Self::Bridge { address, .. } => Some(address),
        }
    }

    /// Connects to a real robot; nothing moves. `None` for the simulated one.
    ///
    /// # Errors
    /// [`RobotError`].
    pub fn open(&self) -> Result<Option<Box<dyn Robot + Send>>, RobotError> {
        let Self::Bridge { address, timeout_ms, watchdog_ms } = self else {
            return Ok(None);
        };
        let duration = |milliseconds: f64| Duration::from_secs_f64(milliseconds * 1e-3);
        Ok(Some(Box::new(BridgeRobot::connect(address, duration(*timeout_ms), duration(*watchdog_ms))?)))
    }
}
