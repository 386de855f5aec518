//! The summary of a job that broke off with an error.

use super::{PageReport, StageReport};
use serde::Serialize;

/// What came of a job that broke off, in the form of a [`super::JobReport`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorReport {
    /// What broke it off.
    pub outcome: ErrorOutcome,
    /// The error in words.
    pub why: String,
    /// The stages that were over.
    pub stages: Vec<StageReport>,
    /// The page of the run, where one was written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PageReport>,
}

/// Stands where a job that came to its end has its [`super::Outcome`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum ErrorOutcome {
    /// The job broke off.
    Error {
        /// What kind of error it is; [`crate::run::HostError::cause`] names them.
        cause: &'static str,
    },
}

impl ErrorReport {
    /// Of an error of the kind `cause`, said in the words of `why`, and of what was done before it.
    #[must_use]
    pub fn new(cause: &'static str, why: String, stages: Vec<StageReport>, page: Option<PageReport>) -> Self {
        Self { outcome: ErrorOutcome::Error { cause }, why, stages, page }
    }
}
