//! Frame selection of a live source.

use serde::{Deserialize, Serialize};

/// Which frames of a camera or a stream are handed over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameMode {
    /// The newest; those before it that were not fetched are dropped and counted.
    #[default]
    Latest,
    /// All, in their order. The producer of a stream waits while the host is behind. A camera does not wait:
    /// what the reader leaves longer than `queue_frames` is lost, oldest first, and counted.
    Every,
}
