//! The summary of a job that broke off with an error.

use super::{PageReport, StageReport};
use serde::Serialize;

/// Report of a job that broke off, in the form of a [`super::JobReport`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorReport {
    /// The error as an outcome.
    pub outcome: ErrorOutcome,
    /// The error in words.
    pub why: String,
    /// The completed stages.
    pub stages: Vec<StageReport>,
    /// The page of the run, if one was written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PageReport>,
}

/// Takes the place of the [`super::Outcome`] of a completed job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum ErrorOutcome {
    /// The job broke off.
    Error {
        /// Kind of error, see [`crate::run::HostError::cause`].
        cause: &'static str,
    },
}

impl ErrorReport {
    /// From an error of the kind `cause`, its text `why`, and the stages done before it.
    #[must_use]
    pub fn new(cause: &'static str, why: String, stages: Vec<StageReport>, page: Option<PageReport>) -> Self {
        Self { outcome: ErrorOutcome::Error { cause }, why, stages, page }
    }
}
