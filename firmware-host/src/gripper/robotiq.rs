//! Robotiq 2F-85, 2F-140 and Hand-E over Modbus RTU, by serial adapter or TCP (port 54321 of the UR
//! controller).

use super::{Activating, Gripper, GripperError, GripperStatus, Master, WidthTable, check_speed, share};
use crate::codec::robotiq::{Activation, Command, Motion, READ_STATUS, REGISTERS, Status, exchange};

/// Steps of position, speed and force.
const STEPS: f64 = 255.0;

/// Driver of one gripper.
pub struct Robotiq {
    master: Master,
    widths: WidthTable,
    speed_mm_s: (f64, f64),
    /// Present command of the gripper; unknown until its status has been read.
    command: Option<Command>,
    activating: Option<Activating>,
}

/// Command of an active gripper reconstructed from its status, so that writing it again moves nothing.
const fn command_of(status: &Status) -> Command {
    Command {
        activate: status.activated,
        go: status.go,
        release: false,
        release_by_opening: false,
        position: status.requested,
        speed: 0,
        force: 0,
    }
}

impl Robotiq {
    /// Driver on a Modbus RTU line. `widths` maps the position register to the opening; `speed_mm_s` is
    /// the slowest and the fastest speed of the model.
    #[must_use]
    pub fn new(master: Master, widths: WidthTable, speed_mm_s: (f64, f64)) -> Self {
        Self { master, widths, speed_mm_s, command: None, activating: None }
    }

    fn write(&mut self, command: Command) -> Result<Status, GripperError> {
        let registers = command.registers();
        let status: [u16; REGISTERS as usize] = self.master.read(exchange(&registers))?;
        self.command = Some(command);
        Ok(Status::from_registers(status))
    }

    fn read(&mut self) -> Result<Status, GripperError> {
        let status = self.master.read(READ_STATUS).map(Status::from_registers)?;
        self.command.get_or_insert(command_of(&status));
        Ok(status)
    }

    /// Present command. It is read from the gripper first if unknown, so that no write resets the
    /// gripper by accident.
    fn command(&mut self) -> Result<Command, GripperError> {
        match self.command {
            Some(command) => Ok(command),
            None => self.read().map(|status| command_of(&status)),
        }
    }
}

impl Gripper for Robotiq {
    /// Does nothing if the gripper is active without a fault: a second activation would drop a held
    /// object.
    fn activate(&mut self) -> Result<(), GripperError> {
        let status = self.read()?;
        let active = status.activation == Activation::Active;
        if active && !status.fault.needs_activation() {
            self.command = Some(command_of(&status));
            return Ok(());
        }
        // A reset gripper keeps its fingers in place, so an object held before the reset is still held.
        if matches!(status.motion, Motion::ContactClosing | Motion::ContactOpening) {
            return Err(GripperError::Holds);
        }
        // A rising edge activates.
        self.write(Command::default())?;
        self.write(Command { activate: true, ..Command::default() })?;
        self.activating = Some(Activating::begun());
        Ok(())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        if self.activating.is_some() || !self.command()?.activate {
            return Err(GripperError::NotActivated);
        }
        let (min_mm, max_mm) = self.widths.range_mm();
        let count = self.widths.count(width_mm).ok_or(GripperError::Width { width_mm, min_mm, max_mm })?;
        let (slowest, fastest) = self.speed_mm_s;
        let speed = (check_speed(speed_mm_s, self.speed_mm_s)? - slowest) / (fastest - slowest);
        let command = Command {
            activate: true,
            go: true,
            position: count.round().clamp(0.0, STEPS) as u8,
            speed: (speed * STEPS).round() as u8,
            force: share(force, STEPS)? as u8,
            ..Command::default()
        };
        self.write(command).map(|_| ())
    }

    fn stop(&mut self) -> Result<(), GripperError> {
        if self.activating.take().is_some() {
            // A sweep is not a move that can be stopped: only a reset ends it.
            return self.write(Command::default()).map(|_| ());
        }
        let command = Command { go: false, ..self.command()? };
        self.write(command).map(|_| ())
    }

    fn sent_ns(&self) -> Option<u64> {
        self.master.sent_ns()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let status = self.read()?;
        if status.fault.needs_activation() {
            return Err(GripperError::Fault { message: status.fault.to_string() });
        }
        let width_mm = self.widths.width_mm(status.position.into());
        if status.activation == Activation::Active {
            self.activating = None;
        } else if let Some(activating) = self.activating {
            return activating.status(width_mm, &status.fault);
        }
        let command = self.command()?;
        // Until the request is echoed, the object bits belong to the previous move.
        let echoed = status.requested == command.position;
        let stopped = status.motion != Motion::Moving;
        Ok(GripperStatus {
            width_mm,
            moving: command.go && !(echoed && stopped),
            object_detected: status.go
                && echoed
                && matches!(status.motion, Motion::ContactClosing | Motion::ContactOpening),
        })
    }
}
