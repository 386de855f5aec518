//! Controls of a camera: description, settings and the checked plan of writes.

use super::CaptureError;
use super::config::setting;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

// Numbers of `linux/v4l2-controls.h`.
const AUTO_WHITE_BALANCE: u32 = 0x0098_090c;
const AUTO_GAIN: u32 = 0x0098_0912;
const GAIN: u32 = 0x0098_0913;
const WHITE_BALANCE_TEMPERATURE: u32 = 0x0098_091a;
const EXPOSURE_AUTO: u32 = 0x009a_0901;
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;

const EXPOSURE_FULLY_AUTOMATIC: i64 = 0;
const EXPOSURE_MANUAL: i64 = 1;
/// Exposure controlled by the camera at a fixed aperture: the automatic mode of most USB cameras.
const EXPOSURE_APERTURE_PRIORITY: i64 = 3;

/// Unit of `exposure_time_absolute`.
const EXPOSURE_UNIT_US: f64 = 100.0;

/// Kind of a control's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// A number.
    Integer,
    /// 0 or 1.
    Boolean,
    /// An item of the menu.
    Menu,
    /// Writing triggers an action; there is no value.
    Button,
    /// A set of bits.
    Bitmask,
}

/// An item of a menu.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MenuItem {
    /// Value of the control for this item.
    pub index: i64,
    /// Name or number of the item in the driver.
    pub name: String,
}

/// A control of a camera, as its driver describes it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Control {
    /// Number in the kernel's header.
    #[serde(skip)]
    pub id: u32,
    /// Name, as `v4l2-ctl` shows it: `exposure_time_absolute`.
    pub name: String,
    /// Kind.
    pub kind: ControlKind,
    /// Smallest value.
    pub minimum: i64,
    /// Largest value.
    pub maximum: i64,
    /// Step between valid values.
    pub step: u64,
    /// Default of the driver.
    pub default: i64,
    /// Present value; `None` if it cannot be read.
    pub value: Option<i64>,
    /// Whether it cannot be written.
    pub read_only: bool,
    /// Whether another control, such as an automatic mode, disables it at present.
    pub inactive: bool,
    /// Menu items.
    pub menu: Vec<MenuItem>,
    /// Whether the driver uses 64 bits.
    #[serde(skip)]
    pub wide: bool,
}

impl Control {
    /// Checks that a value may be written.
    ///
    /// # Errors
    /// [`CaptureError::ControlValue`], which states the valid values.
    pub fn check(&self, value: i64) -> Result<(), CaptureError> {
        self.check_as(value, &self.name, &value.to_string(), 1.0, "")
    }

    /// As [`Self::check`], but reported with another name, unit and scale.
    fn check_as(
        &self,
        value: i64,
        name: &str,
        found: &str,
        scale: f64,
        unit: &str,
    ) -> Result<(), CaptureError> {
        let refuse = |valid: String| {
            Err(CaptureError::ControlValue { name: name.to_owned(), found: found.to_owned(), valid })
        };
        if self.read_only {
            return refuse("nothing: the camera only shows it".to_owned());
        }
        if self.kind == ControlKind::Menu {
            if self.menu.iter().any(|item| item.index == value) {
                return Ok(());
            }
            let items: Vec<_> =
                self.menu.iter().map(|item| format!("{} ({})", item.index, item.name)).collect();
            return refuse(items.join(", "));
        }
        let step = self.step.max(1);
        let valid = value >= self.minimum
            && value <= self.maximum
            && (self.kind == ControlKind::Bitmask || value.abs_diff(self.minimum).is_multiple_of(step));
        if valid {
            return Ok(());
        }
        let shown = |value: f64| value * scale;
        let (low, high) = (shown(self.minimum as f64), shown(self.maximum as f64));
        refuse(format!("{low} to {high}{unit} in steps of {}{unit}", shown(step as f64)))
    }
}

/// What is wanted of a camera's controls. What is not stated stays as the camera has it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControlSettings {
    /// Exposure time, a multiple of 100 µs; automatic exposure is turned off. Valid: 100 to 10000000 us.
    /// Default: not changed. Set it so that the gel is neither dark nor saturated, and moving markers are not
    /// smeared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_us: Option<f64>,
    /// Whether the camera chooses the exposure time. Markers change their brightness then. Default: not
    /// changed. Set it to false for sensing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub auto_exposure: Option<bool>,
    /// Gain in the camera's own unit; automatic gain is turned off. `v4l2-ctl --list-ctrls` shows its range.
    /// Default: not changed. Set it low, and light the gel instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<i64>,
    /// White balance in kelvin; the automatic one is turned off. Default: not changed. Set it for colour
    /// cameras, so that grey levels stay the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_balance_k: Option<i64>,
    /// Whether the camera chooses the white balance. Default: not changed. Set it to false for sensing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub auto_white_balance: Option<bool>,
    /// Any other control by its name, as `v4l2-ctl --list-ctrls` shows it: `{ sharpness = 2 }`. Default:
    /// none. Set it where your camera sharpens or smooths its images.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub other: BTreeMap<String, i64>,
}

/// A value to write to a control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ControlWrite {
    /// The control.
    pub control: Control,
    /// The value.
    pub value: i64,
}

impl ControlSettings {
    /// Names of the settings that are not in `other`.
    pub const NAMES: [&str; 5] =
        ["exposure_us", "auto_exposure", "gain", "white_balance_k", "auto_white_balance"];

    pub(super) fn validate(&self) -> Result<(), CaptureError> {
        if let Some(exposure_us) = self.exposure_us {
            if !(100.0..=1e7).contains(&exposure_us) {
                let valid = "100 to 10000000 us, in steps of 100 us";
                return Err(setting("controls.exposure_us", exposure_us, valid));
            }
            if self.auto_exposure == Some(true) {
                return Err(setting("controls.auto_exposure", true, "false, or no exposure_us"));
            }
        }
        if self.white_balance_k.is_some() && self.auto_white_balance == Some(true) {
            return Err(setting("controls.auto_white_balance", true, "false, or no white_balance_k"));
        }
        Ok(())
    }

    /// Overrides these settings by later ones.
    pub fn merge(&mut self, later: &Self) {
        if let Some(auto) = later.auto_exposure {
            self.auto_exposure = Some(auto);
            self.exposure_us = self.exposure_us.filter(|_| !auto);
        }
        if later.exposure_us.is_some() {
            self.exposure_us = later.exposure_us;
            self.auto_exposure = later.auto_exposure;
        }
        if let Some(auto) = later.auto_white_balance {
            self.auto_white_balance = Some(auto);
            self.white_balance_k = self.white_balance_k.filter(|_| !auto);
        }
        if later.white_balance_k.is_some() {
            self.white_balance_k = later.white_balance_k;
            self.auto_white_balance = later.auto_white_balance;
        }
        self.gain = later.gain.or(self.gain);
        self.other.extend(later.other.iter().map(|(name, value)| (name.clone(), *value)));
    }

    /// Values to write to a camera with these controls, in this order: automatic modes precede the
    /// values that they would change.
    ///
    /// # Errors
    /// [`CaptureError::NoControl`] and [`CaptureError::ControlValue`].
    pub fn plan(&self, controls: &[Control]) -> Result<Vec<ControlWrite>, CaptureError> {
        self.validate()?;
        let mut plan = Plan { controls, writes: Vec::new() };
        if self.exposure_us.is_some() || self.auto_exposure == Some(false) {
            plan.add_known(EXPOSURE_AUTO, "auto_exposure", EXPOSURE_MANUAL)?;
        } else if self.auto_exposure == Some(true) {
            let mode = plan.find(EXPOSURE_AUTO, "auto_exposure")?;
            let offers = |value| mode.menu.iter().any(|item| item.index == value);
            let aperture = offers(EXPOSURE_APERTURE_PRIORITY);
            let value = if aperture { EXPOSURE_APERTURE_PRIORITY } else { EXPOSURE_FULLY_AUTOMATIC };
            plan.add_known(EXPOSURE_AUTO, "auto_exposure", value)?;
        }
        if let Some(exposure_us) = self.exposure_us {
            plan.add_exposure(exposure_us)?;
        }
        if let Some(gain) = self.gain {
            if plan.controls.iter().any(|control| control.id == AUTO_GAIN) {
                plan.add_known(AUTO_GAIN, "gain_automatic", 0)?;
            }
            plan.add_known(GAIN, "gain", gain)?;
        }
        if let Some(auto) = self.auto_white_balance.or(self.white_balance_k.map(|_| false)) {
            plan.add_known(AUTO_WHITE_BALANCE, "auto_white_balance", i64::from(auto))?;
        }
        if let Some(kelvin) = self.white_balance_k {
            plan.add_known(WHITE_BALANCE_TEMPERATURE, "white_balance_k", kelvin)?;
        }
        for (name, value) in &self.other {
            let control = controls.iter().find(|control| control.name == *name);
            let control = control.ok_or_else(|| plan.missing(name))?;
            control.check(*value)?;
            plan.writes.push(ControlWrite { control: control.clone(), value: *value });
        }
        Ok(plan.writes)
    }
}

struct Plan<'a> {
    controls: &'a [Control],
    writes: Vec<ControlWrite>,
}

impl Plan<'_> {
    fn missing(&self, name: &str) -> CaptureError {
        let offered = self.controls.iter().map(|control| control.name.clone()).collect();
        CaptureError::NoControl { name: name.to_owned(), offered }
    }

    fn find(&self, id: u32, name: &str) -> Result<&Control, CaptureError> {
        self.controls.iter().find(|control| control.id == id).ok_or_else(|| self.missing(name))
    }

    fn add_known(&mut self, id: u32, name: &str, value: i64) -> Result<(), CaptureError> {
        let control = self.find(id, name)?.clone();
        control.check_as(value, name, &value.to_string(), 1.0, "")?;
        self.writes.push(ControlWrite { control, value });
        Ok(())
    }

    fn add_exposure(&mut self, exposure_us: f64) -> Result<(), CaptureError> {
        let name = "exposure_us";
        let control = self.find(EXPOSURE_ABSOLUTE, name)?.clone();
        let value = exposure_us / EXPOSURE_UNIT_US;
        // A value between two steps is refused like one out of range: no camera supports it.
        let whole = if value.fract() == 0.0 { value as i64 } else { i64::MIN };
        control.check_as(whole, name, &exposure_us.to_string(), EXPOSURE_UNIT_US, " us")?;
        self.writes.push(ControlWrite { control, value: whole });
        Ok(())
    }
}

/// Converts a driver's control text to the name used by `v4l2-ctl`: "Exposure Time, Absolute" becomes
/// `exposure_time_absolute`.
#[must_use]
pub fn control_name(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests;
