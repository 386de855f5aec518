//! Text protocol of the Robotiq Gripper URCap on a UR controller, TCP port 63352.
//!
//! `SET name value ...` is answered by `ack`, and `GET name` by `name value`. Lines end with a line
//! feed.

use std::fmt;

/// Port of the URCap's server on the controller.
pub const PORT: u16 = 63352;
/// Longest accepted line. Replies are shorter: a name, a blank and three digits.
const MAX_LINE: usize = 64;

/// Variable of the gripper; values are those of [`super::robotiq`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variable {
    /// Activate.
    Act,
    /// Move to the position.
    Gto,
    /// Emergency release.
    Atr,
    /// Position; reading returns the present one.
    Pos,
    /// Speed.
    Spe,
    /// Force.
    For,
    /// Activation, read only: 0 reset, 1 activating, 3 active.
    Sta,
    /// Commanded position, read only.
    Pre,
    /// Motion of the fingers, read only: 0 moving, 1 and 2 stopped by contact, 3 arrived.
    Obj,
    /// Fault, read only.
    Flt,
}

impl Variable {
    /// Name in the protocol.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Act => "ACT",
            Self::Gto => "GTO",
            Self::Atr => "ATR",
            Self::Pos => "POS",
            Self::Spe => "SPE",
            Self::For => "FOR",
            Self::Sta => "STA",
            Self::Pre => "PRE",
            Self::Obj => "OBJ",
            Self::Flt => "FLT",
        }
    }
}

/// Line that sets variables in this order.
#[must_use]
pub fn set(values: &[(Variable, u8)]) -> String {
    let pairs: Vec<String> =
        values.iter().map(|(variable, value)| format!("{} {value}", variable.name())).collect();
    format!("SET {}\n", pairs.join(" "))
}

/// Line that reads a variable.
#[must_use]
pub fn get(variable: Variable) -> String {
    format!("GET {}\n", variable.name())
}

/// A line that does not answer the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplyError {
    /// Line received.
    pub found: String,
    /// Valid line.
    pub expected: String,
}

impl fmt::Display for ReplyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the URCap answered {:?}, expected {}", self.found, self.expected)
    }
}

impl std::error::Error for ReplyError {}

/// Assembles reply lines from received bytes.
#[derive(Clone, Debug, Default)]
pub struct LineReader {
    bytes: Vec<u8>,
}

impl LineReader {
    /// Adds received bytes and returns the next complete line without its end, if any. Call again with
    /// an empty slice for more.
    ///
    /// # Errors
    /// [`ReplyError`] if a line has no end; its bytes are dropped.
    pub fn push(&mut self, bytes: &[u8]) -> Option<Result<String, ReplyError>> {
        self.bytes.extend_from_slice(bytes);
        // Some versions of the URCap send the reply to SET without a line feed.
        let end = match self.bytes.iter().position(|&byte| byte == b'\n') {
            Some(end) => end + 1,
            None if self.bytes == b"ack" => self.bytes.len(),
            None if self.bytes.len() > MAX_LINE => {
                let found = String::from_utf8_lossy(&std::mem::take(&mut self.bytes)).into_owned();
                return Some(Err(ReplyError { found, expected: "a line of at most 64 bytes".to_owned() }));
            }
            None => return None,
        };
        let line: Vec<u8> = self.bytes.drain(..end).collect();
        Some(Ok(String::from_utf8_lossy(&line).trim().to_owned()))
    }
}

/// Checks that a line acknowledges a `SET`.
///
/// # Errors
/// [`ReplyError`].
pub fn acknowledged(line: &str) -> Result<(), ReplyError> {
    if line == "ack" {
        return Ok(());
    }
    Err(ReplyError { found: line.to_owned(), expected: "\"ack\"".to_owned() })
}

/// Value in a line that answers a `GET` of this variable.
///
/// # Errors
/// [`ReplyError`].
pub fn value(line: &str, variable: Variable) -> Result<u8, ReplyError> {
    line.strip_prefix(variable.name())
        .and_then(|rest| rest.strip_prefix(' '))
        .and_then(|number| number.trim().parse().ok())
        .ok_or_else(|| ReplyError {
            found: line.to_owned(),
            expected: format!("\"{} \" and a number from 0 to 255", variable.name()),
        })
}
