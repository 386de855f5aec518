//! The gripper's numbers.

use super::ConfigError;
use super::range::{Range, check};
use crate::gripper::GripperConfig;

const UNIT: Range = Range { low: 1.0, high: 247.0, words: "1 to 247" };
const SERVO: Range = Range { low: 0.0, high: 252.0, words: "0 to 252" };
const BAUD: Range = Range { low: 1200.0, high: 4e6, words: "1200 to 4000000 baud" };

impl GripperConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match self {
            Self::Simulated | Self::RobotiqUrcap { .. } | Self::OnRobot { .. } => Ok(()),
            Self::Robotiq { unit, baud_rate, .. } => {
                UNIT.check("gripper.unit", (*unit).into())?;
                BAUD.check("gripper.baud_rate", (*baud_rate).into())
            }
            Self::Dh { unit, baud_rate, speed_mm_s, .. } => {
                UNIT.check("gripper.unit", (*unit).into())?;
                BAUD.check("gripper.baud_rate", (*baud_rate).into())?;
                let [slowest, fastest] = speed_mm_s.unwrap_or([1.0, 2.0]);
                let rises = slowest > 0.0 && fastest > slowest && fastest.is_finite();
                check(rises, "gripper.speed_mm_s", slowest, "two speeds above 0, the slower one first")
            }
            Self::Dynamixel { id, baud_rate, .. } | Self::Feetech { id, baud_rate, .. } => {
                SERVO.check("gripper.id", (*id).into())?;
                BAUD.check("gripper.baud_rate", (*baud_rate).into())
            }
        }
    }
}
