//! The one configuration of the host, as TOML. [`Config::default`] is the embedded default: a simulated
//! sensor, robot and gripper, and a peg.
//!
//! Settings of the pipeline are [`Params`]; a file names a preset and states only what differs from it.

mod edge;
mod error;
mod gripper;
mod light;
mod part;
mod range;
mod recording;
pub mod reference;
mod robot;
mod sense;
mod sensor;
mod simulated;
mod source;
mod task;

pub use edge::EdgeConfig;
pub use error::ConfigError;
pub use light::{CameraHidConfig, LightConfig, StreamModeConfig};
pub use recording::{ImageFormat, RecordingConfig, RecordingMode};
pub use robot::RobotConfig;
pub use sense::{FoxgloveConfig, LocalizeWhen, SenseConfig, TypeHash, ZenohConfig};
pub use simulated::SimulatedConfig;
pub use source::SourceConfig;
pub use task::{PoseConfig, TaskConfig};

use crate::gripper::GripperConfig;
use crate::part::PartConfig;
use gelstereo_core::frames::{FingerKinematics, SensorMount};
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{Channel, ForceMethod, Params};
use gelstereo_core::rig::Rig;
use gelstereo_sim::{Gel, Scene, Shape};
use sensor::SensorFile;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// All settings of the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Preset that `params` starts from; see [`Params::preset`]. Default: `balanced`. Change it to `fast` for
    /// time, to `exact` for accuracy, to `paper` to compare with the paper.
    pub preset: String,
    /// File with the calibrated rig; not together with `rig`. A relative path starts at the configuration's
    /// folder. Default: none. Set it for real images, to what `gelstereo calibrate` wrote.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig_file: Option<PathBuf>,
    /// File with rig, preset and settings of a sensor; not together with `rig` and `rig_file`. Settings of
    /// this configuration take precedence. A relative path starts at the configuration's folder. Default:
    /// none. Set it for real images, to what `gelstereo setup` wrote.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_file: Option<PathBuf>,
    /// File with the gel's compliance matrix, in place of the elastic layer of `params.force`, whose `method`
    /// is then `ridge` or `bounded`. A relative path starts at the configuration's folder. Default: none. Set
    /// it where the gel ends close to the markers, to what `gelstereo compliance` wrote.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compliance_file: Option<PathBuf>,
    /// Source of stereo pairs. Default: the simulated sensor.
    pub source: SourceConfig,
    /// The gripper. Default: the simulated one.
    pub gripper: GripperConfig,
    /// The robot. Default: the simulated one.
    pub robot: RobotConfig,
    /// Light of the gel. Default: none.
    pub light: LightConfig,
    /// Camera settings that are sent by HID. Default: none.
    pub camera_hid: CameraHidConfig,
    /// The part to be grasped.
    pub part: PartConfig,
    /// The job: grasp the part, find it in the hand, align it, insert it. The base frame has z upwards.
    pub task: TaskConfig,
    /// Recording of the run.
    pub recording: RecordingConfig,
    /// Sensing alone, without a robot.
    pub sense: SenseConfig,
    /// The simulated world behind simulated sensors, grippers and robots.
    pub simulated: SimulatedConfig,
    /// Pose of the sensor in the gripper. Default: in the middle of a Robotiq 2F-85's pad, facing the other
    /// finger.
    pub mount: SensorMount,
    /// Settings of the pipeline and of registration.
    pub params: Params,
    /// Time in which a frame must be sensed: cheaper methods are used where the settings' own would take
    /// longer. Valid: 0.01 to 1000 ms. Default: none. Set it where a control loop waits for the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_ms: Option<f64>,
    /// The calibrated rig, inline. Default with the simulated sensor: [`Scene::default_rig`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig: Option<Rig>,
}

/// Preset of the embedded default: the paper's pipeline with its cheaper and more accurate rungs.
pub const DEFAULT_PRESET: &str = "balanced";

impl Default for Config {
    fn default() -> Self {
        let gel = Gel::default();
        let gel_centre_mm = DVec3::new(gel.centre_mm[0], gel.centre_mm[1], gel.surface_mm);
        Self {
            preset: DEFAULT_PRESET.to_owned(),
            rig_file: None,
            sensor_file: None,
            compliance_file: None,
            source: SourceConfig::default(),
            gripper: GripperConfig::default(),
            robot: RobotConfig::default(),
            light: LightConfig::default(),
            camera_hid: CameraHidConfig::default(),
            part: PartConfig::default(),
            task: TaskConfig::default(),
            recording: RecordingConfig::default(),
            sense: SenseConfig::default(),
            simulated: SimulatedConfig::default(),
            mount: SensorMount::facing(FingerKinematics::robotiq_2f85(), gel_centre_mm),
            params: Params::preset(DEFAULT_PRESET).unwrap_or_default(),
            deadline_ms: None,
            rig: None,
        }
    }
}
impl Config {
    /// Reads a file and the files that it refers to. [`Self::to_toml`] then gives a self-contained
    /// configuration, except for the part's mesh and the compliance matrix.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let read = |path: &Path| {
            std::fs::read_to_string(path).map_err(|error| ConfigError::Read { path: path.to_owned(), error })
        };
        let (text, origin) = (read(path)?, path.display().to_string());
        let mut config = Self::parse(&text, &origin)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        if let Some(file) = config.sensor_file.take() {
            let file = folder.join(file);
            let sensor = SensorFile::parse(&read(&file)?, &file.display().to_string())?;
            sensor.complete(&text, &origin, &mut config)?;
        }
        if let Some(file) = config.rig_file.take() {
            if config.rig.is_some() {
                return Err(ConfigError::RigSource {
                    message: "there are both rig and rig_file; keep one of them",
                });
            }
            let file = folder.join(file);
            let rig = from_toml("Rig", &read(&file)?, &file.display().to_string())?;
            config.rig = Some(rig);
        }
        if let Some(file) = &mut config.compliance_file {
            *file = folder.join(&*file);
        }
        match &mut config.source {
            SourceConfig::Folder { path, .. } => *path = folder.join(&*path),
            SourceConfig::Stream(stream) if !stream.is_standard_input() => {
                stream.path = folder.join(&stream.path);
            }
            _ => {}
        }
        if let Some(taught) = &mut config.task.taught {
            *taught = folder.join(&*taught);
        }
        if let Shape::Mesh { path, .. } = &mut config.part.shape {
            *path = folder.join(&*path).to_string_lossy().into_owned();
        }
        config.validate()?;
        Ok(config)
    }

    /// Reads a text; `origin` names its source in errors.
    ///
    /// # Errors
    /// [`ConfigError::Parse`] or [`ConfigError::Preset`].
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let fail = |error| ConfigError::Parse { origin: origin.to_owned(), error };
        // This pass finds errors and their lines; the next one merges the text's settings into the preset's.
        let mut config: Self = from_toml("Config", text, origin)?;
        let preset = Params::preset(&config.preset)
            .ok_or_else(|| ConfigError::Preset { found: config.preset.clone() })?;
        let mut params = toml::Table::try_from(preset).map_err(ConfigError::Write)?;
        let mut given: toml::Table = toml::from_str(text).map_err(fail)?;
        if let Some(toml::Value::Table(given)) = given.remove("params") {
            overlay(&mut params, given);
        }
        config.params = params.try_into().map_err(fail)?;
        Ok(config)
    }

    /// All settings, defaults included.
    ///
    /// # Errors
    /// [`ConfigError::Write`].
    pub fn to_toml(&self) -> Result<String, ConfigError> {
        toml::to_string(self).map_err(ConfigError::Write)
    }

    /// As [`Self::to_toml`], with a comment on every setting: its meaning, its unit, and when to change it.
    ///
    /// # Errors
    /// [`ConfigError::Write`].
    pub fn to_commented_toml(&self) -> Result<String, ConfigError> {
        self.to_toml().map(|text| reference::commented(&text))
    }

    /// The rig: the file's, or that of the simulated sensor.
    ///
    /// # Errors
    /// [`ConfigError::RigSource`] when real images come without a rig.
    pub fn rig(&self) -> Result<Rig, ConfigError> {
        match (&self.rig, &self.source) {
            (Some(rig), _) => Ok(rig.clone()),
            (None, SourceConfig::Simulated) => Ok(Scene::default_rig()),
            (None, SourceConfig::Folder { .. } | SourceConfig::Stream(_)) => Err(ConfigError::RigSource {
                message: "real images need the rig that took them: add rig_file = \"rig.toml\", made by \
                          `gelstereo calibrate`",
            }),
            (None, SourceConfig::Camera(_)) => Err(ConfigError::RigSource {
                message: "a camera needs its rig: add rig_file = \"rig.toml\", made by `gelstereo calibrate`",
            }),
        }
    }

    /// The expected pose of the part in the gripper once it is grasped.
    #[must_use]
    pub fn expected_t_gripper_object(&self) -> Pose {
        self.task.grasp_pose.pose().inverse() * self.task.part_pose.pose()
    }

    /// Unit direction of insertion in the part's frame.
    #[must_use]
    pub fn insertion_axis(&self) -> DVec3 {
        DVec3::from_array(self.task.insertion_axis).normalize_or_zero()
    }

    /// Checks the range of every setting and the consistency of settings.
    ///
    /// # Errors
    /// The first [`ConfigError`] found.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.params.validate().map_err(ConfigError::Params)?;
        check_channel(self.params.detect.channel)?;
        self.check_compliance()?;
        range::check_seed("params.register.ransac_icp.seed", self.params.register.ransac_icp.seed)?;
        self.mount.validate().map_err(ConfigError::Mount)?;
        let rig = self.rig()?;
        rig.validate().map_err(ConfigError::Rig)?;
        range::check_rig(&rig)?;
        if let Some(deadline_ms) = self.deadline_ms {
            range::DEADLINE_MS.check("deadline_ms", deadline_ms)?;
        }
        self.source.validate()?;
        self.gripper.validate()?;
        self.robot.validate()?;
        self.source.validate_against(&rig, &self.task)?;
        part::validate(&self.part)?;
        self.light.validate()?;
        self.camera_hid.validate()?;
        self.task.validate(&self.mount.kinematics)?;
        self.recording.validate()?;
        self.sense.validate(&self.mount.kinematics)?;
        if self.recording.path.file_name().is_none() {
            let (found, advice) = (self.recording.path.clone(), "name one, for example \"out/run.mcap\"");
            return Err(ConfigError::NoFile { name: "recording.path", found, advice });
        }
        self.simulated.validate()?;
        if matches!(self.source, SourceConfig::Simulated) {
            self.simulated.validate_scene(&rig, &self.part.shape)?;
            self.simulated.validate_against(&self.params)?;
        }
        Ok(())
    }

    /// Refuses a matrix that nothing uses.
    fn check_compliance(&self) -> Result<(), ConfigError> {
        match (&self.compliance_file, self.params.force.method) {
            (Some(file), method @ (ForceMethod::None | ForceMethod::Resultant)) => {
                let method = if method == ForceMethod::None { "none" } else { "resultant" };
                Err(ConfigError::Contradiction {
                    name: "compliance_file",
                    found: format!("\"{}\"", file.display()),
                    other: format!("params.force.method is \"{method}\", which does not use it"),
                    advice: "set params.force.method = \"ridge\" or \"bounded\", or remove compliance_file",
                })
            }
            _ => Ok(()),
        }
    }

    /// Checks what only a task needs; [`Self::validate`] is enough for sensing.
    ///
    /// # Errors
    /// [`ConfigError::Contradiction`] of a move that is too fast for the camera's rate.
    pub fn validate_task(&self) -> Result<(), ConfigError> {
        self.source.validate_blind_travel(&self.task)
    }
}

/// Refuses a channel that the host cannot deliver: its sources decode luma only.
fn check_channel(channel: Channel) -> Result<(), ConfigError> {
    let found = match channel {
        Channel::Auto | Channel::Grey => return Ok(()),
        Channel::Red => "\"red\"",
        Channel::Green => "\"green\"",
        Channel::Blue => "\"blue\"",
    };
    Err(ConfigError::Contradiction {
        name: "params.detect.channel",
        found: found.to_owned(),
        other: "gelstereo-host decodes grey images only".to_owned(),
        advice: "set \"auto\" or \"grey\", or use gelstereo.Pipeline in Python with colour images",
    })
}

/// Reads a text as the named type, whose keys are in the reference.
fn from_toml<T: serde::de::DeserializeOwned>(name: &str, text: &str, origin: &str) -> Result<T, ConfigError> {
    reference::check_keys(text, name)
        .map_err(|unknown| ConfigError::Unknown { origin: origin.to_owned(), unknown })?;
    toml::from_str(text).map_err(|error| ConfigError::Parse { origin: origin.to_owned(), error })
}

/// Merges `over` into `base`, table by table.
fn overlay(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(over)) => overlay(base, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}
