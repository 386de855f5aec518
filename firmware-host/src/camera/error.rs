//! Errors of cameras.

use super::CameraInfo;
use std::path::PathBuf;
use std::time::Duration;

/// Reason why a camera cannot be used.
#[derive(Debug)]
pub enum CaptureError {
    /// This system has no Video4Linux2.
    Unsupported,
    /// A setting is invalid.
    Setting {
        /// Its name.
        name: &'static str,
        /// Value found.
        found: String,
        /// Valid values.
        valid: String,
    },
    /// No camera has this name.
    NotFound {
        /// Name searched for.
        name: String,
        /// Cameras present.
        present: Vec<CameraInfo>,
    },
    /// Several cameras have this name.
    Ambiguous {
        /// Name searched for.
        name: String,
        /// Cameras with this name.
        matches: Vec<CameraInfo>,
    },
    /// Another camera is at the path of the lost one.
    Replaced {
        /// The lost camera.
        expected: String,
        /// The other camera.
        found: String,
    },
    /// A device cannot be opened.
    Open {
        /// Its path.
        path: PathBuf,
        /// Error of the system.
        error: std::io::Error,
    },
    /// A device does not deliver readable camera frames.
    NotCapture {
        /// Its path.
        path: PathBuf,
        /// Kind of the device.
        what: &'static str,
    },
    /// The driver does not accept the requested format, size or rate.
    Format {
        /// The device.
        device: String,
        /// Requested value.
        asked: String,
        /// Value offered by the driver instead.
        found: String,
        /// Values offered by the device.
        offered: Vec<String>,
    },
    /// No control has this name.
    NoControl {
        /// Its name.
        name: String,
        /// Controls of the device.
        offered: Vec<String>,
    },
    /// The value is invalid for the control.
    ControlValue {
        /// Its name.
        name: String,
        /// Value found.
        found: String,
        /// Valid values with their unit.
        valid: String,
    },
    /// The driver refused a valid value, or set another one.
    ControlRefused {
        /// The control's name.
        name: String,
        /// The value.
        value: i64,
        /// Error of the system, or the value that was set.
        answer: String,
    },
    /// A system call failed.
    Call {
        /// The device.
        device: String,
        /// The call.
        call: &'static str,
        /// Error of the system.
        error: std::io::Error,
    },
    /// A device did not answer in time. Its thread is left to run until the driver gives up.
    NoAnswer {
        /// The device.
        device: String,
        /// Time waited.
        waited: Duration,
    },
    /// A lost camera has no controls until it is reconnected.
    Disconnected {
        /// The device.
        device: String,
    },
    /// The camera's thread ended: a bug in this library.
    Ended {
        /// The device.
        device: String,
    },
}

impl CaptureError {
    /// Reason without the device name, for use next to it.
    #[must_use]
    pub fn reason(&self) -> String {
        match self {
            Self::Call { call, error, .. } => format!("{call}: {error}"),
            error => error.to_string(),
        }
    }
}

impl std::fmt::Display for CaptureError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unsupported => write!(
                f,
                "cameras are read by Video4Linux2, which only Linux has; on this system let another program \
                 send its frames to standard input (source kind \"stream\")"
            ),
            Self::Setting { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::NotFound { name, present } => {
                write!(f, "there is no camera {name}; connected are: {}", Cameras(present))
            }
            Self::Ambiguous { name, matches } => write!(
                f,
                "{name} names several cameras: {}; name one by its path, such as /dev/v4l/by-path/..",
                Cameras(matches)
            ),
            Self::Replaced { expected, found } => {
                write!(f, "another camera is at this path now, {found}; expected is {expected}")
            }
            Self::Open { path, error } => {
                write!(f, "cannot open {}: {error}", path.display())?;
                match error.kind() {
                    std::io::ErrorKind::PermissionDenied => write!(
                        f,
                        "; add yourself to the group that owns it (`sudo usermod -aG video $USER`, then log \
                         in again)"
                    ),
                    std::io::ErrorKind::ResourceBusy => {
                        write!(f, "; another program uses it: close that one")
                    }
                    _ => Ok(()),
                }
            }
            Self::NotCapture { path, what } => write!(f, "{} is {what}", path.display()),
            Self::Format { device, asked, found, offered } => write!(
                f,
                "camera {device} does not give {asked} but {found}; it offers: {}",
                if offered.is_empty() { "(it does not say)".to_owned() } else { offered.join("; ") }
            ),
            Self::NoControl { name, offered } => write!(
                f,
                "the camera has no control {name}; it has: {}",
                if offered.is_empty() { "none".to_owned() } else { offered.join(", ") }
            ),
            Self::ControlValue { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::ControlRefused { name, value, answer } => {
                write!(f, "the camera does not accept {value} for {name}: {answer}")
            }
            Self::Call { device, call, error } => {
                write!(f, "camera {device}: {call}: {error}")?;
                if error.kind() == std::io::ErrorKind::ResourceBusy {
                    write!(f, "; another program uses it: close that one")?;
                }
                Ok(())
            }
            Self::NoAnswer { device, waited } => {
                write!(f, "camera {device} did not answer within {:.1} s; reconnect it", waited.as_secs_f64())
            }
            Self::Disconnected { device } => {
                write!(f, "camera {device} is not connected; try again when it is back")
            }
            Self::Ended { device } => {
                write!(f, "the thread of camera {device} ended; close the camera and open it again")
            }
        }
    }
}

impl std::error::Error for CaptureError {}

/// Formats a list of cameras in one line.
struct Cameras<'a>(&'a [CameraInfo]);

impl std::fmt::Display for Cameras<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.0.is_empty() {
            return f.write_str("none");
        }
        for (index, camera) in self.0.iter().enumerate() {
            let separator = if index == 0 { "" } else { "; " };
            write!(f, "{separator}{camera}")?;
        }
        Ok(())
    }
}
