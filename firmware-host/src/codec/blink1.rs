//! Feature reports of ThingM's blink(1) USB light.
//!
//! A command is feature report number 1: the report number, a letter and up to seven bytes. ThingM's
//! document shows eight bytes; the kernel driver `hid-led` sends nine, and so does this codec. To read,
//! the command is sent first and the same report is then fetched.
//!
//! Layout after ThingM's `blink1-hid-commands.md`.

use std::fmt;

/// USB vendor of ThingM.
pub const VENDOR: u16 = 0x27B8;
/// USB product of the blink(1).
pub const PRODUCT: u16 = 0x01ED;
/// Length of a report including its number.
pub const REPORT_BYTES: usize = 9;
/// Longest fade, milliseconds: 65535 ticks of 10 ms.
pub const MAX_FADE_MS: u32 = 655_350;

const REPORT: u8 = 1;
const TICK_MS: u32 = 10;

/// Colour of a light; 255 is full brightness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rgb {
    /// Red.
    pub red: u8,
    /// Green.
    pub green: u8,
    /// Blue.
    pub blue: u8,
}

/// Lights of the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Led {
    /// All of them.
    #[default]
    All,
    /// The upper one.
    First,
    /// The lower one.
    Second,
}

/// A command to the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Change to a colour within a time.
    Fade {
        /// The colour.
        color: Rgb,
        /// Duration in milliseconds: 0 to [`MAX_FADE_MS`], rounded down to 10 ms.
        fade_ms: u32,
        /// Lights to change.
        led: Led,
    },
    /// Change to a colour at once.
    Set {
        /// The colour.
        color: Rgb,
        /// Lights to change.
        led: Led,
    },
    /// Read the colour.
    Read {
        /// Light to read.
        led: Led,
    },
    /// Read the firmware's version.
    Version,
}

/// Version of the light's firmware: two digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Version {
    /// Major version, 0 to 9.
    pub major: u8,
    /// Minor version, 0 to 9.
    pub minor: u8,
}

/// A command that cannot be sent, or an answer that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blink1Error {
    /// The fade is longer than the light supports.
    Fade {
        /// Requested duration, milliseconds.
        found_ms: u32,
    },
    /// A report does not answer the command.
    Answer {
        /// The letter of the command.
        expected: u8,
        /// The report's first bytes, 0 where it is shorter.
        found: [u8; 5],
        /// The report's length.
        length: usize,
    },
}

impl fmt::Display for Blink1Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fade { found_ms } => write!(f, "fade_ms is {found_ms}; valid is 0 to {MAX_FADE_MS}"),
            Self::Answer { expected, found, length } => write!(
                f,
                "the light answered command '{}' with {length} bytes that start {found:02x?}; is another \
                 program using it?",
                char::from(*expected)
            ),
        }
    }
}

impl std::error::Error for Blink1Error {}

impl Rgb {
    /// Scales the colour by a brightness from 0 to 1; values outside are clamped.
    #[must_use]
    pub fn scaled(self, brightness: f64) -> Self {
        // A NaN becomes 0: the light stays off.
        let scale = |level: u8| (f64::from(level) * brightness.clamp(0.0, 1.0)).round() as u8;
        Self { red: scale(self.red), green: scale(self.green), blue: scale(self.blue) }
    }
}

impl Command {
    fn letter(self) -> u8 {
        match self {
            Self::Fade { .. } => b'c',
            Self::Set { .. } => b'n',
            Self::Read { .. } => b'r',
            Self::Version => b'v',
        }
    }

    /// The feature report to send.
    ///
    /// # Errors
    /// [`Blink1Error::Fade`].
    pub fn encode(self) -> Result<[u8; REPORT_BYTES], Blink1Error> {
        let mut report = [0; REPORT_BYTES];
        report[0] = REPORT;
        report[1] = self.letter();
        match self {
            Self::Fade { color, fade_ms, led } => {
                let ticks =
                    u16::try_from(fade_ms / TICK_MS).map_err(|_| Blink1Error::Fade { found_ms: fade_ms })?;
                let [high, low] = ticks.to_be_bytes();
                report[2..8].copy_from_slice(&[color.red, color.green, color.blue, high, low, led as u8]);
            }
            Self::Set { color, led } => {
                report[2..8].copy_from_slice(&[color.red, color.green, color.blue, 0, 0, led as u8]);
            }
            Self::Read { led } => report[7] = led as u8,
            Self::Version => {}
        }
        Ok(report)
    }

    /// Checks that a fetched report answers this command.
    fn answer(self, report: &[u8]) -> Result<[u8; 5], Blink1Error> {
        let mut found = [0; 5];
        let length = report.len();
        for (to, from) in found.iter_mut().zip(report) {
            *to = *from;
        }
        if length < found.len() || found[0] != REPORT || found[1] != self.letter() {
            return Err(Blink1Error::Answer { expected: self.letter(), found, length });
        }
        Ok(found)
    }
}

impl Version {
    /// Decodes the report fetched after [`Command::Version`].
    ///
    /// # Errors
    /// [`Blink1Error::Answer`].
    pub fn decode(report: &[u8]) -> Result<Self, Blink1Error> {
        let found = Command::Version.answer(report)?;
        if !(found[3].is_ascii_digit() && found[4].is_ascii_digit()) {
            return Err(Blink1Error::Answer { expected: b'v', found, length: report.len() });
        }
        Ok(Self { major: found[3] - b'0', minor: found[4] - b'0' })
    }
}

impl Rgb {
    /// Decodes the report fetched after [`Command::Read`].
    ///
    /// # Errors
    /// [`Blink1Error::Answer`].
    pub fn decode(report: &[u8]) -> Result<Self, Blink1Error> {
        let [_, _, red, green, blue] = Command::Read { led: Led::All }.answer(report)?;
        Ok(Self { red, green, blue })
    }
}
