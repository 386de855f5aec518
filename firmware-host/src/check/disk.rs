//! Checks whether a recording fits: folder, free space and data rate.

use crate::config::{Config, ConfigError, SourceConfig};
use crate::finding::Finding;
use std::path::{Path, PathBuf};

/// Data rate of a recording and planned duration of the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordingNeed {
    /// Largest rate: both images uncompressed, in bytes per second.
    pub max_bytes_per_s: f64,
    /// Duration of the stages whose time is set by the task, in seconds.
    pub planned_s: f64,
}

/// Results without images, bytes per pair: a point cloud of 625 markers and the rest.
const RESULT_BYTES: f64 = 32e3;

impl RecordingNeed {
    /// Need of a configuration.
    ///
    /// # Errors
    /// [`ConfigError::RigSource`].
    pub fn of(config: &Config) -> Result<Self, ConfigError> {
        let rig = config.rig()?;
        let pixels: usize =
            [&rig.left, &rig.right].map(|camera| camera.width_px * camera.height_px).iter().sum();
        let rate_hz = frame_rate_hz(config);
        let planned_s = config.task.planned_s().iter().map(|(_, seconds)| seconds).sum();
        Ok(Self { max_bytes_per_s: rate_hz * (pixels as f64 + RESULT_BYTES), planned_s })
    }
}

/// Rate of the pairs.
fn frame_rate_hz(config: &Config) -> f64 {
    match config.source {
        SourceConfig::Simulated => config.simulated.frame_rate_hz,
        SourceConfig::Folder { frame_rate_hz, .. } => frame_rate_hz,
        SourceConfig::Camera(ref camera) => camera.frame_rate_hz,
        // Without a stated rate the stream's own timestamps apply; the simulated rate is a rough guess.
        SourceConfig::Stream(ref stream) => stream.frame_rate_hz.unwrap_or(config.simulated.frame_rate_hz),
    }
}

/// Folder of a recording.
#[must_use]
pub fn folder_of(recording: &Path) -> &Path {
    recording.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The nearest existing parent folder: missing folders are created when the recording begins.
#[must_use]
pub fn existing(folder: &Path) -> PathBuf {
    let up = folder.ancestors().find(|f| f.exists() && !f.as_os_str().is_empty());
    up.unwrap_or(Path::new(".")).to_owned()
}

/// Free bytes on the folder's disk.
///
/// # Errors
/// Error of the system.
#[cfg(unix)]
pub fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Free bytes on the folder's disk.
///
/// # Errors
/// Always: only Unix systems are supported.
#[cfg(not(unix))]
pub fn free_bytes(_folder: &Path) -> std::io::Result<u64> {
    Err(std::io::ErrorKind::Unsupported.into())
}

/// Writes and removes a test file beside the recording, and compares the free space with the need.
pub(super) fn examine(config: &Config) -> Finding {
    const SUBJECT: &str = "recording";
    let path = &config.recording.path;
    if path.is_dir() {
        let found = format!("recording.path is the folder {}", path.display());
        return Finding::wrong(SUBJECT, found).with_advice("name a file in it, for example run.mcap");
    }
    let folder = existing(folder_of(path));
    if let Err(error) = try_to_write(&folder) {
        let found = format!("cannot write in {}: {error}", folder.display());
        return Finding::wrong(SUBJECT, found).with_advice("choose another recording.path");
    }
    let (Ok(need), Ok(free)) = (RecordingNeed::of(config), free_bytes(&folder)) else {
        return Finding::ok(SUBJECT, path.display().to_string());
    };
    fits(path, need, free as f64)
}

/// Whether the planned duration fits the disk, and how long the disk lasts.
fn fits(path: &Path, need: RecordingNeed, free: f64) -> Finding {
    const SUBJECT: &str = "recording";
    let lasts_s = free / need.max_bytes_per_s;
    let found = format!(
        "{}: up to {:.1} MB/s before compression, {:.1} GB free, enough for {}",
        path.display(),
        need.max_bytes_per_s * 1e-6,
        free * 1e-9,
        duration(lasts_s)
    );
    let advice = "free some space or choose another recording.path";
    if lasts_s < need.planned_s {
        return Finding::wrong(SUBJECT, found).with_advice(advice);
    }
    if lasts_s < MIN_LASTING_S { Finding::warn(SUBJECT, found, advice) } else { Finding::ok(SUBJECT, found) }
}

/// A disk that fills up sooner gives a warning: ten minutes are some tens of grasps.
const MIN_LASTING_S: f64 = 600.0;

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} h", s / 3600.0),
    }
}

fn try_to_write(folder: &Path) -> std::io::Result<()> {
    let probe = folder.join(format!(".gelstereo-host-check-{}", std::process::id()));
    let written = std::fs::write(&probe, [0]);
    // Also remove a file that was created but not written.
    let removed = std::fs::remove_file(&probe);
    written.and(removed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;

    #[test]
    fn a_disk_that_is_too_small_for_the_job_is_wrong_and_one_soon_full_a_warning() {
        let need = RecordingNeed { max_bytes_per_s: 20e6, planned_s: 5.0 };
        let level = |free| fits(Path::new("run.mcap"), need, free).level;
        assert_eq!([level(90e6), level(110e6), level(1e12)], [Level::Wrong, Level::Warn, Level::Ok]);
        let text = fits(Path::new("run.mcap"), need, 110e6).to_string();
        assert!(
            text.contains("up to 20.0 MB/s before compression, 0.1 GB free, enough for 6 s; free"),
            "{text}"
        );
    }

    #[test]
    fn a_need_follows_from_images_and_rate() {
        let mut config = Config::default();
        let need =
            RecordingNeed::of(&config).unwrap_or(RecordingNeed { max_bytes_per_s: 0.0, planned_s: 0.0 });
        assert_eq!(need.max_bytes_per_s, 30.0 * (2.0 * 640.0 * 480.0 + RESULT_BYTES));
        config.simulated.frame_rate_hz = 60.0;
        let twice = RecordingNeed::of(&config).map(|need| need.max_bytes_per_s).unwrap_or_default();
        assert_eq!(twice, 2.0 * need.max_bytes_per_s);
        assert!(need.planned_s > 1.0);
    }
}
