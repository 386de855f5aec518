//! Why a camera cannot be used.

use super::CameraInfo;
use std::path::PathBuf;
use std::time::Duration;

/// Why a camera cannot be used.
#[derive(Debug)]
pub enum CaptureError {
    /// This system has no Video4Linux2.
    Unsupported,
    /// A setting makes no sense.
    Setting {
        /// Its name.
        name: &'static str,
        /// What was found.
        found: String,
        /// What would be valid.
        valid: String,
    },
    /// There is no such camera.
    NotFound {
        /// The name that was looked for.
        name: String,
        /// Cameras that are there.
        present: Vec<CameraInfo>,
    },
    /// Several cameras have this name.
    Ambiguous {
        /// The name that was looked for.
        name: String,
        /// Cameras that have it.
        matches: Vec<CameraInfo>,
    },
    /// Another camera is at the path of the one that was lost.
    Replaced {
        /// The lost camera.
        expected: String,
        /// The other one.
        found: String,
    },
    /// A device cannot be opened.
    Open {
        /// Its path.
        path: PathBuf,
        /// The system's answer.
        error: std::io::Error,
    },
    /// A device is no camera that frames can be read from.
    NotCapture {
        /// Its path.
        path: PathBuf,
        /// What it is.
        what: &'static str,
    },
    /// The driver does not give the format, size or rate that was asked for.
    Format {
        /// The device.
        device: String,
        /// What was asked for.
        asked: String,
        /// What the driver would give in its place.
        found: String,
        /// What the device offers.
        offered: Vec<String>,
    },
    /// There is no such control.
    NoControl {
        /// Its name.
        name: String,
        /// Controls of the device.
        offered: Vec<String>,
    },
    /// A control cannot have this value.
    ControlValue {
        /// Its name.
        name: String,
        /// What was found.
        found: String,
        /// What would be valid, with the unit.
        valid: String,
    },
    /// The driver refused a valid value, or took another one.
    ControlRefused {
        /// The control's name.
        name: String,
        /// The value.
        value: i64,
        /// The system's answer, or the value that it took.
        answer: String,
    },
    /// A system call failed.
    Call {
        /// The device.
        device: String,
        /// The call.
        call: &'static str,
        /// The system's answer.
        error: std::io::Error,
    },
    /// A device did not answer in time. It is left alone until its driver gives up.
    NoAnswer {
        /// The device.
        device: String,
        /// How long it was waited for.
        waited: Duration,
    },
    /// A lost camera has no controls until it is back.
    Disconnected {
        /// The device.
        device: String,
    },
    /// The camera's thread ended: a defect of this library.
    Ended {
        /// The device.
        device: String,
    },
}

impl CaptureError {
    /// What went wrong, where the device is named beside it.
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
                write!(f, "the camera does not take {value} for {name}: {answer}")
            }
            Self::Call { device, call, error } => {
                write!(f, "camera {device}: {call}: {error}")?;
                if error.kind() == std::io::ErrorKind::ResourceBusy {
                    write!(f, "; another program uses it: close that one")?;
                }
                Ok(())
            }
            Self::NoAnswer { device, waited } => write!(
                f,
                "camera {device} gave no answer within {:.1} s; unplug it and plug it in again",
                waited.as_secs_f64()
            ),
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

/// A list of cameras in one line.
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
