//! Gripper configuration, and the driver for each kind.

use super::line::{self, Line};
use super::onrobot::{self, OnRobot};
use super::{
    DhRobotics, DynamixelGripper, FeetechGripper, Framing, Gripper, GripperError, Master, Robotiq,
    RobotiqUrcap, WidthTable,
};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Kind of gripper, and its connection.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum GripperConfig {
    /// The simulated gripper.
    #[default]
    Simulated,
    /// Robotiq 2F-85, 2F-140 or Hand-E over Modbus RTU.
    Robotiq {
        /// Serial port by its path, or `tcp://host:54321` for the tool port of a UR controller. Set it to a
        /// name below `/dev/serial/by-id`, which stays the same.
        port: String,
        /// Sets the range of speed and, without `widths`, of the opening. Set it to your gripper's.
        model: RobotiqModel,
        /// Modbus unit address. Valid: 1 to 247. Default: `9`, as delivered. Change it if the gripper was
        /// given another.
        #[serde(default = "robotiq_unit")]
        unit: u8,
        /// Speed of the serial line. Valid: 1200 to 4000000 baud. Default: `115200`, as delivered. Change it
        /// if the gripper was set to another.
        #[serde(default = "robotiq_baud_rate")]
        baud_rate: u32,
        /// Opening against the position register, measured. Default: a straight line of the model.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        widths: Option<WidthTable>,
    },
    /// The same grippers through the Robotiq Gripper URCap on a UR controller.
    RobotiqUrcap {
        /// `tcp://host:63352`. Set it to the controller's address.
        port: String,
        /// Sets the range of speed and, without `widths`, of the opening. Set it to your gripper's.
        model: RobotiqModel,
        /// Opening against the position, measured. Default: a straight line of the model.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        widths: Option<WidthTable>,
    },
    /// DH-Robotics AG-95, PGC, PGE or PGI over Modbus RTU.
    Dh {
        /// Serial port by its path, or `tcp://host:port`. Set it to a name below `/dev/serial/by-id`, which
        /// stays the same.
        port: String,
        /// Modbus unit address. Valid: 1 to 247. Default: `1`, as delivered. Change it if the gripper was
        /// given another.
        #[serde(default = "dh_unit")]
        unit: u8,
        /// Speed of the serial line. Valid: 1200 to 4000000 baud. Default: `115200`, as delivered. Change it
        /// if the gripper was set to another.
        #[serde(default = "robotiq_baud_rate")]
        baud_rate: u32,
        /// Opening against the position, 0 to 1000. Which end is open differs between models: measure both.
        widths: WidthTable,
        /// Slowest and fastest speed, mm/s. Set it to the model's; leave it out for the AG-95, whose speed
        /// cannot be set.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        speed_mm_s: Option<[f64; 2]>,
    },
    /// OnRobot RG2 or RG6 over Modbus TCP.
    OnRobot {
        /// `tcp://host:502`. Set it to the address of the gripper's compute box.
        port: String,
        /// Sets the ranges of opening and force. Set it to your gripper's.
        model: OnRobotModel,
    },
    /// One Dynamixel X servo.
    Dynamixel {
        /// Serial port by its path. Set it to a name below `/dev/serial/by-id`, which stays the same.
        port: String,
        /// Identifier. Valid: 0 to 252. Default: `1`, as delivered. Change it if the servo was given another.
        #[serde(default = "servo_id")]
        id: u8,
        /// Speed of the serial line. Valid: 1200 to 4000000 baud. Default: `1000000`. Change it to what the
        /// servo was set to.
        #[serde(default = "servo_baud_rate")]
        baud_rate: u32,
        /// Opening against the position, measured. Set it always: it is the linkage's.
        widths: WidthTable,
        /// Largest goal current in the servo's own units; see its data sheet. Set it to what the fingers and
        /// the part withstand.
        max_current: u16,
    },
    /// One Feetech STS servo.
    Feetech {
        /// Serial port by its path. Set it to a name below `/dev/serial/by-id`, which stays the same.
        port: String,
        /// Identifier. Valid: 0 to 252. Default: `1`, as delivered. Change it if the servo was given another.
        #[serde(default = "servo_id")]
        id: u8,
        /// Speed of the serial line. Valid: 1200 to 4000000 baud. Default: `1000000`. Change it to what the
        /// servo was set to.
        #[serde(default = "servo_baud_rate")]
        baud_rate: u32,
        /// Opening against the position, measured. Set it always: it is the linkage's.
        widths: WidthTable,
    },
}

const fn robotiq_unit() -> u8 {
    crate::codec::robotiq::DEFAULT_UNIT
}
const fn robotiq_baud_rate() -> u32 {
    115_200
}
const fn dh_unit() -> u8 {
    1
}
const fn servo_id() -> u8 {
    1
}
const fn servo_baud_rate() -> u32 {
    1_000_000
}

/// Models of Robotiq's that share one protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RobotiqModel {
    /// 85 mm.
    #[serde(rename = "2f85")]
    TwoFinger85,
    /// 140 mm.
    #[serde(rename = "2f140")]
    TwoFinger140,
    /// 50 mm, sliding fingers.
    #[serde(rename = "hand_e")]
    HandE,
}

impl RobotiqModel {
    /// Slowest and fastest speed according to the vendor's documents.
    const fn speed_mm_s(self) -> (f64, f64) {
        match self {
            Self::TwoFinger85 | Self::HandE => (20.0, 150.0),
            Self::TwoFinger140 => (30.0, 250.0),
        }
    }

    /// Straight line from the open to the closed position, as in the vendor's driver, with the largest
    /// error of the opening. The linkage of the 2F models deviates by 2.9 mm of 85 in the middle of the
    /// stroke; end stops differ by three counts between grippers.
    fn widths(self) -> Result<WidthTable, GripperError> {
        let (stroke_mm, max_error_mm) = match self {
            Self::TwoFinger85 => (85.0, 4.0),
            Self::TwoFinger140 => (140.0, 6.5),
            Self::HandE => (50.0, 0.7),
        };
        WidthTable::new(vec![[3.0, stroke_mm], [230.0, 0.0]], max_error_mm)
            .map_err(|error| GripperError::Device { message: error.to_string() })
    }
}

/// Models of OnRobot's that share one protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnRobotModel {
    /// 110 mm, 40 N.
    Rg2,
    /// 160 mm, 120 N.
    Rg6,
}

/// A status takes 2 ms on a serial line at 115200 baud, plus up to 16 ms of a USB adapter's latency timer.
const REPLY_TIMEOUT: Duration = Duration::from_millis(100);
/// The Compute Box and the URCap reply through another computer.
const NETWORK_TIMEOUT: Duration = Duration::from_millis(300);

impl GripperConfig {
    /// Port of a real gripper: a serial port's path, or `tcp://host:port`.
    #[must_use]
    pub fn port(&self) -> Option<&str> {
        match self {
            Self::Simulated => None,
            Self::RobotiqUrcap { port, .. }
            | Self::OnRobot { port, .. }
            | Self::Robotiq { port, .. }
            | Self::Dh { port, .. }
            | Self::Dynamixel { port, .. }
            | Self::Feetech { port, .. } => Some(port),
        }
    }

    /// Baud rate of a serial port; TCP connections have none.
    const fn baud_rate(&self) -> u32 {
        match self {
            Self::Simulated | Self::RobotiqUrcap { .. } | Self::OnRobot { .. } => 0,
            Self::Robotiq { baud_rate, .. }
            | Self::Dh { baud_rate, .. }
            | Self::Dynamixel { baud_rate, .. }
            | Self::Feetech { baud_rate, .. } => *baud_rate,
        }
    }

    /// Opens the port of a real gripper without moving it. `None` for the simulated one.
    ///
    /// # Errors
    /// [`GripperError::Port`].
    pub fn open(&self) -> Result<Option<Box<dyn Gripper + Send>>, GripperError> {
        let Some(port) = self.port() else {
            return Ok(None);
        };
        self.driver(line::open(port, self.baud_rate())?)
    }

    /// Driver on an open line. `None` for the simulated gripper.
    ///
    /// # Errors
    /// [`GripperError::Device`] if the model's own width table is invalid.
    pub fn driver(&self, line: Box<dyn Line>) -> Result<Option<Box<dyn Gripper + Send>>, GripperError> {
        let widths = |given: &Option<WidthTable>, model: RobotiqModel| match given {
            Some(table) => Ok(table.clone()),
            None => model.widths(),
        };
        Ok(Some(match self {
            Self::Simulated => return Ok(None),
            Self::Robotiq { model, unit, widths: given, .. } => {
                let master = Master::new(line, Framing::Rtu, *unit, REPLY_TIMEOUT);
                Box::new(Robotiq::new(master, widths(given, *model)?, model.speed_mm_s()))
            }
            Self::RobotiqUrcap { model, widths: given, .. } => {
                Box::new(RobotiqUrcap::new(line, NETWORK_TIMEOUT, widths(given, *model)?, model.speed_mm_s()))
            }
            Self::Dh { unit, widths, speed_mm_s, .. } => {
                let master = Master::new(line, Framing::Rtu, *unit, REPLY_TIMEOUT);
                Box::new(DhRobotics::new(master, widths.clone(), speed_mm_s.map(|[low, high]| (low, high))))
            }
            Self::OnRobot { model, .. } => {
                let master = Master::new(line, Framing::Tcp, onrobot::DEFAULT_UNIT, NETWORK_TIMEOUT);
                let (max_width_mm, max_force_n) = match model {
                    OnRobotModel::Rg2 => (110.0, 40.0),
                    OnRobotModel::Rg6 => (160.0, 120.0),
                };
                Box::new(OnRobot::new(master, max_width_mm, max_force_n))
            }
            Self::Dynamixel { id, widths, max_current, .. } => {
                Box::new(DynamixelGripper::new(line, *id, REPLY_TIMEOUT, widths.clone(), *max_current))
            }
            Self::Feetech { id, widths, .. } => {
                Box::new(FeetechGripper::new(line, *id, REPLY_TIMEOUT, widths.clone()))
            }
        }))
    }
}
