//! Gripper with one Feetech STS servo (STS3215 and relatives), as in low-cost arms.

use super::line::Line;
use super::servo;
use super::{Gripper, GripperError, GripperStatus, WidthTable, check_speed, share};
use crate::codec::feetech::{FeetechError, Instruction, Status, StatusReader, signed};
use std::time::{Duration, Instant};

/// Addresses of the STS series' memory table.
mod address {
    pub const TORQUE_ENABLE: u8 = 40;
    /// Position, time, speed, torque limit: 8 bytes.
    pub const GOAL: u8 = 42;
    /// From position to moving flag: 11 bytes.
    pub const STATE: u8 = 56;
}

/// Offset of the moving flag (register 66) in the state.
const MOVING: usize = 10;
/// The torque limit is in thousandths.
const TORQUE_STEPS: f64 = 1000.0;
/// An unloaded STS3215 turns at most about 3400 counts per second; it treats faster goals as its
/// fastest.
const MAX_COUNTS_PER_S: f64 = 3400.0;
/// Positions and speeds have their sign in bit 15.
const SIGN_BIT: u32 = 15;

/// Driver of one servo.
pub struct FeetechGripper {
    line: Box<dyn Line>,
    id: u8,
    timeout: Duration,
    widths: WidthTable,
    goal: Option<i32>,
}

impl FeetechGripper {
    /// Driver of servo `id` on a line. `widths` maps its position to the opening.
    #[must_use]
    pub fn new(line: Box<dyn Line>, id: u8, timeout: Duration, widths: WidthTable) -> Self {
        Self { line, id, timeout, widths, goal: None }
    }

    fn ask(&mut self, instruction: Instruction<'_>) -> Result<Status, GripperError> {
        let device = |error: FeetechError| GripperError::Device { message: error.to_string() };
        let packet = instruction.encode(self.id).map_err(device)?;
        for _ in 0..servo::ATTEMPTS {
            self.line.discard_input()?;
            self.line.send(&packet)?;
            let deadline = Instant::now() + self.timeout;
            let (mut reader, mut buffer) = (StatusReader::after(&packet), [0; 64]);
            loop {
                let count = self.line.receive(&mut buffer, deadline)?;
                match reader.push(&buffer[..count]) {
                    Some(Ok(status)) if status.id == self.id => return faultless(status),
                    _ if count > 0 && Instant::now() < deadline => {}
                    _ => break,
                }
            }
        }
        let waited_ms = (self.timeout * servo::ATTEMPTS).as_millis() as u64;
        Err(GripperError::Silent { port: self.line.name().to_owned(), waited_ms })
    }

    fn write(&mut self, address: u8, data: &[u8]) -> Result<(), GripperError> {
        self.ask(Instruction::Write { address, data }).map(|_| ())
    }

    /// Whether the servo moves, and its position.
    fn state(&mut self) -> Result<(bool, i32), GripperError> {
        let status = self.ask(Instruction::Read { address: address::STATE, count: MOVING as u8 + 1 })?;
        let data: [u8; MOVING + 1] = status.data.try_into().map_err(|_| GripperError::Device {
            message: "a reply has another length than was asked for".to_owned(),
        })?;
        Ok((data[MOVING] != 0, signed(u16::from_le_bytes([data[0], data[1]]), SIGN_BIT)))
    }

    /// Writes the position and the values after it in the memory table.
    fn go(&mut self, goal: i32, rest: &[u16]) -> Result<(), GripperError> {
        let position = (goal.unsigned_abs() as u16 & 0x7FFF) | u16::from(goal < 0) << SIGN_BIT;
        let goals: Vec<u8> =
            std::iter::once(position).chain(rest.iter().copied()).flat_map(u16::to_le_bytes).collect();
        self.write(address::GOAL, &goals)?;
        self.goal = Some(goal);
        Ok(())
    }
}

fn faultless(status: Status) -> Result<Status, GripperError> {
    if status.faults.0 == 0 {
        return Ok(status);
    }
    Err(GripperError::Fault { message: format!("servo {}: {}", status.id, status.faults) })
}

impl Gripper for FeetechGripper {
    /// Switches torque on, which holds the present position: nothing moves.
    fn activate(&mut self) -> Result<(), GripperError> {
        let (_, position) = self.state()?;
        self.write(address::TORQUE_ENABLE, &[1])?;
        self.goal = Some(position);
        Ok(())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        if self.goal.is_none() {
            return Err(GripperError::NotActivated);
        }
        let (min_mm, max_mm) = self.widths.range_mm();
        let outside = GripperError::Width { width_mm, min_mm, max_mm };
        let (Some(count), Some(closed), Some(open)) =
            (self.widths.count(width_mm), self.widths.count(min_mm), self.widths.count(max_mm))
        else {
            return Err(outside);
        };
        let counts_per_mm = (open - closed).abs() / (max_mm - min_mm);
        let range = (1.0 / counts_per_mm, MAX_COUNTS_PER_S / counts_per_mm);
        let counts_per_s = check_speed(speed_mm_s, range)? * counts_per_mm;
        let torque = share(force, TORQUE_STEPS)? as u16;
        // With a time of 0 the servo follows the speed.
        self.go(count.round() as i32, &[0, counts_per_s.round().max(1.0) as u16, torque])
    }

    /// Moving fingers get their present position as goal; the torque limit is kept. Fingers at rest keep
    /// their goal: the remaining distance to it produces the grip force.
    fn stop(&mut self) -> Result<(), GripperError> {
        let (moving, position) = self.state()?;
        if moving { self.go(position, &[]) } else { Ok(()) }
    }

    fn sent_ns(&self) -> Option<u64> {
        self.line.sent_ns()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let (moving, position) = self.state()?;
        Ok(servo::status(&self.widths, self.goal, moving, position))
    }
}
