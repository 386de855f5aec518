//! Measures the write rate of the recording's disk.

use crate::check::disk::{RecordingNeed, existing, folder_of, free_bytes};
use crate::config::Config;
use crate::finding::Finding;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The trial ends after this much data or time, whichever comes first. Shorter trials mostly measure
/// caches.
const MAX_TRIAL_BYTES: u64 = 256 << 20;
const MAX_TRIAL: Duration = Duration::from_secs(1);
const BLOCK_BYTES: usize = 1 << 20;
/// Required ratio of disk rate to data rate, as a reserve for the system's other work.
const RESERVE: f64 = 2.0;

/// Measures the disk of the recording.
pub(super) fn examine(config: &Config) -> Finding {
    const SUBJECT: &str = "disk";
    let folder = existing(folder_of(&config.recording.path));
    let rate = match write_rate(&folder) {
        Ok(rate) => rate,
        Err(error) => {
            let found = format!("cannot write to {}: {error}", folder.display());
            return Finding::wrong(SUBJECT, found).with_advice("choose another recording.path");
        }
    };
    let free =
        free_bytes(&folder).map_or(String::new(), |free| format!(", {:.1} GB free", free as f64 * 1e-9));
    let found = format!("{} takes {:.0} MB/s{free}", folder.display(), rate * 1e-6);
    let Ok(need) = RecordingNeed::of(config) else { return Finding::ok(SUBJECT, found) };
    let needed =
        format!("a recording needs up to {:.1} MB/s before compression", need.max_bytes_per_s * 1e-6);
    judge(found, &needed, rate / need.max_bytes_per_s)
}

/// Finding from the ratio of measured to required rate.
fn judge(found: String, needed: &str, ratio: f64) -> Finding {
    const SUBJECT: &str = "disk";
    let found = format!("{found}; {needed}");
    if ratio < RESERVE {
        return Finding::warn(SUBJECT, found, "record to a faster disk, or record every nth pair");
    }
    Finding::ok(SUBJECT, found)
}

/// A file that is always removed.
struct Trial(PathBuf);

impl Drop for Trial {
    fn drop(&mut self) {
        // A failure to remove the file cannot be handled here.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Write rate in bytes per second, including the sync to disk.
fn write_rate(folder: &Path) -> io::Result<f64> {
    let trial = Trial(folder.join(format!(".gelstereo-host-doctor-{}", std::process::id())));
    let mut file: File = OpenOptions::new().write(true).create_new(true).open(&trial.0)?;
    // Zeros would be optimised away by some disks.
    let mut state = 1u64;
    let block: Vec<u8> = (0..BLOCK_BYTES)
        .map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 56) as u8
        })
        .collect();
    let (began, mut written) = (Instant::now(), 0u64);
    while written < MAX_TRIAL_BYTES && began.elapsed() < MAX_TRIAL {
        file.write_all(&block)?;
        written += BLOCK_BYTES as u64;
    }
    file.sync_data()?;
    Ok(written as f64 / began.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;

    #[test]
    fn a_trial_leaves_nothing_behind() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        assert!(write_rate(folder.path())? > 0.0);
        assert_eq!(std::fs::read_dir(folder.path())?.count(), 0);
        assert!(write_rate(&folder.path().join("missing")).is_err());
        Ok(())
    }

    #[test]
    fn a_disk_that_is_barely_fast_enough_is_a_warning() {
        let level = |ratio| judge("disk".to_owned(), "need", ratio).level;
        assert_eq!([level(0.5), level(1.5), level(3.0)], [Level::Warn, Level::Warn, Level::Ok]);
    }
}
