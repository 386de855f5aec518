//! Recordings: MCAP files with ROS 2 messages, readable by Foxglove, Rerun and rosbag tools.
//!
//! [`Recording`] passes pairs, messages and events to its own thread, so that the robot never waits for a
//! disk. The thread appends whole chunks of at most half a second; in a truncated file, everything before
//! the last chunk remains readable. Each file holds the configuration as metadata, and the part's mesh,
//! the gel's compliance matrix and the rest state as attachments. [`crate::replay`] needs nothing else.
//!
//! A simulated run takes its times from the frame source alone and gives the same bytes every time.

mod capture;
pub mod cdr;
mod decode;
mod error;
mod images;
pub mod messages;
mod part;
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
/// Its entry with the whole configuration including the rig, as TOML.
pub const METADATA_CONFIG: &str = "config_toml";
/// Its entry with the version of gelstereo-host that wrote the file.
pub const METADATA_VERSION: &str = "version";
/// Its entry with the index of the file within the recording, from 0.
pub const METADATA_PART: &str = "part";
/// Its entry with the clock of log times, `source` or `wall`.
pub const METADATA_CLOCK: &str = "log_clock";
/// Its entry with the JPEG decoder and its version.
pub const METADATA_DECODER: &str = "jpeg_decoder";
/// Name of the attachment with the gel's compliance matrix, if the configuration has one.
pub const ATTACHMENT_COMPLIANCE: &str = "gel.compliance";
/// Name of the attachment with the rest state, JSON of [`gelstereo_core::pipeline::RestRecord`].
pub const ATTACHMENT_REST: &str = "rest.json";
