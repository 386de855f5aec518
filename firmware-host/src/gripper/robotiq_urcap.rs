//! Robotiq grippers through the Robotiq Gripper URCap on a UR controller: text over TCP, port 63352.

use super::line::Line;
use super::{Activating, Gripper, GripperError, GripperStatus, WidthTable, check_speed, share};
use crate::codec::robotiq::Fault;
use crate::codec::robotiq_urcap::{self as urcap, LineReader, ReplyError, Variable};
use std::time::{Duration, Instant};

/// Steps of position, speed and force.
const STEPS: f64 = 255.0;
/// `STA` of an active gripper.
const ACTIVE: u8 = 3;

/// Driver of one gripper.
pub struct RobotiqUrcap {
    line: Box<dyn Line>,
    timeout: Duration,
    widths: WidthTable,
    speed_mm_s: (f64, f64),
    position: Option<u8>,
    go: bool,
    activating: Option<Activating>,
}

impl RobotiqUrcap {
    /// Driver on a TCP line; `timeout` is the longest wait for one reply, the rest as for
    /// [`super::Robotiq::new`].
    #[must_use]
    pub fn new(line: Box<dyn Line>, timeout: Duration, widths: WidthTable, speed_mm_s: (f64, f64)) -> Self {
        Self { line, timeout, widths, speed_mm_s, position: None, go: false, activating: None }
    }

    fn ask(&mut self, request: &str) -> Result<String, GripperError> {
        self.line.discard_input()?;
        self.line.send(request.as_bytes())?;
        let deadline = Instant::now() + self.timeout;
        let (mut reader, mut buffer) = (LineReader::default(), [0; 64]);
        loop {
            let count = self.line.receive(&mut buffer, deadline)?;
            match reader.push(&buffer[..count]) {
                Some(line) => return line.map_err(|error| device(&error)),
                None if count > 0 && Instant::now() < deadline => {}
                None => {
                    let (port, waited_ms) = (self.line.name().to_owned(), self.timeout.as_millis() as u64);
                    return Err(GripperError::Silent { port, waited_ms });
                }
            }
        }
    }

    fn get(&mut self, variable: Variable) -> Result<u8, GripperError> {
        let line = self.ask(&urcap::get(variable))?;
        urcap::value(&line, variable).map_err(|error| device(&error))
    }

    fn set(&mut self, values: &[(Variable, u8)]) -> Result<(), GripperError> {
        let line = self.ask(&urcap::set(values))?;
        urcap::acknowledged(&line).map_err(|error| device(&error))
    }
}

fn device(error: &ReplyError) -> GripperError {
    GripperError::Device { message: error.to_string() }
}

impl Gripper for RobotiqUrcap {
    /// Does nothing if the gripper is active without a fault: a second activation would drop a held
    /// object.
    fn activate(&mut self) -> Result<(), GripperError> {
        let fault = Fault(self.get(Variable::Flt)? & 0x0F);
        if self.get(Variable::Sta)? == ACTIVE && !fault.needs_activation() {
            self.position = Some(self.get(Variable::Pre)?);
            self.go = self.get(Variable::Gto)? == 1;
            return Ok(());
        }
        if matches!(self.get(Variable::Obj)?, 1 | 2) {
            return Err(GripperError::Holds);
        }
        self.set(&[(Variable::Act, 0)])?;
        self.set(&[(Variable::Act, 1)])?;
        self.activating = Some(Activating::begun());
        Ok(())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        if self.position.is_none() {
            return Err(GripperError::NotActivated);
        }
        let (min_mm, max_mm) = self.widths.range_mm();
        let count = self.widths.count(width_mm).ok_or(GripperError::Width { width_mm, min_mm, max_mm })?;
        let (slowest, fastest) = self.speed_mm_s;
        let speed = (check_speed(speed_mm_s, self.speed_mm_s)? - slowest) / (fastest - slowest);
        let position = count.round().clamp(0.0, STEPS) as u8;
        self.set(&[
            (Variable::Pos, position),
            (Variable::Spe, (speed * STEPS).round() as u8),
            (Variable::For, share(force, STEPS)? as u8),
            (Variable::Gto, 1),
        ])?;
        (self.position, self.go) = (Some(position), true);
        Ok(())
    }

    fn stop(&mut self) -> Result<(), GripperError> {
        if self.activating.take().is_some() {
            // A sweep is not a move that can be stopped: only a reset ends it.
            return self.set(&[(Variable::Act, 0)]);
        }
        self.set(&[(Variable::Gto, 0)])?;
        self.go = false;
        Ok(())
    }

    fn sent_ns(&self) -> Option<u64> {
        self.line.sent_ns()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let fault = Fault(self.get(Variable::Flt)? & 0x0F);
        if fault.needs_activation() {
            return Err(GripperError::Fault { message: fault.to_string() });
        }
        if let Some(activating) = self.activating {
            if self.get(Variable::Sta)? != ACTIVE {
                let position = self.get(Variable::Pos)?;
                return activating.status(self.widths.width_mm(position.into()), &fault);
            }
            (self.activating, self.position) = (None, Some(self.get(Variable::Pre)?));
        }
        // Until the position request is echoed, the object state belongs to the previous move.
        let echoed = Some(self.get(Variable::Pre)?) == self.position;
        let object = self.get(Variable::Obj)?;
        let position = self.get(Variable::Pos)?;
        Ok(GripperStatus {
            width_mm: self.widths.width_mm(position.into()),
            moving: self.go && !(echoed && object != 0),
            object_detected: self.go && echoed && matches!(object, 1 | 2),
        })
    }
}
