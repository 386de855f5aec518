//! Recordings: MCAP files with ROS 2 messages, that Foxglove, Rerun and rosbags open as they are.
//!
//! [`Recording`] takes pairs, messages and events and hands them to a thread of its own. The thread appends whole
//! chunks of at most half a second, so that of a file that was cut off everything before the last chunk can
//! be read, and so that no disk makes the robot wait. The configuration stands in each file's metadata, the
//! part's mesh and the rest state among its attachments: a recording is all that [`crate::replay`] needs.
//!
//! A simulated run has its times from the frame source alone and gives the same bytes every time.

mod capture;
pub mod cdr;
mod decode;
mod error;
mod images;
pub mod messages;
mod part;
pub mod png;
mod reader;
mod recover;
mod ring;
mod schemas;
mod session;
mod shared;
mod sink;
mod store;
mod topic;
mod worker;

pub use capture::{CaptureNote, pixel_crc};
pub use decode::ImageDecoder;
pub use error::RecordingError;
pub use reader::{Item, Reader};
pub use recover::{Recovered, recover};
pub use schemas::Schema;
pub use session::{Content, LogClock, Recording, RecordingReport};
pub use sink::MessageSink;
pub use store::{OpenPart, SharedBuffer, Store, part_path};
pub use topic::Topic;

/// Name of the metadata record that holds the configuration.
pub const METADATA: &str = "gelstereo";
/// Its entry with the whole configuration, rig included, as TOML.
pub const METADATA_CONFIG: &str = "config_toml";
/// Its entry with the version of gelstereo-host that wrote the file.
pub const METADATA_VERSION: &str = "version";
/// Its entry with the number of the part, from 0.
pub const METADATA_PART: &str = "part";
/// Its entry with the clock of log times, `source` or `wall`.
pub const METADATA_CLOCK: &str = "log_clock";
/// Its entry with the JPEG decoder and its version.
pub const METADATA_DECODER: &str = "jpeg_decoder";
/// Name of the attachment with the rest state, JSON of [`gelstereo_core::pipeline::RestRecord`].
pub const ATTACHMENT_REST: &str = "rest.json";
