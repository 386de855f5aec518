//! The one configuration of the host, as TOML. [`Config::default`] is the embedded default: a simulated sensor, robot
//! and gripper, and a peg.
//!
//! Settings of the pipeline are [`Params`]; a file names a preset and states only what differs from it.

use crate::part::PartConfig;
use gelstereo_core::frames::{FingerKinematics, SensorMount};
use gelstereo_core::math::{DVec3, Pose, so3};
use gelstereo_core::params::{Params, ParamsError};
use gelstereo_core::rig::{Rig, RigError};
use gelstereo_sim::effects::{Defocus, SensorNoise};
use gelstereo_sim::{Effects, Gel, Scene, Shape};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Everything that the host needs to know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Preset that `params` starts from; see [`Params::preset`]. Default: `balanced`.
    pub preset: String,
    /// File with the calibrated rig; not together with `rig`. A relative path starts at the configuration's folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig_file: Option<PathBuf>,
    /// Where stereo pairs come from. Default: the simulated sensor.
    pub source: SourceConfig,
    /// The part to be grasped.
    pub part: PartConfig,
    /// The job.
    pub task: TaskConfig,
    /// Where the recording goes.
    pub recording: RecordingConfig,
    /// The simulated world behind simulated sensors, grippers and robots.
    pub simulated: SimulatedConfig,
    /// Where the sensor stands in the gripper. Default: in the middle of a Robotiq 2F-85's pad, looking across.
    pub mount: SensorMount,
    /// Settings of the pipeline and of registration.
    pub params: Params,
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
            source: SourceConfig::default(),
            part: PartConfig::default(),
            task: TaskConfig::default(),
            recording: RecordingConfig::default(),
            simulated: SimulatedConfig::default(),
            mount: SensorMount::facing(FingerKinematics::robotiq_2f85(), gel_centre_mm),
            params: Params::preset(DEFAULT_PRESET).unwrap_or_default(),
            rig: None,
        }
    }
}

/// Where stereo pairs come from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum SourceConfig {
    /// The simulated sensor.
    #[default]
    Simulated,
    /// Image pairs in a folder.
    Folder {
        /// The folder.
        path: PathBuf,
        /// Rate at which they were taken.
        frame_rate_hz: f64,
    },
}

/// Farther than this no arm reaches: such a number is in another unit.
const FAR_MM: f64 = 1e4;
const FULL_TURN_RAD: f64 = 2.0 * core::f64::consts::PI;

/// A pose in a file: position and rotation vector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Origin of the inner frame in the outer one.
    pub position_mm: [f64; 3],
    /// Rotation vector: axis times angle. Default: none.
    #[serde(default)]
    pub rotation_rad: [f64; 3],
}

impl PoseConfig {
    /// As a rigid motion.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose {
            rotation: so3::exp(DVec3::from_array(self.rotation_rad)),
            translation_mm: DVec3::from_array(self.position_mm),
        }
    }

    fn validate(&self, name: &'static str) -> Result<(), ConfigError> {
        for found in self.position_mm {
            check(found.abs() <= FAR_MM, name, found, "positions up to 10000 mm")?;
        }
        for found in self.rotation_rad {
            check(
                found.abs() <= FULL_TURN_RAD,
                name,
                found,
                "rotation vectors up to a full turn, 6.2832 rad",
            )?;
        }
        Ok(())
    }
}

/// The job: grasp the part, find it in the hand, align it, insert it. The base frame has z upwards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TaskConfig {
    /// Where the part is expected before it is grasped (`t_base_object`).
    pub part_pose: PoseConfig,
    /// How far it may be from there, one standard deviation per axis. What the contact does not determine stays at
    /// the expectation with this uncertainty. Default: `0.6` mm.
    pub part_sigma_mm: f64,
    /// The same for its rotation. Default: `0.03` rad.
    pub part_sigma_rad: f64,
    /// Where the gripper closes (`t_base_gripper`).
    pub grasp_pose: PoseConfig,
    /// Where the part is when it is inserted (`t_base_object`): the template pose of the hole.
    pub goal_pose: PoseConfig,
    /// Direction of insertion in the part's frame. Default: `[0, 0, -1]`.
    pub insertion_axis: [f64; 3],
    /// Length of the way from the rim of the hole to the goal. Default: `10` mm.
    pub insertion_depth_mm: f64,
    /// The part is aligned this far above the rim. Default: `3` mm.
    pub approach_mm: f64,
    /// The robot gives up this far beyond the goal when nothing stops it. Default: `4` mm.
    pub overtravel_mm: f64,
    /// How far the part is lifted out of its holder. Default: `45` mm.
    pub lift_mm: f64,
    /// Opening before the gripper closes. Default: `14` mm.
    pub open_width_mm: f64,
    /// Default: `150` mm/s, the fastest of a Robotiq 2F-85.
    pub opening_speed_mm_s: f64,
    /// Default: `20` mm/s, the slowest of a Robotiq 2F-85.
    pub closing_speed_mm_s: f64,
    /// Share of the gripper's range, 0 to 1. Default: `0.2`.
    pub closing_force: f64,
    /// Speed of free moves. Default: `400` mm/s.
    pub move_speed_mm_s: f64,
    /// Default: `10` mm/s.
    pub insertion_speed_mm_s: f64,
    /// How long to wait for a stereo pair. Default: `2` s.
    pub frame_timeout_s: f64,
    /// The job breaks off when one stage takes longer, on the frame source's clock. Default: `120` s.
    pub stage_timeout_s: f64,
    /// So many stereo pairs in a row may show no markers (black, covered, blurred) before the job breaks off. While they
    /// last nothing is felt: at 30 Hz and 10 mm/s the part moves 0.33 mm with each. Default: `2`.
    pub max_bad_frames: u32,
}

impl Default for TaskConfig {
    fn default() -> Self {
        let at = |position_mm| PoseConfig { position_mm, rotation_rad: [0.0; 3] };
        Self {
            part_pose: at([400.0, -60.0, 20.0]),
            part_sigma_mm: 0.6,
            part_sigma_rad: 0.03,
            // Fingers down, the pads of a 2F-85 that is 8 mm open 5 mm above the middle of the peg.
            grasp_pose: PoseConfig {
                position_mm: [400.0, -60.0, 169.4],
                rotation_rad: [core::f64::consts::PI, 0.0, 0.0],
            },
            goal_pose: at([400.0, 60.0, 10.0]),
            insertion_axis: [0.0, 0.0, -1.0],
            insertion_depth_mm: 10.0,
            approach_mm: 3.0,
            overtravel_mm: 4.0,
            lift_mm: 45.0,
            open_width_mm: 14.0,
            opening_speed_mm_s: 150.0,
            closing_speed_mm_s: 20.0,
            closing_force: 0.2,
            move_speed_mm_s: 400.0,
            insertion_speed_mm_s: 10.0,
            frame_timeout_s: 2.0,
            stage_timeout_s: 120.0,
            max_bad_frames: 2,
        }
    }
}

/// Where the recording goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// MCAP file; it is replaced. Default: `out/run.mcap`.
    pub path: PathBuf,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self { path: PathBuf::from("out/run.mcap") }
    }
}

/// The simulated world: what is really there, of which the job knows only what it measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatedConfig {
    /// Seed of the part's place and of the images' noise. Default: `1`.
    pub seed: u64,
    /// Default: `30` Hz.
    pub frame_rate_hz: f64,
    /// Largest distance of the part from where it is expected, along each axis. Default: `1` mm.
    pub offset_mm: f64,
    /// Largest tilt from where it is expected, about each axis; the spin about a round part's axis is any. Default:
    /// `0.05` rad.
    pub tilt_rad: f64,
    /// Diameter of the round hole. Default: `8.2` mm, 0.2 mm more than the peg's.
    pub hole_diameter_mm: f64,
    /// What stands in the holder, if it is not the part that the job expects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape: Option<Shape>,
    /// The gel and its lattice.
    pub gel: Gel,
    /// What a real gel and camera do. Default: shoulder, spread and drag of the gel, blur and noise of the camera.
    pub effects: Effects,
}

impl Default for SimulatedConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            frame_rate_hz: 30.0,
            offset_mm: 1.0,
            tilt_rad: 0.05,
            hole_diameter_mm: 8.2,
            shape: None,
            gel: Gel::default(),
            effects: Effects {
                defocus: Some(Defocus::default()),
                sensor_noise: Some(SensorNoise::default()),
                ..Effects::of_gel()
            },
        }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug)]
pub enum ConfigError {
    /// A file cannot be read.
    Read {
        /// Which.
        path: PathBuf,
        /// The system's answer.
        error: std::io::Error,
    },
    /// The text is no such configuration.
    Parse {
        /// Where it came from.
        origin: String,
        /// What is wrong, with the line.
        error: toml::de::Error,
    },
    /// There is no such preset.
    Preset {
        /// What was found.
        found: String,
    },
    /// A setting of the pipeline makes no sense.
    Params(ParamsError),
    /// A setting of the host makes no sense.
    Value {
        /// Where it stands.
        name: &'static str,
        /// What was found.
        found: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// There is no rig, or there are two.
    RigSource {
        /// What to do.
        message: &'static str,
    },
    /// The rig makes no sense.
    Rig(RigError),
    /// The configuration cannot be written as TOML.
    Write(toml::ser::Error),
}

impl std::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => write!(f, "cannot read {}: {error}", path.display()),
            Self::Parse { origin, error } => write!(f, "{origin}: {}", error.to_string().trim_end()),
            Self::Preset { found } => {
                write!(f, "preset is \"{found}\"; valid is one of {:?}", Params::PRESETS)
            }
            Self::Params(error) => write!(f, "params.{error}"),
            Self::Value { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::RigSource { message } => f.write_str(message),
            Self::Rig(error) => write!(f, "rig: {error}"),
            Self::Write(error) => write!(f, "the configuration cannot be written as TOML: {error}"),
        }
    }
}

impl std::error::Error for ConfigError {}

impl Config {
    /// Reads a file and resolves what it refers to, so that [`Self::to_toml`] gives a configuration that stands alone
    /// but for the part's mesh.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let read = |path: &Path| {
            std::fs::read_to_string(path).map_err(|error| ConfigError::Read { path: path.to_owned(), error })
        };
        let mut config = Self::parse(&read(path)?, &path.display().to_string())?;
        let folder = path.parent().unwrap_or(Path::new(""));
        if let Some(file) = config.rig_file.take() {
            if config.rig.is_some() {
                return Err(ConfigError::RigSource {
                    message: "there are both rig and rig_file; keep one of them",
                });
            }
            let file = folder.join(file);
            let rig = toml::from_str(&read(&file)?)
                .map_err(|error| ConfigError::Parse { origin: file.display().to_string(), error })?;
            config.rig = Some(rig);
        }
        if let SourceConfig::Folder { path, .. } = &mut config.source {
            *path = folder.join(&*path);
        }
        if let Shape::Mesh { path, .. } = &mut config.part.shape {
            *path = folder.join(&*path).to_string_lossy().into_owned();
        }
        config.validate()?;
        Ok(config)
    }

    /// Reads a text; `origin` says in errors where it came from.
    ///
    /// # Errors
    /// [`ConfigError::Parse`] or [`ConfigError::Preset`].
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let fail = |error| ConfigError::Parse { origin: origin.to_owned(), error };
        // This pass finds errors and their lines; the next one lays the text's settings over the preset's.
        let mut config: Self = toml::from_str(text).map_err(fail)?;
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

    /// The rig: the file's, or that of the simulated sensor.
    ///
    /// # Errors
    /// [`ConfigError::RigSource`] when real images come without a rig.
    pub fn rig(&self) -> Result<Rig, ConfigError> {
        match (&self.rig, &self.source) {
            (Some(rig), _) => Ok(rig.clone()),
            (None, SourceConfig::Simulated) => Ok(Scene::default_rig()),
            (None, SourceConfig::Folder { .. }) => Err(ConfigError::RigSource {
                message: "images from a folder need the rig that took them: add rig_file = \"rig.toml\", made by \
                          `gelstereo calibrate`",
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

    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ConfigError`] found.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.params.validate().map_err(ConfigError::Params)?;
        self.rig()?.validate().map_err(ConfigError::Rig)?;
        if let SourceConfig::Folder { frame_rate_hz, .. } = self.source {
            RATE_HZ.check("source.frame_rate_hz", frame_rate_hz)?;
        }
        LENGTH_MM.check("part.spacing_mm", self.part.spacing_mm)?;
        self.validate_task()?;
        let s = &self.simulated;
        RATE_HZ.check("simulated.frame_rate_hz", s.frame_rate_hz)?;
        LENGTH_MM.check("simulated.hole_diameter_mm", s.hole_diameter_mm)?;
        check(s.offset_mm >= 0.0 && s.offset_mm <= 10.0, "simulated.offset_mm", s.offset_mm, "0 to 10 mm")?;
        check(s.tilt_rad >= 0.0 && s.tilt_rad <= 0.5, "simulated.tilt_rad", s.tilt_rad, "0 to 0.5 rad")
    }

    fn validate_task(&self) -> Result<(), ConfigError> {
        let t = &self.task;
        let poses = [
            ("task.part_pose", t.part_pose),
            ("task.grasp_pose", t.grasp_pose),
            ("task.goal_pose", t.goal_pose),
        ];
        for (name, pose) in poses {
            pose.validate(name)?;
        }
        let within = [
            ("task.part_sigma_mm", t.part_sigma_mm, LENGTH_MM),
            ("task.part_sigma_rad", t.part_sigma_rad, ANGLE_RAD),
            ("task.insertion_depth_mm", t.insertion_depth_mm, LENGTH_MM),
            ("task.approach_mm", t.approach_mm, LENGTH_MM),
            ("task.overtravel_mm", t.overtravel_mm, LENGTH_MM),
            ("task.lift_mm", t.lift_mm, LENGTH_MM),
            ("task.opening_speed_mm_s", t.opening_speed_mm_s, SPEED_MM_S),
            ("task.closing_speed_mm_s", t.closing_speed_mm_s, SPEED_MM_S),
            ("task.move_speed_mm_s", t.move_speed_mm_s, SPEED_MM_S),
            ("task.insertion_speed_mm_s", t.insertion_speed_mm_s, SPEED_MM_S),
            ("task.frame_timeout_s", t.frame_timeout_s, TIME_S),
            ("task.stage_timeout_s", t.stage_timeout_s, TIME_S),
        ];
        for (name, found, range) in within {
            range.check(name, found)?;
        }
        check((0.0..=1.0).contains(&t.closing_force), "task.closing_force", t.closing_force, "0 to 1")?;
        let length = DVec3::from_array(t.insertion_axis).length();
        check(length > 1e-6 && length.is_finite(), "task.insertion_axis", length, "a direction, not zero")?;
        let (min_mm, max_mm) = self.mount.kinematics.width_range_mm();
        let opens = t.open_width_mm > min_mm && t.open_width_mm <= max_mm;
        check(opens, "task.open_width_mm", t.open_width_mm, "a width that mount.kinematics can have")
    }
}

fn check(ok: bool, name: &'static str, found: f64, valid: &'static str) -> Result<(), ConfigError> {
    if ok { Ok(()) } else { Err(ConfigError::Value { name, found, valid }) }
}

/// What a kind of setting may be; a number outside is in another unit, or would keep the job waiting for ever.
#[derive(Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
    words: &'static str,
}

impl Range {
    fn check(self, name: &'static str, found: f64) -> Result<(), ConfigError> {
        check(found >= self.low && found <= self.high, name, found, self.words)
    }
}

const LENGTH_MM: Range = Range { low: 1e-6, high: FAR_MM, words: "0.000001 to 10000 mm" };
const ANGLE_RAD: Range = Range { low: 1e-6, high: FULL_TURN_RAD, words: "0.000001 to 6.2832 rad" };
const SPEED_MM_S: Range = Range { low: 0.01, high: 1e4, words: "0.01 to 10000 mm/s" };
const TIME_S: Range = Range { low: 1e-3, high: 3600.0, words: "0.001 to 3600 s" };
const RATE_HZ: Range = Range { low: 0.1, high: 1e4, words: "0.1 to 10000 Hz" };

/// Lays `over` over `base`, table by table.
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
