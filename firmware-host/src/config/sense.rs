//! Sensing alone: rest, contact, localization, and who may listen.

use super::range::{TIME_S, check};
use super::{ConfigError, PoseConfig};
use gelstereo_core::frames::FingerKinematics;
use serde::{Deserialize, Serialize};

/// When the part is localized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LocalizeWhen {
    /// Never.
    Never,
    /// As soon as something touches the gel, and in every frame while it does.
    #[default]
    Contact,
}

/// Sensing alone, without a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SenseConfig {
    /// When the part is localized: `never` or `contact`. Default: `contact`.
    pub localize: LocalizeWhen,
    /// Where the part is expected in the sensor frame once it touches. Default: none, it is where the task
    /// expects it with the fingers `grasp_width_mm` apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub t_sensor_object: Option<PoseConfig>,
    /// Opening of the gripper when it holds the part. Default: `8` mm, the diameter of the default part.
    pub grasp_width_mm: f64,
    /// After the part was lost, or could not be localized, it is searched again this long after. A search
    /// takes many times as long as following does. Default: `0.5` s.
    pub search_pause_s: f64,
    /// Good frames in a row without contact that make the rest state. More guard better against a gel that
    /// still moves. Default: `5`.
    pub rest_frames: u32,
    /// Markers that moved farther than this on average within these frames show that the gel is not at rest.
    /// Default: `0.5` px.
    pub max_rest_motion_px: f64,
    /// Salient markers from which something touches the gel. One may be noise; a sphere of 2 mm covers about
    /// ten. Default: `3`.
    pub min_salient: u32,
    /// Without a good frame for so long, sensing counts as unhealthy. Default: `5` s.
    pub max_silence_s: f64,
    /// ROS 2 over zenoh, for `--publish zenoh`.
    pub zenoh: ZenohConfig,
    /// Foxglove and Lichtblick, for `--publish foxglove`.
    pub foxglove: FoxgloveConfig,
}

impl Default for SenseConfig {
    fn default() -> Self {
        Self {
            localize: LocalizeWhen::default(),
            t_sensor_object: None,
            grasp_width_mm: 8.0,
            search_pause_s: 0.5,
            rest_frames: 5,
            max_rest_motion_px: 0.5,
            min_salient: 3,
            max_silence_s: 5.0,
            zenoh: ZenohConfig::default(),
            foxglove: FoxgloveConfig::default(),
        }
    }
}

/// How messages' types are named on zenoh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TypeHash {
    /// By the RIHS01 hash: ROS 2 Jazzy and later.
    #[default]
    Rihs01,
    /// By the word `TypeHashNotSupported`: ROS 2 Humble.
    NotSupported,
}

/// ROS 2 messages over zenoh, named as `rmw_zenoh` expects them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ZenohConfig {
    /// Routers and peers to connect to; tried again until they answer. Default: `["tcp/127.0.0.1:7447"]`, a
    /// router of `rmw_zenoh` on this computer.
    pub connect: Vec<String>,
    /// Where to listen. Another address than 127.0.0.1 lets other computers in. Default:
    /// `["tcp/127.0.0.1:0"]`, any free port.
    pub listen: Vec<String>,
    /// Whether to look for peers on the network by multicast. Default: `false`.
    pub multicast: bool,
    /// `ROS_DOMAIN_ID` of the listeners. Default: `0`.
    pub domain_id: u32,
    /// `rihs01` or `not_supported` (ROS 2 Humble). Default: `rihs01`.
    pub type_hash: TypeHash,
    /// Whether images are published too: 18 MB/s at 640 x 480 and 30 Hz. Default: `false`.
    pub images: bool,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            connect: vec!["tcp/127.0.0.1:7447".to_owned()],
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            multicast: false,
            domain_id: 0,
            type_hash: TypeHash::default(),
            images: false,
        }
    }
}

/// The WebSocket that Foxglove and Lichtblick open.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FoxgloveConfig {
    /// Address to listen on. Another one than 127.0.0.1 lets other computers in. Default: `127.0.0.1`.
    pub host: String,
    /// Default: `8765`. With 0 the system chooses, and the log says which.
    pub port: u16,
    /// Whether images are published too; they are sent only to viewers that show them. Default: `true`.
    pub images: bool,
}

impl Default for FoxgloveConfig {
    fn default() -> Self {
        Self { host: "127.0.0.1".to_owned(), port: 8765, images: true }
    }
}

impl SenseConfig {
    pub(super) fn validate(&self, kinematics: &FingerKinematics) -> Result<(), ConfigError> {
        let s = self;
        if let Some(pose) = s.t_sensor_object {
            pose.validate("sense.t_sensor_object")?;
        }
        let (min_mm, max_mm) = kinematics.width_range_mm();
        let opens = s.grasp_width_mm >= min_mm && s.grasp_width_mm <= max_mm;
        let valid = "a width that mount.kinematics can have";
        check(opens, "sense.grasp_width_mm", s.grasp_width_mm, valid)?;
        let pause_s = s.search_pause_s;
        check((0.0..=3600.0).contains(&pause_s), "sense.search_pause_s", pause_s, "0 to 3600 s")?;
        TIME_S.check("sense.max_silence_s", s.max_silence_s)?;
        let motion_px = s.max_rest_motion_px;
        check(
            motion_px > 0.0 && motion_px <= 100.0,
            "sense.max_rest_motion_px",
            motion_px,
            "above 0, to 100 px",
        )?;
        let counts = [
            ("sense.rest_frames", s.rest_frames, 1..=10_000, "1 to 10000 frames"),
            ("sense.min_salient", s.min_salient, 1..=100_000, "1 to 100000 markers"),
            // Higher ones need ports that many systems do not hand out.
            ("sense.zenoh.domain_id", s.zenoh.domain_id, 0..=232, "0 to 232, as ROS 2 has it"),
        ];
        for (name, found, valid, words) in counts {
            check(valid.contains(&found), name, f64::from(found), words)?;
        }
        Ok(())
    }
}
