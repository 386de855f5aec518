//! Writes the page of a run to its file.

use super::{JobReport, PageReport, Trace, page};
use crate::config::Config;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Path of the page for a recording: `run.html` beside `run.mcap`.
#[must_use]
pub fn page_path(recording: &Path) -> PathBuf {
    recording.with_extension("html")
}

impl PageReport {
    /// Writes the page of a run that ended with a report or broke off.
    ///
    /// Replaces an older page of the same name. A page that cannot be written completely is removed.
    #[must_use]
    pub fn write(config: &Config, trace: &Trace, ending: Result<&JobReport, &dyn Display>) -> Self {
        let path = page_path(&config.recording.path);
        let written = std::fs::write(&path, page(config, trace, ending));
        let fault = written.err().map(|error| {
            // The disk may be full: a partial page would hide that.
            let _ = std::fs::remove_file(&path);
            format!("{} cannot be written: {error}", path.display())
        });
        Self { path, fault }
    }
}
