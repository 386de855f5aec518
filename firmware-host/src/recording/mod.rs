//! Recordings: MCAP files with ROS 2 messages, that Foxglove, Rerun and rosbags open as they are.
//!
//! Every frame ends its own chunk and is flushed, so that of a file that was cut off everything before the cut can be
//! read. The configuration stands in the file's metadata and a part's mesh among its attachments: a recording is all
//! that [`crate::replay`] needs. Times are the frame source's; nothing in the file comes from another clock, so that a
//! simulated run gives the same bytes every time.

pub mod cdr;
pub mod messages;
mod reader;
mod schemas;
mod writer;

pub use reader::{Item, Reader};
pub use schemas::Schema;
pub use writer::{Recorder, SharedBuffer};

use std::path::PathBuf;

/// Name of the metadata record that holds the configuration.
pub const METADATA: &str = "gelstereo";
/// Its entry with the whole configuration, rig included, as TOML.
pub const METADATA_CONFIG: &str = "config_toml";
/// Its entry with the version of gelstereo-host that wrote the file.
pub const METADATA_VERSION: &str = "version";

/// What a recording holds, one MCAP channel each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Left image, mono8.
    LeftImage,
    /// Right image, mono8.
    RightImage,
    /// All markers as a cloud, metres.
    Points,
    /// Evidence of a frame and its digest, JSON.
    Frame,
    /// The part in the sensor frame with its covariance, metres and radians.
    Pose,
    /// The gripper's width, metres.
    Gripper,
    /// The gripper in the robot's base, metres.
    Robot,
    /// Stages of the job and what was asked of the pipeline, JSON.
    Stage,
}

impl Topic {
    /// All of them, in the order of their channels.
    pub const ALL: [Self; 8] = [
        Self::LeftImage,
        Self::RightImage,
        Self::Points,
        Self::Frame,
        Self::Pose,
        Self::Gripper,
        Self::Robot,
        Self::Stage,
    ];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LeftImage => "/gelstereo/left/image",
            Self::RightImage => "/gelstereo/right/image",
            Self::Points => "/gelstereo/points",
            Self::Frame => "/gelstereo/frame",
            Self::Pose => "/gelstereo/pose",
            Self::Gripper => "/gripper/state",
            Self::Robot => "/robot/gripper_pose",
            Self::Stage => "/gelstereo/stage",
        }
    }

    /// Its message type.
    #[must_use]
    pub const fn schema(self) -> Schema {
        match self {
            Self::LeftImage | Self::RightImage => schemas::IMAGE,
            Self::Points => schemas::POINT_CLOUD,
            Self::Frame | Self::Stage => schemas::STRING,
            Self::Pose => schemas::POSE_WITH_COVARIANCE,
            Self::Gripper => schemas::JOINT_STATE,
            Self::Robot => schemas::POSE,
        }
    }

    /// The topic of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }
}

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
    fn writing(error: mcap::McapError) -> Self {
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
