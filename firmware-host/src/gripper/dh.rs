//! DH-Robotics AG-95, PGC, PGE and PGI over Modbus RTU.

use super::{Activating, Gripper, GripperError, GripperStatus, Master, WidthTable, check_speed, share};
use crate::codec::modbus::Request;

const INITIALISE: u16 = 0x0100;
const CLOSING_FORCE: u16 = 0x0101;
const POSITION: u16 = 0x0103;
/// 0x0102 is the opening force of the PGE-2, though some drivers write the speed there.
const SPEED: u16 = 0x0104;
/// State of initialisation, state of the grip, and position: three registers.
const STATE: u16 = 0x0200;

/// `INITIALISE`: find the end stops by opening and closing once.
const FULL: u16 = 0xA5;
const INITIALISED: u16 = 1;
const MOVING: u16 = 0;
const CAUGHT: u16 = 2;
const DROPPED: u16 = 3;

/// Force and speed are percentages of the largest; the manual's smallest force is 20 %.
const PERCENT: f64 = 100.0;
const MIN_FORCE_PERCENT: f64 = 20.0;

/// Driver of one gripper.
pub struct DhRobotics {
    master: Master,
    widths: WidthTable,
    /// `None` for the AG-95, whose speed cannot be set.
    speed_mm_s: Option<(f64, f64)>,
    target: Option<u16>,
    initialising: Option<Activating>,
}

impl DhRobotics {
    /// Driver on a Modbus RTU line. `widths` maps the position, 0 to 1000, to the opening.
    #[must_use]
    pub const fn new(master: Master, widths: WidthTable, speed_mm_s: Option<(f64, f64)>) -> Self {
        Self { master, widths, speed_mm_s, target: None, initialising: None }
    }

    fn write(&mut self, address: u16, value: u16) -> Result<(), GripperError> {
        self.master.ask(Request::WriteSingle { address, value }).map(|_| ())
    }

    fn state(&mut self) -> Result<[u16; 3], GripperError> {
        self.master.read(Request::ReadHolding { address: STATE, count: 3 })
    }
}

impl Gripper for DhRobotics {
    /// Does nothing if the gripper is already initialised: repeating it would drop a held object.
    fn activate(&mut self) -> Result<(), GripperError> {
        let [initialised, grip, position] = self.state()?;
        if initialised == INITIALISED {
            self.target = Some(position);
            return Ok(());
        }
        if grip == CAUGHT {
            return Err(GripperError::Holds);
        }
        self.write(INITIALISE, FULL)?;
        self.initialising = Some(Activating::begun());
        Ok(())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        if self.target.is_none() {
            return Err(GripperError::NotActivated);
        }
        let (min_mm, max_mm) = self.widths.range_mm();
        let count = self.widths.count(width_mm).ok_or(GripperError::Width { width_mm, min_mm, max_mm })?;
        let force = MIN_FORCE_PERCENT + share(force, PERCENT - MIN_FORCE_PERCENT)?;
        if let Some((slowest, fastest)) = self.speed_mm_s {
            let speed = (check_speed(speed_mm_s, (slowest, fastest))? - slowest) / (fastest - slowest);
            self.write(SPEED, (1.0 + speed * (PERCENT - 1.0)).round() as u16)?;
        }
        self.write(CLOSING_FORCE, force as u16)?;
        // Writing the position starts the move, so it comes last.
        let target = count.round() as u16;
        self.write(POSITION, target)?;
        self.target = Some(target);
        Ok(())
    }

    /// The protocol has no stop command: the present position becomes the target, also during
    /// initialisation.
    fn stop(&mut self) -> Result<(), GripperError> {
        let [_, grip, position] = self.state()?;
        if self.initialising.take().is_some() {
            return self.write(POSITION, position);
        }
        if grip == MOVING {
            self.write(POSITION, position)?;
            self.target = Some(position);
        }
        Ok(())
    }

    fn sent_ns(&self) -> Option<u64> {
        self.master.sent_ns()
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let [initialised, grip, position] = self.state()?;
        let width_mm = self.widths.width_mm(position.into());
        if let Some(initialising) = self.initialising {
            if initialised != INITIALISED {
                return initialising.status(width_mm, &"it is not initialised");
            }
            (self.initialising, self.target) = (None, Some(position));
        }
        if grip == DROPPED {
            return Err(GripperError::Fault { message: "what was held has dropped".to_owned() });
        }
        Ok(GripperStatus { width_mm, moving: grip == MOVING, object_detected: grip == CAUGHT })
    }
}
