//! HID commands of e-con Systems' Tara stereo camera (See3CAM_Stereo): exposure, stream mode, HDR, calibration files.
//!
//! A command is a report of 64 bytes without a report number; a transport puts the number 0 before it. The camera
//! answers with a report that repeats the first bytes of the command. Reports of its IMU may come between.
//!
//! Layout after e-con's published SDK 2.0.6 (`xunit_lib_tara.cpp`). No camera was at hand to confirm it.

use std::fmt;
use std::time::Duration;

/// USB vendor of e-con Systems.
pub const VENDOR: u16 = 0x2560;
/// USB product of the Tara.
pub const PRODUCT: u16 = 0xC114;
/// Length of the report descriptor of the control interface; that of the IMU's has 23 bytes.
pub const CONTROL_DESCRIPTOR_BYTES: usize = 29;
/// Length of a report.
pub const REPORT_BYTES: usize = 64;
/// Shortest valid exposure, microseconds.
pub const MIN_EXPOSURE_US: u32 = 10;
/// Longest valid exposure, microseconds.
pub const MAX_EXPOSURE_US: u32 = 1_000_000;

const READ_FIRMWARE: u8 = 0x40;
const READ_UNIQUE_ID: u8 = 0x41;
const CAMERA: u8 = 0x78;
/// Exposure that stands for the camera's own control of it.
const AUTO_EXPOSURE: u32 = 1;
const PACKET_BYTES: usize = 56;

/// Exposure time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exposure {
    /// The camera controls it.
    Auto,
    /// Fixed, microseconds: [`MIN_EXPOSURE_US`] to [`MAX_EXPOSURE_US`].
    Us(u32),
}

/// What starts a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamMode {
    /// An external trigger.
    Trigger,
    /// The camera's own clock.
    Master,
}

/// A calibration file in the camera, in the text format of OpenCV's `FileStorage`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationFile {
    /// Camera matrices and distortion of both cameras.
    Intrinsic,
    /// Pose of the right camera.
    Extrinsic,
}

/// Version of the camera's firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Firmware {
    /// Product line.
    pub product: u8,
    /// Major version.
    pub major: u8,
    /// Minor version.
    pub minor: u16,
    /// Revision.
    pub revision: u16,
}

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}.{}", self.product, self.major, self.minor, self.revision)
    }
}

/// A part of a calibration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Its number in the file.
    pub number: u16,
    /// Its bytes; those behind the file's end mean nothing.
    pub data: [u8; PACKET_BYTES],
}

/// A command to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Read the firmware's version.
    Firmware,
    /// Read the number that is unique to this camera.
    UniqueId,
    /// Read the exposure time.
    Exposure,
    /// Set the exposure time.
    SetExposure(Exposure),
    /// Read what starts a frame.
    StreamMode,
    /// Set what starts a frame.
    SetStreamMode(StreamMode),
    /// Read whether high dynamic range is on.
    Hdr,
    /// Switch high dynamic range.
    SetHdr(bool),
    /// Read the length of a calibration file.
    CalibrationLength(CalibrationFile),
    /// Read a calibration file; the camera answers with all its packets.
    CalibrationData(CalibrationFile),
}

/// An answer of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// To [`Request::Firmware`].
    Firmware(Firmware),
    /// To [`Request::UniqueId`].
    UniqueId(u32),
    /// To [`Request::Exposure`] and [`Request::SetExposure`].
    Exposure(Exposure),
    /// To [`Request::StreamMode`] and [`Request::SetStreamMode`].
    StreamMode(StreamMode),
    /// To [`Request::Hdr`] and [`Request::SetHdr`].
    Hdr(bool),
    /// To [`Request::CalibrationLength`]: bytes.
    CalibrationLength(u16),
    /// One of the answers to [`Request::CalibrationData`].
    CalibrationData(Packet),
}

/// Why a command cannot be sent or its answer cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaraError {
    /// The camera says that the command failed.
    Refused {
        /// The command.
        command: &'static str,
        /// The status that it sent; 1 is success.
        status: u8,
    },
    /// A value has no meaning.
    Value {
        /// Which.
        name: &'static str,
        /// What was found.
        found: u32,
        /// What would be valid.
        valid: &'static str,
    },
    /// A packet of a calibration file is missing or came twice.
    Packet {
        /// The number that should have come.
        expected: u16,
        /// The one that came.
        found: u16,
    },
}

impl fmt::Display for TaraError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused { command, status } => {
                write!(f, "the camera refuses to {command} (status {status}; 1 is success)")
            }
            Self::Value { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::Packet { expected, found } => write!(
                f,
                "packet {found} of the calibration file came where {expected} was expected; read the file again"
            ),
        }
    }
}

impl std::error::Error for TaraError {}

impl Exposure {
    /// What is valid, in words.
    pub const VALID: &'static str = "1 (automatic) or 10 to 1000000 us";

    /// Reads the number that commands and settings use: 1 for automatic, else microseconds.
    ///
    /// # Errors
    /// [`TaraError::Value`].
    pub fn from_us(us: u32) -> Result<Self, TaraError> {
        match us {
            AUTO_EXPOSURE => Ok(Self::Auto),
            MIN_EXPOSURE_US..=MAX_EXPOSURE_US => Ok(Self::Us(us)),
            found => Err(TaraError::Value { name: "exposure_us", found, valid: Self::VALID }),
        }
    }

    /// The number that commands and settings use.
    #[must_use]
    pub fn us(self) -> u32 {
        match self {
            Self::Auto => AUTO_EXPOSURE,
            Self::Us(us) => us,
        }
    }
}

impl Request {
    /// What the command does, for error messages: "the camera refuses to ...".
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Firmware => "report its firmware version",
            Self::UniqueId => "report its unique number",
            Self::Exposure => "report its exposure",
            Self::SetExposure(_) => "set its exposure",
            Self::StreamMode => "report its stream mode",
            Self::SetStreamMode(_) => "set its stream mode",
            Self::Hdr => "report whether HDR is on",
            Self::SetHdr(_) => "switch HDR",
            Self::CalibrationLength(_) => "report the length of a calibration file",
            Self::CalibrationData(_) => "send a calibration file",
        }
    }

    /// How long the camera may take for the answer, as in e-con's SDK.
    #[must_use]
    pub fn timeout(self) -> Duration {
        match self {
            Self::CalibrationLength(_) | Self::CalibrationData(_) => Duration::from_secs(5),
            _ => Duration::from_secs(2),
        }
    }

    /// The first two bytes of the command, which its answer repeats; one for the commands that have one.
    fn prefix(&self) -> (u8, Option<u8>) {
        match self {
            Self::Firmware => (READ_FIRMWARE, None),
            Self::UniqueId => (READ_UNIQUE_ID, None),
            Self::Exposure => (CAMERA, Some(0x01)),
            Self::SetExposure(_) => (CAMERA, Some(0x02)),
            Self::CalibrationLength(_) => (CAMERA, Some(0x09)),
            Self::CalibrationData(_) => (CAMERA, Some(0x0A)),
            Self::SetStreamMode(_) => (CAMERA, Some(0x0B)),
            Self::StreamMode => (CAMERA, Some(0x0C)),
            Self::SetHdr(_) => (CAMERA, Some(0x0E)),
            Self::Hdr => (CAMERA, Some(0x0F)),
        }
    }

    /// The report to send.
    ///
    /// # Errors
    /// [`TaraError::Value`] for an exposure that the camera does not have.
    pub fn encode(self) -> Result<[u8; REPORT_BYTES], TaraError> {
        let mut report = [0; REPORT_BYTES];
        let (first, second) = self.prefix();
        report[0] = first;
        report[1] = second.unwrap_or(0);
        match self {
            Self::SetExposure(exposure) => {
                let exposure = Exposure::from_us(exposure.us())?;
                report[2..6].copy_from_slice(&exposure.us().to_be_bytes());
            }
            Self::SetStreamMode(mode) => report[2] = mode as u8,
            Self::SetHdr(on) => report[2] = u8::from(on),
            Self::CalibrationLength(file) | Self::CalibrationData(file) => report[2] = file as u8,
            _ => {}
        }
        Ok(report)
    }

    /// Reads a report that came after the command was sent; `None` if it does not answer it.
    ///
    /// # Errors
    /// [`TaraError`] if the camera refused the command or sent a value without meaning.
    pub fn decode(self, report: &[u8]) -> Result<Option<Reply>, TaraError> {
        let Ok(report) = <&[u8; REPORT_BYTES]>::try_from(report) else {
            return Ok(None);
        };
        let (first, second) = self.prefix();
        if report[0] != first || second.is_some_and(|second| report[1] != second) {
            return Ok(None);
        }
        self.read(report).map(Some)
    }

    fn read(self, report: &[u8; REPORT_BYTES]) -> Result<Reply, TaraError> {
        let long =
            |at: usize| u32::from_be_bytes([report[at], report[at + 1], report[at + 2], report[at + 3]]);
        let short = |at: usize| u16::from_be_bytes([report[at], report[at + 1]]);
        let succeeded = |at: usize| match report[at] {
            1 => Ok(()),
            status => Err(TaraError::Refused { command: self.name(), status }),
        };
        Ok(match self {
            Self::Firmware => Reply::Firmware(Firmware {
                product: report[1],
                major: report[2],
                minor: short(3),
                revision: short(5),
            }),
            Self::UniqueId => Reply::UniqueId(long(1)),
            Self::Exposure | Self::SetExposure(_) => {
                succeeded(10)?;
                Reply::Exposure(Exposure::from_us(long(2))?)
            }
            Self::StreamMode | Self::SetStreamMode(_) => {
                succeeded(4)?;
                Reply::StreamMode(StreamMode::read(report[2])?)
            }
            Self::Hdr | Self::SetHdr(_) => {
                succeeded(4)?;
                Reply::Hdr(report[2] != 0)
            }
            Self::CalibrationLength(_) => {
                succeeded(15)?;
                Reply::CalibrationLength(short(7))
            }
            Self::CalibrationData(_) => {
                succeeded(7)?;
                let mut data = [0; PACKET_BYTES];
                data.copy_from_slice(&report[8..8 + PACKET_BYTES]);
                Reply::CalibrationData(Packet { number: short(5), data })
            }
        })
    }
}

impl StreamMode {
    fn read(byte: u8) -> Result<Self, TaraError> {
        match byte {
            0 => Ok(Self::Trigger),
            1 => Ok(Self::Master),
            found => Err(TaraError::Value {
                name: "stream mode",
                found: u32::from(found),
                valid: "0 (trigger) or 1 (master)",
            }),
        }
    }
}

/// A calibration file as its packets come in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assembly {
    length: usize,
    bytes: Vec<u8>,
    next: Option<u16>,
}

impl Assembly {
    /// A file of `length` bytes, of which nothing has come yet.
    #[must_use]
    pub fn new(length: u16) -> Self {
        Self { length: usize::from(length), bytes: Vec::with_capacity(usize::from(length)), next: None }
    }

    /// Whether all bytes have come.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.bytes.len() == self.length
    }

    /// Adds the next packet. The SDK does not say whether the first one has number 0 or 1: both are taken.
    ///
    /// # Errors
    /// [`TaraError::Packet`].
    pub fn push(&mut self, packet: &Packet) -> Result<(), TaraError> {
        let expected = self.next.unwrap_or(packet.number.min(1));
        if packet.number != expected || self.is_complete() {
            return Err(TaraError::Packet { expected, found: packet.number });
        }
        self.next = Some(expected + 1);
        let wanted = (self.length - self.bytes.len()).min(PACKET_BYTES);
        self.bytes.extend_from_slice(&packet.data[..wanted]);
        Ok(())
    }

    /// What has come.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The file.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}
