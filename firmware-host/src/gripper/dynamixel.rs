//! Gripper with one Dynamixel X servo (XL330, XC330, XM430 ...), protocol 2.0, in current-based position
//! control.

use super::line::Line;
use super::servo;
use super::{Gripper, GripperError, GripperStatus, WidthTable, check_speed, share};
use crate::codec::dynamixel::{Instruction, Status, StatusReader};
use std::time::{Duration, Instant};

/// Addresses of the X series' control table.
mod address {
    pub const OPERATING_MODE: u16 = 11;
    pub const TORQUE_ENABLE: u16 = 64;
    pub const HARDWARE_ERROR: u16 = 70;
    pub const GOAL_CURRENT: u16 = 102;
    pub const PROFILE_VELOCITY: u16 = 112;
    pub const GOAL_POSITION: u16 = 116;
    /// Moving, moving status, PWM, current, velocity, position: 14 bytes.
    pub const STATE: u16 = 122;
}

/// `OPERATING_MODE`: position control with a current limit, which sets the grip force.
const CURRENT_BASED_POSITION: u8 = 5;
/// Unit of `PROFILE_VELOCITY`, turns per minute.
const VELOCITY_UNIT_RPM: f64 = 0.229;
const COUNTS_PER_TURN: f64 = 4096.0;
/// 92 turns per minute. A servo that cannot reach its goal velocity moves at its fastest.
const MAX_VELOCITY_UNITS: f64 = 400.0;

/// Driver of one servo.
pub struct DynamixelGripper {
    line: Box<dyn Line>,
    id: u8,
    timeout: Duration,
    widths: WidthTable,
    max_current: u16,
    speed_mm_s: (f64, f64),
    goal: Option<i32>,
}

impl DynamixelGripper {
    /// Driver of servo `id` on a line. `widths` maps its position to the opening; `max_current` is the
    /// largest goal current in the servo's own units.
    #[must_use]
    pub fn new(line: Box<dyn Line>, id: u8, timeout: Duration, widths: WidthTable, max_current: u16) -> Self {
        let count_mm = mm_per_count(&widths);
        let slowest = VELOCITY_UNIT_RPM / 60.0 * COUNTS_PER_TURN * count_mm;
        let speed_mm_s = (slowest, slowest * MAX_VELOCITY_UNITS);
        Self { line, id, timeout, widths, max_current, speed_mm_s, goal: None }
    }

    fn ask(&mut self, instruction: Instruction<'_>) -> Result<Status, GripperError> {
        for _ in 0..servo::ATTEMPTS {
            self.line.discard_input()?;
            self.line.send(&instruction.encode(self.id))?;
            let deadline = Instant::now() + self.timeout;
            let (mut reader, mut buffer) = (StatusReader::default(), [0; 64]);
            loop {
                let count = self.line.receive(&mut buffer, deadline)?;
                match reader.push(&buffer[..count]) {
                    Some(Ok(status)) if status.id == self.id => return self.checked(status),
                    Some(Err(error @ crate::codec::dynamixel::DynamixelError::Refused { .. })) => {
                        return Err(GripperError::Device { message: error.to_string() });
                    }
                    _ if count > 0 && Instant::now() < deadline => {}
                    _ => break,
                }
            }
        }
        let waited_ms = (self.timeout * servo::ATTEMPTS).as_millis() as u64;
        Err(GripperError::Silent { port: self.line.name().to_owned(), waited_ms })
    }

    fn checked(&self, status: Status) -> Result<Status, GripperError> {
        if status.alert {
            let message = format!(
                "servo {} has a hardware fault: its register {} says which; reboot it",
                self.id,
                address::HARDWARE_ERROR
            );
            return Err(GripperError::Fault { message });
        }
        Ok(status)
    }

    fn write(&mut self, address: u16, data: &[u8]) -> Result<(), GripperError> {
        self.ask(Instruction::Write { address, data }).map(|_| ())
    }

    /// Whether the servo moves, and its position.
    fn state(&mut self) -> Result<(bool, i32), GripperError> {
        let status = self.ask(Instruction::Read { address: address::STATE, count: 14 })?;
        let data: [u8; 14] = status.data.try_into().map_err(|_| GripperError::Device {
            message: "a reply has another length than was asked for".to_owned(),
        })?;
        Ok((data[0] != 0, i32::from_le_bytes([data[10], data[11], data[12], data[13]])))
    }
}

/// Millimetres of opening per count, averaged over the table.
fn mm_per_count(widths: &WidthTable) -> f64 {
    let (min_mm, max_mm) = widths.range_mm();
    match (widths.count(min_mm), widths.count(max_mm)) {
        (Some(closed), Some(open)) => (max_mm - min_mm) / (open - closed).abs(),
        _ => f64::INFINITY,
    }
}

impl Gripper for DynamixelGripper {
    /// Switches torque on if it is off, with the goal at the present position, so that nothing moves.
    fn activate(&mut self) -> Result<(), GripperError> {
        let (_, position) = self.state()?;
        let torque = self.ask(Instruction::Read { address: address::TORQUE_ENABLE, count: 1 })?;
        if torque.data != [1] {
            self.write(address::OPERATING_MODE, &[CURRENT_BASED_POSITION])?;
            self.write(address::TORQUE_ENABLE, &[1])?;
            self.write(address::GOAL_POSITION, &position.to_le_bytes())?;
        }
        self.goal = Some(position);
        Ok(())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        if self.goal.is_none() {
            return Err(GripperError::NotActivated);
        }
        let (min_mm, max_mm) = self.widths.range_mm();
        let count = self.widths.count(width_mm).ok_or(GripperError::Width { width_mm, min_mm, max_mm })?;
        let speed = check_speed(speed_mm_s, self.speed_mm_s)? / self.speed_mm_s.0;
        let current = share(force, f64::from(self.max_current))? as u16;
        self.write(address::GOAL_CURRENT, &current.to_le_bytes())?;
        self.write(address::PROFILE_VELOCITY, &(speed.round() as u32).to_le_bytes())?;
        let goal = count.round() as i32;
        self.write(address::GOAL_POSITION, &goal.to_le_bytes())?;
        self.goal = Some(goal);
        Ok(())
    }

    /// Moving fingers get their present position as goal. Fingers at rest keep their goal: the remaining
    /// distance to it produces the grip force.
    fn stop(&mut self) -> Result<(), GripperError> {
        let (moving, position) = self.state()?;
        if moving {
            self.write(address::GOAL_POSITION, &position.to_le_bytes())?;
            self.goal = Some(position);
        }
        Ok(())
    }

    fn sent_ns(&self) -> Option<u64> {
        self.line.sent_ns()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let (moving, position) = self.state()?;
        Ok(servo::status(&self.widths, self.goal, moving, position))
    }
}
