//! Supervision of a sensing host: systemd notifications and a health file.

use super::report::Status;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Contents of the health file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Whether results are produced and delivered.
    pub healthy: bool,
    /// Description of the trouble, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trouble: Option<String>,
    /// Time of writing, seconds since 1970.
    pub updated_unix_s: f64,
    /// Process that wrote it.
    pub pid: u32,
    /// Stereo pairs since the start.
    pub frames: u64,
    /// Pairs that the source lost or skipped since the start.
    pub dropped: u64,
    /// Pairs per second in the last interval.
    pub rate_hz: f64,
}

/// Why a health check failed.
#[derive(Debug)]
pub enum HealthError {
    /// The file cannot be read.
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's error.
        error: std::io::Error,
    },
    /// The file cannot be parsed.
    Parse {
        /// Path of the file.
        path: PathBuf,
        /// The parse error.
        error: serde_json::Error,
    },
    /// The file is too old.
    Old {
        /// Path of the file.
        path: PathBuf,
        /// Seconds since it was written.
        age_s: f64,
        /// Largest valid age.
        max_age_s: f64,
    },
    /// The file reports trouble.
    Trouble {
        /// Description of the trouble.
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
            Self::Parse { path, error } => write!(f, "{} is not a health file: {error}", path.display()),
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

/// Reads and evaluates a health file.
///
/// # Errors
/// [`HealthError`] when the file is missing, invalid or too old, or reports trouble.
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

/// Reports the state to systemd and the health file.
#[derive(Debug, Default)]
pub struct Supervisor {
    health_file: Option<PathBuf>,
}

impl Supervisor {
    /// Uses this health file, if any. Notifications have no effect unless systemd started the host.
    #[must_use]
    pub const fn new(health_file: Option<PathBuf>) -> Self {
        Self { health_file }
    }

    /// The source is open and results are being produced.
    pub fn ready(&self) {
        notify::ready();
    }

    /// Signals that the loop is running.
    pub fn alive(&self) {
        notify::alive();
    }

    /// Watchdog interval of systemd; `None` if there is no watchdog.
    #[must_use]
    pub fn alive_within(&self) -> Option<Duration> {
        notify::watchdog()
    }

    /// Reports the status; called once per second.
    ///
    /// # Errors
    /// The system's error when the health file cannot be written.
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
        // Written by renaming, so that readers never see a partial file.
        let beside = path.with_extension("tmp");
        let mut file = std::fs::File::create(&beside)?;
        file.write_all(serde_json::to_string(&health)?.as_bytes())?;
        drop(file);
        std::fs::rename(&beside, path)
    }

    /// Signals the end and removes the health file, so that it does not pass for that of a running host.
    pub fn stopping(&self) {
        notify::stopping();
        if let Some(path) = &self.health_file {
            // The file may not exist.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// systemd's protocol. Errors are ignored: systemd reacts to missing notifications itself.
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

/// Without systemd.
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_host_in_trouble_says_so_in_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("health.json");
        let supervisor = Supervisor::new(Some(path.clone()));
        let read = || -> Health { serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap() };
        supervisor.status(&Status::default()).unwrap();
        assert!(read().healthy && check(&path, 60.0).is_ok());
        let trouble = Some("no image for 2 s".to_owned());
        supervisor.status(&Status { trouble: trouble.clone(), ..Status::default() }).unwrap();
        assert_eq!((read().healthy, read().trouble), (false, trouble));
        assert!(matches!(check(&path, 60.0), Err(HealthError::Trouble { .. })));
        supervisor.stopping();
        assert!(matches!(check(&path, 60.0), Err(HealthError::Read { .. })));
    }
}
