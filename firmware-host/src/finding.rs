//! What `check` and `doctor` find, point by point.

use serde::Serialize;

/// How good or bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// As it should be.
    Ok,
    /// `run` would start, but not do well.
    Warn,
    /// `run` would not start.
    Wrong,
}

/// One point that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub subject: &'static str,
    /// How good or bad it is.
    pub level: Level,
    /// What was found.
    pub found: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

impl Finding {
    /// All is well.
    #[must_use]
    pub fn ok(subject: &'static str, found: impl Into<String>) -> Self {
        Self { subject, level: Level::Ok, found: found.into(), advice: None }
    }

    /// Not as it should be, but no reason to stop.
    #[must_use]
    pub fn warn(subject: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { subject, level: Level::Warn, found: found.into(), advice: Some(advice.into()) }
    }

    /// `run` would not start. Errors say what to do themselves.
    #[must_use]
    pub fn wrong(subject: &'static str, found: impl Into<String>) -> Self {
        Self { subject, level: Level::Wrong, found: found.into(), advice: None }
    }

    /// The same with what to do about it.
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

/// Whether nothing is wrong.
#[must_use]
pub fn all_right(findings: &[Finding]) -> bool {
    findings.iter().all(|finding| finding.level < Level::Wrong)
}
