//! Findings of `check` and `doctor`.

use serde::Serialize;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// No problem.
    Ok,
    /// `run` would start, but not perform well.
    Warn,
    /// `run` would not start.
    Wrong,
}

/// One examined point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Subject of the check.
    pub subject: &'static str,
    /// Severity.
    pub level: Level,
    /// Result.
    pub found: String,
    /// Advice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

impl Finding {
    /// A point without a problem.
    #[must_use]
    pub fn ok(subject: &'static str, found: impl Into<String>) -> Self {
        Self { subject, level: Level::Ok, found: found.into(), advice: None }
    }

    /// A problem that does not prevent a start.
    #[must_use]
    pub fn warn(subject: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { subject, level: Level::Warn, found: found.into(), advice: Some(advice.into()) }
    }

    /// A problem that prevents `run` from starting. Error messages contain their own advice.
    #[must_use]
    pub fn wrong(subject: &'static str, found: impl Into<String>) -> Self {
        Self { subject, level: Level::Wrong, found: found.into(), advice: None }
    }

    /// Adds advice.
    #[must_use]
    pub fn with_advice(self, advice: impl Into<String>) -> Self {
        Self { advice: Some(advice.into()), ..self }
    }
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mark = match self.level {
            Level::Ok => "ok",
            Level::Warn => "WARN",
            Level::Wrong => "WRONG",
        };
        write!(f, "{mark:<6} {:<14} {}", self.subject, self.found)?;
        match &self.advice {
            Some(advice) => write!(f, "; {advice}"),
            None => Ok(()),
        }
    }
}

/// Whether no finding is [`Level::Wrong`].
#[must_use]
pub fn all_right(findings: &[Finding]) -> bool {
    findings.iter().all(|finding| finding.level < Level::Wrong)
}
