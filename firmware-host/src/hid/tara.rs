//! Exposure, stream mode, HDR and calibration files of an e-con Tara through its HID interface.

use super::{HidDevice, HidError, HidSelector};
use crate::codec::tara::{
    Assembly, CONTROL_DESCRIPTOR_BYTES, CalibrationFile, Exposure, Firmware, PRODUCT, REPORT_BYTES, Reply,
    Request, StreamMode, VENDOR,
};
use std::time::Instant;

/// Settings of a Tara camera that V4L2 does not provide.
#[derive(Debug)]
pub struct TaraControl {
    device: HidDevice,
}

/// Extracts the value from a reply of one kind.
macro_rules! value {
    ($kind:ident) => {
        |reply| match reply {
            Reply::$kind(value) => Some(value),
            _ => None,
        }
    };
}

impl TaraControl {
    /// Selects the control interface of a Tara, by serial number if several are connected.
    #[must_use]
    pub fn selector(serial: Option<&str>) -> HidSelector {
        HidSelector {
            vendor: VENDOR,
            product: PRODUCT,
            serial: serial.map(str::to_owned),
            descriptor_bytes: Some(CONTROL_DESCRIPTOR_BYTES),
        }
    }

    /// Opens the control interface.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn open(serial: Option<&str>) -> Result<Self, HidError> {
        Ok(Self { device: HidDevice::open(&Self::selector(serial))? })
    }

    /// Version of the firmware.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn firmware(&mut self) -> Result<Firmware, HidError> {
        self.ask(Request::Firmware, value!(Firmware))
    }

    /// Unique number of this camera.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn unique_id(&mut self) -> Result<u32, HidError> {
        self.ask(Request::UniqueId, value!(UniqueId))
    }

    /// Exposure time.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn exposure(&mut self) -> Result<Exposure, HidError> {
        self.ask(Request::Exposure, value!(Exposure))
    }

    /// Sets the exposure time and returns the one applied by the camera.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn set_exposure(&mut self, exposure: Exposure) -> Result<Exposure, HidError> {
        self.ask(Request::SetExposure(exposure), value!(Exposure))
    }

    /// Trigger source of a frame.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn stream_mode(&mut self) -> Result<StreamMode, HidError> {
        self.ask(Request::StreamMode, value!(StreamMode))
    }

    /// Sets the trigger source of a frame.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn set_stream_mode(&mut self, mode: StreamMode) -> Result<StreamMode, HidError> {
        self.ask(Request::SetStreamMode(mode), value!(StreamMode))
    }

    /// Whether high dynamic range is on.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn hdr(&mut self) -> Result<bool, HidError> {
        self.ask(Request::Hdr, value!(Hdr))
    }

    /// Switches high dynamic range.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn set_hdr(&mut self, on: bool) -> Result<bool, HidError> {
        self.ask(Request::SetHdr(on), value!(Hdr))
    }

    /// Reads a calibration file stored in the camera by the maker.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn calibration(&mut self, file: CalibrationFile) -> Result<Vec<u8>, HidError> {
        let length = self.ask(Request::CalibrationLength(file), value!(CalibrationLength))?;
        let mut assembly = Assembly::new(length);
        let request = Request::CalibrationData(file);
        self.send(request)?;
        while !assembly.is_complete() {
            assembly.push(&self.answer(request, value!(CalibrationData))?)?;
        }
        Ok(assembly.into_bytes())
    }

    fn ask<T>(&mut self, request: Request, value: impl Fn(Reply) -> Option<T>) -> Result<T, HidError> {
        self.send(request)?;
        self.answer(request, value)
    }

    fn send(&mut self, request: Request) -> Result<(), HidError> {
        let mut numbered = [0; REPORT_BYTES + 1];
        numbered[1..].copy_from_slice(&request.encode()?);
        // A late answer to an earlier command would be taken for the answer to this one.
        self.device.discard_waiting()?;
        self.device.write(&numbered)
    }

    fn answer<T>(&mut self, request: Request, value: impl Fn(Reply) -> Option<T>) -> Result<T, HidError> {
        let waited = request.timeout();
        let deadline = Instant::now() + waited;
        let mut report = [0; REPORT_BYTES];
        while Instant::now() < deadline {
            let Some(length) = self.device.read(&mut report, deadline)? else { break };
            if let Some(value) = request.decode(&report[..length])?.and_then(&value) {
                return Ok(value);
            }
        }
        Err(HidError::Timeout { command: request.name(), waited })
    }
}
