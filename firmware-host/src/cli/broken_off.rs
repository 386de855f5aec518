//! JSON summary of an aborted job.

use super::{CliError, say};
use gelstereo_host::report::{ErrorReport, PageReport, StageReport};

/// Progress of a job.
#[derive(Default)]
pub(super) struct Done {
    /// Completed stages.
    pub(super) stages: Vec<StageReport>,
    /// Report page of an aborted run.
    pub(super) page: Option<PageReport>,
}

/// Runs a job. If it is aborted and JSON was requested, the reason is also written to standard output.
pub(super) fn reported(
    json: bool,
    job: impl FnOnce(&mut Done) -> Result<bool, CliError>,
) -> Result<bool, CliError> {
    let mut done = Done::default();
    let result = job(&mut done);
    if let (true, Err(CliError::Host(error))) = (json, &result) {
        let report = ErrorReport::new(error.cause(), error.to_string(), done.stages, done.page);
        // The error itself follows on stderr and takes precedence over an error in writing the report.
        let _ = serde_json::to_string_pretty(&report).map_err(CliError::Json).and_then(say);
    }
    result
}
