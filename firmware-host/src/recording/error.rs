//! Errors in writing or reading a recording.

use super::{METADATA_CONFIG, cdr};
use std::path::PathBuf;

/// Reason why a recording cannot be written or read.
#[derive(Debug)]
pub enum RecordingError {
    /// A file system operation failed.
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operation.
        doing: &'static str,
        /// The system's error.
        error: std::io::Error,
    },
    /// The file is not MCAP, or is damaged before its end.
    Format(mcap::McapError),
    /// The disk is full, missing or unreadable.
    Disk(std::io::Error),
    /// A message does not match its schema.
    Message {
        /// Its topic.
        topic: &'static str,
        /// The decoding error.
        error: cdr::CdrError,
    },
    /// A text in the recording was not written by gelstereo-host.
    Content {
        /// Place in the recording.
        place: &'static str,
        /// Description of the error.
        error: String,
    },
    /// The recording lacks its configuration.
    NoConfig,
}

impl std::fmt::Display for RecordingError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io { path, doing, error } => write!(f, "cannot {doing} {}: {error}", path.display()),
            Self::Disk(error) => write!(f, "the recording cannot be written or read: {error}"),
            // The library reports a chunk that cannot be unpacked as an I/O error.
            Self::Format(mcap::McapError::Io(error)) => {
                write!(f, "this is not an intact MCAP recording: a chunk cannot be unpacked: {error}")
            }
            Self::Format(error) => write!(f, "this is not an intact MCAP recording: {error}"),
            Self::Message { topic, error } => write!(f, "a message on {topic}: {error}"),
            Self::Content { place, error } => write!(f, "{place} of the recording: {error}"),
            Self::NoConfig => write!(
                f,
                "the recording holds no {METADATA_CONFIG} before its first message or its end; only \
                 recordings of `gelstereo-host run` can be replayed"
            ),
        }
    }
}

impl std::error::Error for RecordingError {}

impl RecordingError {
    /// Classifies an error while writing: a disk error unless the library rejects the content.
    pub(super) fn writing(error: mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(error) => Self::Disk(error),
            error => Self::Format(error),
        }
    }
}

impl From<mcap::McapError> for RecordingError {
    fn from(error: mcap::McapError) -> Self {
        Self::Format(error)
    }
}
