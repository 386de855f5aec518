//! Errors of HID devices.

use super::{HidInfo, HidSelector};
use crate::codec::blink1::Blink1Error;
use crate::codec::tara::TaraError;
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// Reason why a HID device cannot be used.
#[derive(Debug)]
pub enum HidError {
    /// No device matches.
    NotFound {
        /// Device searched for.
        wanted: HidSelector,
        /// HID devices present.
        found: Vec<HidInfo>,
    },
    /// Several devices match.
    Ambiguous {
        /// Matching devices.
        found: Vec<HidInfo>,
    },
    /// The user has no permission to open the device.
    PermissionDenied {
        /// Device node.
        path: PathBuf,
        /// The udev rule that grants permission.
        rule: String,
    },
    /// The device was disconnected.
    Disconnected {
        /// Device node.
        path: PathBuf,
    },
    /// No answer came in time.
    Timeout {
        /// Command sent to the device.
        command: &'static str,
        /// Time waited.
        waited: Duration,
    },
    /// A system call failed.
    Io {
        /// Action: "open", "read".
        action: &'static str,
        /// The node or file.
        path: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// The camera refuses a command, or a value is invalid.
    Tara(TaraError),
    /// The light sends an unexpected answer, or a value is invalid.
    Blink1(Blink1Error),
    /// The kernel has no light of this name.
    NoLed {
        /// Name searched for.
        wanted: String,
        /// Names present.
        found: Vec<String>,
    },
    /// This system has no hidraw.
    Unsupported,
}

impl fmt::Display for HidError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFound { wanted, found } if found.is_empty() => {
                write!(f, "there is no HID device {wanted}, nor any other; is it plugged in?")
            }
            Self::NotFound { wanted, found } => {
                write!(f, "there is no HID device {wanted}; there are {}", names(found))
            }
            Self::Ambiguous { found } => {
                write!(f, "several HID devices fit: {}; give the serial number of one", names(found))
            }
            Self::PermissionDenied { path, rule } => write!(
                f,
                "permission denied for {}; put this line into /etc/udev/rules.d/70-gelstereo.rules, add \
                 yourself to the group plugdev and plug the device in again: {rule}",
                path.display()
            ),
            Self::Disconnected { path } => write!(f, "the HID device {} was unplugged", path.display()),
            Self::Timeout { command, waited } => write!(
                f,
                "the device did not {command} within {} ms; reconnect it if this persists",
                waited.as_millis()
            ),
            Self::Io { action, path, error } => write!(f, "cannot {action} {}: {error}", path.display()),
            Self::Tara(error) => error.fmt(f),
            Self::Blink1(error) => error.fmt(f),
            Self::NoLed { wanted, found } => write!(
                f,
                "the kernel has no light \"{wanted}\" in /sys/class/leds; it has {}",
                if found.is_empty() { "none".to_owned() } else { found.join(", ") }
            ),
            Self::Unsupported => f.write_str(
                "HID devices are opened by Linux's hidraw, which this system does not have; use \
                 gelstereo.hid in Python, which uses hidapi",
            ),
        }
    }
}

impl std::error::Error for HidError {}

impl From<TaraError> for HidError {
    fn from(error: TaraError) -> Self {
        Self::Tara(error)
    }
}

impl From<Blink1Error> for HidError {
    fn from(error: Blink1Error) -> Self {
        Self::Blink1(error)
    }
}

fn names(devices: &[HidInfo]) -> String {
    devices.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// The udev rule that lets the group plugdev and the user at the computer open the HID nodes of a product.
#[must_use]
pub fn udev_rule(vendor: u16, product: u16) -> String {
    format!(
        "KERNEL==\"hidraw*\", ATTRS{{idVendor}}==\"{vendor:04x}\", ATTRS{{idProduct}}==\"{product:04x}\", \
         MODE=\"0660\", GROUP=\"plugdev\", TAG+=\"uaccess\""
    )
}
