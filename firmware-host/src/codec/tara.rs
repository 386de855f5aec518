//! HID commands of e-con Systems' Tara stereo camera (See3CAM_Stereo): exposure, stream mode, HDR and
//! calibration files.
//!
//! A command is a report of 64 bytes without a report number; the transport prepends the number 0. The
//! camera answers with a report that repeats the first bytes of the command. Reports of its IMU may
//! arrive in between.
//!
//! Layout after e-con's published SDK 2.0.6 (`xunit_lib_tara.cpp`), not confirmed on a camera.

use std::fmt;
use std::time::Duration;

/// USB vendor of e-con Systems.
pub const VENDOR: u16 = 0x2560;
/// USB product of the Tara.
pub const PRODUCT: u16 = 0xC114;
/// Length of the report descriptor of the control interface; the IMU's has 23 bytes.
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
/// Exposure value for automatic control by the camera.
const AUTO_EXPOSURE: u32 = 1;
const PACKET_BYTES: usize = 56;

/// Exposure time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exposure {
    /// Controlled by the camera.
    Auto,
    /// Fixed, microseconds: [`MIN_EXPOSURE_US`] to [`MAX_EXPOSURE_US`].
    Us(u32),
}

/// Trigger source of a frame.
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

/// Part of a calibration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Number in the file.
    pub number: u16,
    /// Bytes; those beyond the end of the file are undefined.
    pub data: [u8; PACKET_BYTES],
}

/// A command to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Read the firmware's version.
    Firmware,
    /// Read the unique number of this camera.
    UniqueId,
    /// Read the exposure time.
    Exposure,
    /// Set the exposure time.
    SetExposure(Exposure),
    /// Read the trigger source.
    StreamMode,
    /// Set the trigger source.
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

/// Answer of the camera.
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

/// A command that cannot be sent, or an answer that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaraError {
    /// The camera reports that the command failed.
    Refused {
        /// The command.
        command: &'static str,
        /// Status sent by the camera; 1 is success.
        status: u8,
    },
    /// A value is invalid.
    Value {
        /// Name of the value.
        name: &'static str,
        /// Value found.
        found: u32,
        /// Valid values.
        valid: &'static str,
    },
    /// A packet of a calibration file is missing or duplicated.
    Packet {
        /// Expected number.
        expected: u16,
        /// Received number.
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
                "packet {found} of the calibration file came where {expected} was expected; read the file \
                again"
            ),
        }
    }
}

impl std::error::Error for TaraError {}

impl Exposure {
    /// Valid values, in words.
    pub const VALID: &'static str = "1 (automatic) or 10 to 1000000 us";

    /// Decodes the number that commands and settings use: 1 for automatic, else microseconds.
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

    /// Number that commands and settings use.
    #[must_use]
    pub fn us(self) -> u32 {
        match self {
            Self::Auto => AUTO_EXPOSURE,
            Self::Us(us) => us,
        }
    }
}

impl Request {
    /// Action of the command, for error messages: "the camera refuses to ...".
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

    /// Longest time to wait for the answer, as in e-con's SDK.
    #[must_use]
    pub fn timeout(self) -> Duration {
        match self {
            Self::CalibrationLength(_) | Self::CalibrationData(_) => Duration::from_secs(5),
            _ => Duration::from_secs(2),
        }
    }

    /// First bytes of the command, which its answer repeats: two, or one for commands without a second.
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
    /// [`TaraError::Value`] for an exposure that the camera does not support.
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

    /// Decodes a report received after the command; `None` if it does not answer the command.
    ///
    /// # Errors
    /// [`TaraError`] if the camera refused the command or sent an invalid value.
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

/// Assembles a calibration file from its packets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assembly {
    length: usize,
    bytes: Vec<u8>,
    next: Option<u16>,
}

impl Assembly {
    /// Empty file of `length` bytes.
    #[must_use]
    pub fn new(length: u16) -> Self {
        Self { length: usize::from(length), bytes: Vec::with_capacity(usize::from(length)), next: None }
    }

    /// Whether all bytes have been received.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.bytes.len() == self.length
    }

    /// Adds the next packet. The SDK does not specify whether numbering starts at 0 or 1, so both are
    /// accepted.
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

    /// Bytes received so far.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The received bytes.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}
