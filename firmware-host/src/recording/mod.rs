//! Recordings: MCAP files with ROS 2 messages, that Foxglove, Rerun and rosbags open as they are.
//!
//! Every frame ends its own chunk and is flushed, so that of a file that was cut off everything before the cut can be
//! read. The configuration stands in the file's metadata and a part's mesh among its attachments: a recording is all
//! that [`crate::replay`] needs. Times are the frame source's; nothing in the file comes from another clock, so that a
//! simulated run gives the same bytes every time.

mod capture;
pub mod cdr;
mod error;
pub mod messages;
mod reader;
mod schemas;
mod session;
mod sink;
mod topic;
mod writer;

pub use capture::{CaptureNote, pixel_crc};
pub use error::RecordingError;
pub use reader::{Item, Reader};
pub use schemas::Schema;
pub use session::{Content, LogClock, Recording, RecordingReport};
pub use sink::MessageSink;
pub use topic::Topic;
pub use writer::{Recorder, SharedBuffer};

/// Name of the metadata record that holds the configuration.
pub const METADATA: &str = "gelstereo";
/// Its entry with the whole configuration, rig included, as TOML.
pub const METADATA_CONFIG: &str = "config_toml";
/// Its entry with the version of gelstereo-host that wrote the file.
pub const METADATA_VERSION: &str = "version";
