//! Where the recording goes, and what of the frames it keeps.

use super::ConfigError;
use super::range::{TIME_S, check};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where the recording goes, and what of the frames it keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// MCAP file; an existing file is replaced. Further parts of a long recording are in the same folder:
    /// `run_0001.mcap` and so on. Default: `out/run.mcap`. Change it for every run that is to be kept.
    pub path: PathBuf,
    /// Format of plain images; a camera's Motion JPEG is stored unchanged. Default: `png`. Change it to `raw`
    /// where time matters more than space.
    pub images: ImageFormat,
    /// Images of every nth pair are recorded; results of all pairs are recorded. Valid: 1 to 100000 pairs.
    /// Default: `1`. Raise it to save space; only pairs with images can be computed again.
    pub every_nth: u32,
    /// Amount of data recorded. Default: `all`. Change it to `ring` where only moments around triggers
    /// matter.
    pub mode: RecordingMode,
    /// Size at which a file is closed and a new part begins. Valid: 1 to 1000000 MB. Default: `1024` MB.
    /// Change it to what your tools and disks handle well.
    pub split_mb: u32,
    /// With the mode `ring`: time recorded before a trigger. Valid: 0.001 to 3600 s. Default: `60` s. Raise
    /// it with `ring_mb`.
    pub ring_s: f64,
    /// With the mode `ring`: memory for that time; beyond it the oldest messages are dropped. Valid: 1 to
    /// 100000 MB. Default: `512` MB. Change it to the memory that can be spared.
    pub ring_mb: u32,
    /// With the mode `ring`: time recorded after a trigger. Valid: 0.001 to 3600 s. Default: `5` s. Raise it
    /// where what follows a trigger matters.
    pub ring_after_s: f64,
    /// Whether `run` writes a report next to the recording, such as `run.html` for `run.mcap`. Valid: `true`
    /// or `false`. Default: `true`. Change it to `false` where nobody reads pages, to save about 2 MB.
    pub report: bool,
}

/// Format of plain images. Every format is lossless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageFormat {
    /// `sensor_msgs/CompressedImage` with the format `png`.
    #[default]
    Png,
    /// `sensor_msgs/Image`, mono8.
    Raw,
}

/// Amount of data in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordingMode {
    /// Everything.
    #[default]
    All,
    /// The time around each trigger.
    Ring,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self {
            path: PathBuf::from("out/run.mcap"),
            images: ImageFormat::default(),
            every_nth: 1,
            mode: RecordingMode::default(),
            split_mb: 1024,
            ring_s: 60.0,
            ring_mb: 512,
            ring_after_s: 5.0,
            report: true,
        }
    }
}

impl RecordingConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let counts = [
            ("recording.every_nth", self.every_nth, 1..=100_000, "1 to 100000 pairs"),
            ("recording.split_mb", self.split_mb, 1..=1_000_000, "1 to 1000000 MB"),
            ("recording.ring_mb", self.ring_mb, 1..=100_000, "1 to 100000 MB"),
        ];
        for (name, found, valid, words) in counts {
            check(valid.contains(&found), name, f64::from(found), words)?;
        }
        TIME_S.check("recording.ring_s", self.ring_s)?;
        TIME_S.check("recording.ring_after_s", self.ring_after_s)
    }
}
