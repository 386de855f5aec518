//! What supervises a sensing host: systemd's notifications, and a health file.

use super::report::Status;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// What the health file says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Whether results come and go where they shall.
    pub healthy: bool,
    /// Why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trouble: Option<String>,
    /// When this was written, seconds since 1970.
    pub updated_unix_s: f64,
    /// Process that wrote it.
    pub pid: u32,
    /// Stereo pairs since the start.
    pub frames: u64,
    /// Pairs that the source lost or passed over since the start.
    pub dropped: u64,
    /// Pairs a second, at last.
    pub rate_hz: f64,
}

/// Why a health file does not say that all is well.
#[derive(Debug)]
pub enum HealthError {
    /// It cannot be read.
    Read {
        /// Which.
        path: PathBuf,
        /// The system's answer.
        error: std::io::Error,
    },
    /// It is no health file.
    Parse {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        error: serde_json::Error,
    },
    /// Nobody has written it for too long.
    Old {
        /// Which.
        path: PathBuf,
        /// How long ago it was written.
        age_s: f64,
        /// Longest valid.
        max_age_s: f64,
    },
    /// It says itself that something is wrong.
    Trouble {
        /// What.
        trouble: String,
    },
}

impl std::fmt::Display for HealthError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => {
                let path = path.display();
                write!(
                    f,
                    "cannot read the health file {path}: {error}; does `sense --health-file {path}` run?"
                )
            }
            Self::Parse { path, error } => write!(f, "{} is no health file: {error}", path.display()),
            Self::Old { path, age_s, max_age_s } => write!(
                f,
                "{} was written {age_s:.1} s ago, longer than {max_age_s} s: sensing has ended or hangs",
                path.display()
            ),
            Self::Trouble { trouble } => write!(f, "not well: {trouble}"),
        }
    }
}

impl std::error::Error for HealthError {}

fn unix_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

/// Reads a health file and judges it.
///
/// # Errors
/// [`HealthError`] when all is not well.
pub fn check(path: &Path, max_age_s: f64) -> Result<Health, HealthError> {
    let text =
        std::fs::read_to_string(path).map_err(|error| HealthError::Read { path: path.to_owned(), error })?;
    let health: Health =
        serde_json::from_str(&text).map_err(|error| HealthError::Parse { path: path.to_owned(), error })?;
    let age_s = unix_s() - health.updated_unix_s;
    if age_s > max_age_s {
        return Err(HealthError::Old { path: path.to_owned(), age_s, max_age_s });
    }
    match health.trouble {
        Some(trouble) => Err(HealthError::Trouble { trouble }),
        None => Ok(health),
    }
}

/// Tells systemd and the health file how it goes.
#[derive(Debug, Default)]
pub struct Supervisor {
    health_file: Option<PathBuf>,
}

impl Supervisor {
    /// Writes this health file, if any. Where systemd did not start the host, notifications go nowhere.
    #[must_use]
    pub const fn new(health_file: Option<PathBuf>) -> Self {
        Self { health_file }
    }

    /// The source is open and results are on their way.
    pub fn ready(&self) {
        notify::ready();
    }

    /// The loop goes round.
    pub fn alive(&self) {
        notify::alive();
    }

    /// How often systemd wants to hear; `None` if it does not.
    #[must_use]
    pub fn alive_within(&self) -> Option<Duration> {
        notify::watchdog()
    }

    /// Once a second.
    ///
    /// # Errors
    /// The system's answer when the health file cannot be written.
    pub fn status(&self, status: &Status) -> std::io::Result<()> {
        notify::status(&status.to_string());
        let Some(path) = &self.health_file else { return Ok(()) };
        let health = Health {
            healthy: status.trouble.is_none(),
            trouble: status.trouble.clone(),
            updated_unix_s: unix_s(),
            pid: std::process::id(),
            frames: status.totals.frames,
            dropped: status.totals.dropped,
            rate_hz: status.rate_hz,
        };
        // Whoever reads sees the old one or the new one, never half of one.
        let beside = path.with_extension("tmp");
        let mut file = std::fs::File::create(&beside)?;
        file.write_all(serde_json::to_string(&health)?.as_bytes())?;
        drop(file);
        std::fs::rename(&beside, path)
    }

    /// The end: the health file goes, so that nobody takes it for that of a running host.
    pub fn stopping(&self) {
        notify::stopping();
        if let Some(path) = &self.health_file {
            // It may never have been written.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// systemd's protocol. What it does not hear it acts on itself, so that errors need no other answer.
#[cfg(target_os = "linux")]
mod notify {
    use sd_notify::NotifyState;
    use std::time::Duration;

    pub fn ready() {
        let _ = sd_notify::notify(&[NotifyState::Ready]);
    }

    pub fn alive() {
        let _ = sd_notify::notify(&[NotifyState::Watchdog]);
    }

    pub fn watchdog() -> Option<Duration> {
        sd_notify::watchdog_enabled()
    }

    pub fn status(text: &str) {
        let _ = sd_notify::notify(&[NotifyState::Status(text)]);
    }

    pub fn stopping() {
        let _ = sd_notify::notify(&[NotifyState::Stopping]);
    }
}

/// There is no systemd.
#[cfg(not(target_os = "linux"))]
mod notify {
    pub const fn ready() {}
    pub const fn alive() {}
    pub const fn watchdog() -> Option<std::time::Duration> {
        None
    }
    pub const fn status(_: &str) {}
    pub const fn stopping() {}
}
