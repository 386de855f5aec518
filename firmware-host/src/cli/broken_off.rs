//! The summary as JSON of a job that breaks off.

use super::{CliError, say};
use gelstereo_host::report::{ErrorReport, PageReport, StageReport};

/// What a job has done so far.
#[derive(Default)]
pub(super) struct Done {
    /// The stages that are over.
    pub(super) stages: Vec<StageReport>,
    /// The page of a run that broke off.
    pub(super) page: Option<PageReport>,
}

/// Does a job. If it breaks off and JSON was asked for, standard output has the reason too.
pub(super) fn reported(
    json: bool,
    job: impl FnOnce(&mut Done) -> Result<bool, CliError>,
) -> Result<bool, CliError> {
    let mut done = Done::default();
    let result = job(&mut done);
    if let (true, Err(CliError::Host(error))) = (json, &result) {
        let report = ErrorReport::new(error.cause(), error.to_string(), done.stages, done.page);
        // The error itself follows on stderr, and matters more than one of the report.
        let _ = serde_json::to_string_pretty(&report).map_err(CliError::Json).and_then(say);
    }
    result
}
