//! The light over the gel, and settings of a camera that go by HID.

use super::ConfigError;
use super::range::check;
use crate::codec::tara::Exposure;
use serde::{Deserialize, Serialize};

/// The light: on while the host senses, off after it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum LightConfig {
    /// None, or one that the host does not switch.
    #[default]
    None,
    /// A blink(1) on USB.
    Blink1 {
        /// Serial number of the light. Set it if several are plugged in.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        serial: Option<String>,
        /// Red, green, blue. Valid: 0 to 255. Default: `[255, 255, 255]`, white. Change it to the colour that
        /// shows the markers best.
        #[serde(default = "white")]
        color: [u8; 3],
        /// Share of that colour. Valid: 0 to 1. Default: `1`. Lower it where the image saturates.
        #[serde(default = "full")]
        brightness: f64,
    },
    /// A light that the kernel drives, such as `thingm0:red:led0`.
    Led {
        /// Its name in `/sys/class/leds`. Set it to your light's.
        name: String,
        /// Share of its brightest. Valid: 0 to 1. Default: `1`. Lower it where the image saturates.
        #[serde(default = "full")]
        brightness: f64,
    },
}

/// Settings of a camera that go by HID and not by V4L2; they are made once, before the first frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum CameraHidConfig {
    /// None.
    #[default]
    None,
    /// An e-con Tara.
    Tara {
        /// Serial number of the camera. Set it if several are plugged in.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        serial: Option<String>,
        /// Exposure, or 1 for the camera's own control. Valid: 1 to 1000000 us, but not 2 to 9. Default: as
        /// it is. Set it so that the gel is neither dark nor saturated.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        exposure_us: Option<u32>,
        /// What starts a frame. Default: as it is. Set it to `trigger` with an external trigger.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        stream_mode: Option<StreamModeConfig>,
        /// High dynamic range, which changes grey levels from frame to frame. Default: as it is. Set it to
        /// false for sensing.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        hdr: Option<bool>,
    },
}

/// What starts a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StreamModeConfig {
    /// The camera's own clock.
    Master,
    /// An external trigger.
    Trigger,
}

fn white() -> [u8; 3] {
    [255; 3]
}

fn full() -> f64 {
    1.0
}

impl LightConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match *self {
            Self::None => Ok(()),
            Self::Blink1 { brightness, .. } | Self::Led { brightness, .. } => {
                check((0.0..=1.0).contains(&brightness), "light.brightness", brightness, "0 to 1")
            }
        }
    }
}

impl CameraHidConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match *self {
            Self::Tara { exposure_us: Some(us), .. } => {
                let ok = Exposure::from_us(us).is_ok();
                check(ok, "camera_hid.exposure_us", f64::from(us), Exposure::VALID)
            }
            _ => Ok(()),
        }
    }
}
