//! Registers of Robotiq's adaptive grippers 2F-85, 2F-140 and Hand-E (instruction manuals, section
//! "Control").
//!
//! Command and status have three registers each; the manual counts their bytes from the high byte of the
//! first one.

use super::modbus::Request;
use std::fmt;

/// Factory unit address.
pub const DEFAULT_UNIT: u8 = 9;
/// First register of the command.
pub const COMMAND_ADDRESS: u16 = 0x03E8;
/// First register of the status.
pub const STATUS_ADDRESS: u16 = 0x07D0;
/// Number of registers of the command, and of the status.
pub const REGISTERS: u16 = 3;

/// Command to the gripper. All zeros reset it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Command {
    /// `rACT`: stay activated. A rising edge activates: the fingers sweep and drop what they hold.
    pub activate: bool,
    /// `rGTO`: move to the position. If cleared, the fingers stop where they are.
    pub go: bool,
    /// `rATR`: slow emergency release.
    pub release: bool,
    /// `rARD`: release by opening instead of closing.
    pub release_by_opening: bool,
    /// `rPR`: 0 open, 255 closed.
    pub position: u8,
    /// `rSP`: 0 slowest, 255 fastest.
    pub speed: u8,
    /// `rFR`: 0 weakest, 255 strongest.
    pub force: u8,
}

impl Command {
    /// Encodes the command as registers.
    #[must_use]
    pub const fn registers(&self) -> [u16; REGISTERS as usize] {
        let action = self.activate as u16
            | (self.go as u16) << 3
            | (self.release as u16) << 4
            | (self.release_by_opening as u16) << 5;
        [action << 8, self.position as u16, (self.speed as u16) << 8 | self.force as u16]
    }
}

/// Request for the status alone.
pub const READ_STATUS: Request<'static> = Request::ReadHolding { address: STATUS_ADDRESS, count: REGISTERS };

/// Request that writes a command and then reads the status in one exchange.
#[must_use]
pub const fn exchange(command: &[u16; REGISTERS as usize]) -> Request<'_> {
    Request::ReadWrite {
        read_address: STATUS_ADDRESS,
        read_count: REGISTERS,
        write_address: COMMAND_ADDRESS,
        values: command,
    }
}

/// `gSTA`: state of activation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Reset, or released in an emergency.
    Reset,
    /// The fingers are sweeping.
    Activating,
    /// Ready for moves.
    Active,
    /// Value without meaning in the manual.
    Reserved,
}

/// `gOBJ`: motion of the fingers. It is outdated until [`Status::requested`] repeats the commanded
/// position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Moving.
    Moving,
    /// Stopped by an object while opening.
    ContactOpening,
    /// Stopped by an object while closing.
    ContactClosing,
    /// At the position: nothing is held, or the object was lost.
    Arrived,
}

/// Status of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// `gACT`: repeats `rACT`.
    pub activated: bool,
    /// `gGTO`: repeats `rGTO`.
    pub go: bool,
    /// `gSTA`.
    pub activation: Activation,
    /// `gOBJ`.
    pub motion: Motion,
    /// `gFLT`.
    pub fault: Fault,
    /// `kFLT`: fault number of a Robotiq controller, see its manual; 0 without a controller.
    pub controller_fault: u8,
    /// `gPR`: repeats `rPR`.
    pub requested: u8,
    /// `gPO`: 0 open, 255 closed.
    pub position: u8,
    /// `gCU`: motor current in steps of about 10 mA.
    pub current: u8,
}

impl Status {
    /// Decodes the three registers.
    #[must_use]
    pub const fn from_registers(registers: [u16; REGISTERS as usize]) -> Self {
        let [[status, _], [fault, requested], [position, current]] =
            [registers[0].to_be_bytes(), registers[1].to_be_bytes(), registers[2].to_be_bytes()];
        Self {
            activated: status & 1 != 0,
            go: status & 8 != 0,
            activation: match status >> 4 & 3 {
                0 => Activation::Reset,
                1 => Activation::Activating,
                3 => Activation::Active,
                _ => Activation::Reserved,
            },
            motion: match status >> 6 {
                0 => Motion::Moving,
                1 => Motion::ContactOpening,
                2 => Motion::ContactClosing,
                _ => Motion::Arrived,
            },
            fault: Fault(fault & 0x0F),
            controller_fault: fault >> 4,
            requested,
            position,
            current,
        }
    }
}

/// `gFLT`: fault number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fault(pub u8);

impl Fault {
    /// Whether there is no fault.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.0 == 0
    }

    /// Whether moves are refused until the gripper is reset and activated again.
    #[must_use]
    pub const fn needs_activation(self) -> bool {
        self.0 >= 0x0A
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            0x0 => "no fault",
            0x5 => "the move waits until activation is over",
            0x7 => "the gripper must be activated before it moves",
            0x8 => "the gripper is too hot; it works again below 80 degrees Celsius",
            0x9 => "the gripper has heard nothing for a second; poll it more often",
            0xA => "the supply voltage is too low; check the 24 V supply, then activate again",
            0xB => "the emergency release is under way",
            0xC => "the gripper has an internal fault; activate again, or call Robotiq's support",
            0xD => "activation failed; check that the fingers can move, then activate again",
            0xE => "the motor current was too high; activate again",
            0xF => "the emergency release is complete; activate again",
            number => return write!(f, "fault {number:#x}, which the manual does not list"),
        })
    }
}
