//! Why a recording cannot be written or read.

use super::{METADATA_CONFIG, cdr};
use std::path::PathBuf;

/// Why a recording cannot be written or read.
#[derive(Debug)]
pub enum RecordingError {
    /// The file system said no.
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried.
        doing: &'static str,
        /// The system's answer.
        error: std::io::Error,
    },
    /// The file is no MCAP file, or is damaged in the middle.
    Format(mcap::McapError),
    /// The disk is full or away, or cannot be read.
    Disk(std::io::Error),
    /// A message is not what its schema says.
    Message {
        /// Its topic.
        topic: &'static str,
        /// Why.
        error: cdr::CdrError,
    },
    /// A text in the recording is not what gelstereo-host writes there.
    Content {
        /// Where.
        place: &'static str,
        /// What is wrong.
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
            // The library's own words for a chunk that cannot be unpacked are about input and output.
            Self::Format(mcap::McapError::Io(error)) => {
                write!(f, "this is no intact MCAP recording: a chunk cannot be unpacked: {error}")
            }
            Self::Format(error) => write!(f, "this is no intact MCAP recording: {error}"),
            Self::Message { topic, error } => write!(f, "a message on {topic}: {error}"),
            Self::Content { place, error } => write!(f, "{place} of the recording: {error}"),
            Self::NoConfig => write!(
                f,
                "the recording holds no {METADATA_CONFIG} before its first message or its end; only recordings of \
                 `gelstereo-host run` can be replayed"
            ),
        }
    }
}

impl std::error::Error for RecordingError {}

impl RecordingError {
    /// An error while writing: of the disk, unless the library refuses the content.
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
