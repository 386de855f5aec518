//! Sensing alone: rest, contact, localization, and publishing.

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
    /// In every frame with contact.
    #[default]
    Contact,
}

/// Sensing alone, without a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SenseConfig {
    /// Condition for localizing the part. Default: `contact`. Change it to `never` where only contact
    /// matters.
    pub localize: LocalizeWhen,
    /// Expected pose of the part in the sensor frame at contact. Default: none; the task's expected pose with
    /// the fingers `grasp_width_mm` apart. Set it where no gripper holds the sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub t_sensor_object: Option<PoseConfig>,
    /// Opening of the gripper when it holds the part, within the range of `mount.kinematics`. Valid: 0 to
    /// 1000 mm. Default: `8` mm, the diameter of the default part. Change it to your part's width.
    pub grasp_width_mm: f64,
    /// Pause before searching again for a part that was lost or not localized. A search takes many times as
    /// long as tracking. Valid: 0 to 3600 s. Default: `0.5` s. Lower it on a fast computer.
    pub search_pause_s: f64,
    /// Number of consecutive good frames without contact that define the rest state. More frames protect
    /// against a gel that still moves. Valid: 1 to 10000 frames. Default: `5`. Raise it for a gel that
    /// creeps.
    pub rest_frames: u32,
    /// Largest mean motion of the markers within these frames for a gel at rest. Valid: 0.000001 to 100 px.
    /// Default: `0.5` px. Raise it where the sensor vibrates.
    pub max_rest_motion_px: f64,
    /// Minimum number of salient markers for a contact. One may be noise; a sphere of 2 mm covers about ten.
    /// Valid: 1 to 100000 markers. Default: `3`. Lower it for small parts, raise it where noise passes for
    /// contact.
    pub min_salient: u32,
    /// Time without a good frame after which sensing is unhealthy. Valid: 0.001 to 3600 s. Default: `5` s.
    /// Change it to what your cell tolerates.
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
    /// Routers and peers to connect to; connections are retried until they succeed. Default:
    /// `["tcp/127.0.0.1:7447"]`, a router of `rmw_zenoh` on this computer. Change it to your router's
    /// address.
    pub connect: Vec<String>,
    /// Addresses to listen on. Addresses other than 127.0.0.1 admit other computers. Default:
    /// `["tcp/127.0.0.1:0"]`, any free port. Change it only in a network that you trust.
    pub listen: Vec<String>,
    /// Whether to look for peers on the network by multicast. Default: `false`. Set it only in a network that
    /// you trust.
    pub multicast: bool,
    /// `ROS_DOMAIN_ID` of the listeners. Valid: 0 to 232. Default: `0`. Change it to that of your ROS 2
    /// nodes.
    pub domain_id: u32,
    /// Naming of message types. Default: `rihs01`. Change it to `not_supported` for ROS 2 Humble.
    pub type_hash: TypeHash,
    /// Whether images are published too: 18 MB/s at 640 x 480 and 30 Hz. Default: `false`. Set it if images
    /// are viewed.
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
    /// Address to listen on. Addresses other than 127.0.0.1 admit other computers. Default: `127.0.0.1`.
    /// Change it only in a network that you trust.
    pub host: String,
    /// Port to listen on. With 0 the system chooses a port, which is logged. Valid: 0 to 65535. Default:
    /// `8765`. Change it if another program uses it.
    pub port: u16,
    /// Whether images are published too; they are sent only to viewers that show them. Default: `true`. Set
    /// it to false on a slow network.
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
            (1e-6..=100.0).contains(&motion_px),
            "sense.max_rest_motion_px",
            motion_px,
            "0.000001 to 100 px",
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
