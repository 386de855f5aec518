//! Light over the gel, and HID settings of a camera: set before the first frame; the light is switched
//! off at the end.

use crate::codec::blink1::Rgb;
use crate::codec::tara::{Exposure, StreamMode};
use crate::config::{CameraHidConfig, LightConfig, StreamModeConfig};
use crate::hid::{Blink1Light, HidError, KernelLed, TaraControl};

/// A light that is on. Dropping it switches it off; [`Self::off`] also returns errors.
#[derive(Debug)]
pub struct LightOn {
    lamp: Lamp,
}

#[derive(Debug)]
enum Lamp {
    None,
    Blink1(Blink1Light),
    Led(KernelLed),
}

impl LightOn {
    /// Switches the configured light on.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn new(config: &LightConfig) -> Result<Self, HidError> {
        let lamp = match config {
            LightConfig::None => Lamp::None,
            LightConfig::Blink1 { serial, color: [red, green, blue], brightness } => {
                let mut light = Blink1Light::open(serial.as_deref())?;
                light.set(Rgb { red: *red, green: *green, blue: *blue }.scaled(*brightness))?;
                Lamp::Blink1(light)
            }
            LightConfig::Led { name, brightness } => {
                let light = KernelLed::open(name)?;
                light.set(*brightness)?;
                Lamp::Led(light)
            }
        };
        Ok(Self { lamp })
    }

    /// Switches the light off.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn off(mut self) -> Result<(), HidError> {
        let result = self.switch_off();
        self.lamp = Lamp::None;
        result
    }

    fn switch_off(&mut self) -> Result<(), HidError> {
        match &mut self.lamp {
            Lamp::None => Ok(()),
            Lamp::Blink1(light) => light.set(Rgb::default()),
            Lamp::Led(light) => light.set(0.0),
        }
    }
}

impl Drop for LightOn {
    fn drop(&mut self) {
        // On this path the host ends with another error, which is the one to report.
        let _ = self.switch_off();
    }
}

/// Applies the HID settings of a camera.
///
/// # Errors
/// [`HidError`].
pub fn set_up_camera(config: &CameraHidConfig) -> Result<(), HidError> {
    let CameraHidConfig::Tara { serial, exposure_us, stream_mode, hdr } = config else {
        return Ok(());
    };
    let mut camera = TaraControl::open(serial.as_deref())?;
    if let Some(mode) = stream_mode {
        camera.set_stream_mode(match mode {
            StreamModeConfig::Master => StreamMode::Master,
            StreamModeConfig::Trigger => StreamMode::Trigger,
        })?;
    }
    if let Some(on) = hdr {
        camera.set_hdr(*on)?;
    }
    // Last, since HDR may change the exposure.
    if let Some(us) = exposure_us {
        camera.set_exposure(Exposure::from_us(*us)?)?;
    }
    Ok(())
}
