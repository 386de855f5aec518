//! A blink(1) light controlled by feature reports.

use super::{HidDevice, HidError, HidSelector};
use crate::codec::blink1::{Command, Led, PRODUCT, REPORT_BYTES, Rgb, VENDOR, Version};

/// A blink(1) light. It keeps its colour when this value is dropped.
#[derive(Debug)]
pub struct Blink1Light {
    device: HidDevice,
}

impl Blink1Light {
    /// Selects a blink(1), by its serial number if several are connected.
    #[must_use]
    pub fn selector(serial: Option<&str>) -> HidSelector {
        HidSelector {
            vendor: VENDOR,
            product: PRODUCT,
            serial: serial.map(str::to_owned),
            descriptor_bytes: None,
        }
    }

    /// Opens the light.
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
    pub fn version(&mut self) -> Result<Version, HidError> {
        Ok(Version::decode(&self.fetch(Command::Version)?)?)
    }

    /// Reads the colour of a light.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn color(&mut self, led: Led) -> Result<Rgb, HidError> {
        Ok(Rgb::decode(&self.fetch(Command::Read { led })?)?)
    }

    /// Sets all lights to a colour at once; black is off.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn set(&mut self, color: Rgb) -> Result<(), HidError> {
        self.send(Command::Set { color, led: Led::All })
    }

    /// Fades all lights to a colour within `fade_ms` milliseconds.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn fade(&mut self, color: Rgb, fade_ms: u32) -> Result<(), HidError> {
        self.send(Command::Fade { color, fade_ms, led: Led::All })
    }

    fn send(&mut self, command: Command) -> Result<(), HidError> {
        self.device.set_feature(&command.encode()?)
    }

    fn fetch(&mut self, command: Command) -> Result<Vec<u8>, HidError> {
        self.send(command)?;
        let mut report = [0; REPORT_BYTES];
        // Fetch the report with the number of the one sent.
        report[0] = command.encode()?[0];
        let length = self.device.get_feature(&mut report)?;
        Ok(report[..length].to_vec())
    }
}
