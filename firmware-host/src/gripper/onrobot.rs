//! OnRobot RG2 and RG6 over Modbus TCP, through the Compute Box.

use super::{Gripper, GripperError, GripperStatus, Master, share};
use crate::codec::modbus::Request;

/// Unit address of the gripper behind the Compute Box.
pub const DEFAULT_UNIT: u8 = 65;
/// Force, width, control: three registers.
const COMMAND: u16 = 0x0000;
const CONTROL: u16 = 0x0002;
/// Width without the fingertips, then status: two registers.
const STATE: u16 = 0x010B;

const GRIP: u16 = 1;
const STOP: u16 = 8;

const BUSY: u16 = 1;
const GRIP_DETECTED: u16 = 1 << 1;
const SAFETY_SWITCHES: u16 = 1 << 3 | 1 << 5;
const SAFETY_ERROR: u16 = 1 << 6;
/// Widths and forces are in tenths of mm and N.
const TENTHS: f64 = 10.0;

/// Driver of one gripper.
pub struct OnRobot {
    master: Master,
    max_width_mm: f64,
    max_force_n: f64,
}

impl OnRobot {
    /// Driver on a Modbus TCP line, with the model's largest opening and force.
    #[must_use]
    pub const fn new(master: Master, max_width_mm: f64, max_force_n: f64) -> Self {
        Self { master, max_width_mm, max_force_n }
    }

    fn state(&mut self) -> Result<(f64, u16), GripperError> {
        let [width, status] = self.master.read(Request::ReadHolding { address: STATE, count: 2 })?;
        if status & SAFETY_ERROR != 0 {
            let message = "the safety circuit has a fault; switch the gripper's power off and on";
            return Err(GripperError::Fault { message: message.to_owned() });
        }
        if status & SAFETY_SWITCHES != 0 {
            let message = "a safety switch was touched; switch the gripper's power off and on";
            return Err(GripperError::Fault { message: message.to_owned() });
        }
        Ok((f64::from(width.cast_signed()) / TENTHS, status))
    }
}

impl Gripper for OnRobot {
    /// Only checks the state: these grippers need no activation.
    fn activate(&mut self) -> Result<(), GripperError> {
        self.state().map(|_| ())
    }

    /// The gripper derives its speed from the force.
    fn move_to(&mut self, width_mm: f64, _speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        let (min_mm, max_mm) = (0.0, self.max_width_mm);
        if !(width_mm >= min_mm && width_mm <= max_mm) {
            return Err(GripperError::Width { width_mm, min_mm, max_mm });
        }
        // The gripper accepts commands only while it is not busy.
        if self.state()?.1 & BUSY != 0 {
            self.stop()?;
        }
        let values =
            [share(force, self.max_force_n * TENTHS)? as u16, (width_mm * TENTHS).round() as u16, GRIP];
        self.master.ask(Request::WriteMultiple { address: COMMAND, values: &values }).map(|_| ())
    }

    fn stop(&mut self) -> Result<(), GripperError> {
        self.master.ask(Request::WriteSingle { address: CONTROL, value: STOP }).map(|_| ())
    }

    fn sent_ns(&self) -> Option<u64> {
        self.master.sent_ns()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let (width_mm, status) = self.state()?;
        Ok(GripperStatus {
            width_mm,
            moving: status & BUSY != 0,
            object_detected: status & GRIP_DETECTED != 0,
        })
    }
}
