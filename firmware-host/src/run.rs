//! From a configuration to a job: devices, template, recording, and in simulation the truth.

use crate::config::{Config, ConfigError, SourceConfig};
use crate::hid::HidError;
use crate::job::{Devices, Job, JobError};
use crate::light::{LightOn, set_up_camera};
use crate::part::{Part, PartError};
use crate::recording::{Recorder, RecordingError};
use crate::report::{JobReport, Outcome, StageReport, TruthReport};
use crate::sensing::{Sensing, SensingError};
use crate::source::{CameraSource, FolderSource, FrameSource, SourceError};
use crate::world::{
    BenchTruth, PacedSource, SimulatedCamera, SimulatedGripper, SimulatedRobot, TimedSource, World,
    WorldError,
};
use gelstereo_core::math::Pose;
use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::AtomicBool;

/// Why the host did not do what it was asked.
#[derive(Debug)]
pub enum HostError {
    /// The configuration.
    Config(ConfigError),
    /// The part.
    Part(PartError),
    /// The simulated world.
    World(WorldError),
    /// The light, or the camera's settings by HID.
    Hid(HidError),
    /// The frame source.
    Source(SourceError),
    /// The pipeline cannot start.
    Sensing(SensingError),
    /// The recording.
    Recording(RecordingError),
    /// The job broke off.
    Job(JobError),
}

impl std::fmt::Display for HostError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Config(error) => error.fmt(f),
            Self::Part(error) => error.fmt(f),
            Self::World(error) => error.fmt(f),
            Self::Hid(error) => error.fmt(f),
            Self::Source(error) => error.fmt(f),
            Self::Sensing(error) => error.fmt(f),
            Self::Recording(error) => error.fmt(f),
            Self::Job(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for HostError {}

macro_rules! host_from {
    ($($error:ty => $variant:ident),*) => {
        $(impl From<$error> for HostError {
            fn from(error: $error) -> Self {
                Self::$variant(error)
            }
        })*
    };
}
host_from!(ConfigError => Config, PartError => Part, WorldError => World, HidError => Hid, SourceError => Source,
           SensingError => Sensing, RecordingError => Recording, JobError => Job);

/// A job's world and what it senses with.
pub struct Setup {
    /// What is really there, as far as it is simulated.
    pub world: Rc<RefCell<World>>,
    /// The devices.
    pub devices: Devices,
    /// Pipeline and template.
    pub sensing: Sensing,
    /// The part.
    pub part: Part,
}

impl Setup {
    /// Opens and builds everything that the configuration names, but not the recording.
    ///
    /// # Errors
    /// [`HostError`].
    pub fn new(config: &Config) -> Result<Self, HostError> {
        config.validate()?;
        let part = Part::load(&config.part.shape)?;
        let sensing = Sensing::new(&config.rig()?, &config.params, part.template(&config.part)?)?;
        let world = World::shared(config)?;
        let source: Box<dyn FrameSource> = match &config.source {
            SourceConfig::Simulated => Box::new(SimulatedCamera(Rc::clone(&world))),
            SourceConfig::Folder { path, frame_rate_hz } => Box::new(PacedSource {
                source: Box::new(FolderSource::open(path, *frame_rate_hz)?),
                world: Rc::clone(&world),
            }),
            SourceConfig::Camera(camera) => {
                let source = CameraSource::open(camera).map_err(SourceError::Camera)?;
                Box::new(TimedSource::new(Box::new(source), Rc::clone(&world)))
            }
        };
        let devices = Devices {
            source,
            gripper: Box::new(SimulatedGripper(Rc::clone(&world))),
            robot: Box::new(SimulatedRobot(Rc::clone(&world))),
        };
        Ok(Self { world, devices, sensing, part })
    }
}

/// What stands in a recording besides messages: the configuration with its rig, and the part's mesh file.
///
/// # Errors
/// [`ConfigError`].
pub fn recorded_config(config: &Config) -> Result<String, ConfigError> {
    Config { rig: Some(config.rig()?), ..config.clone() }.to_toml()
}

/// Does the job and records it to a file.
///
/// # Errors
/// [`HostError`].
pub fn run(
    config: &Config,
    recording: &Path,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&StageReport),
) -> Result<JobReport, HostError> {
    set_up_camera(&config.camera_hid)?;
    let light = LightOn::new(&config.light)?;
    let setup = Setup::new(config)?;
    let attachments: Vec<_> = setup.part.file.clone().into_iter().collect();
    let recorder = Recorder::create(recording, &recorded_config(config)?, &attachments)?;
    let mut report = run_with(config, setup, Some(recorder), stop, progress)?;
    report.recording = Some(recording.to_owned());
    light.off()?;
    Ok(report)
}

/// Does the job with what was set up.
///
/// # Errors
/// [`HostError::Job`].
pub fn run_with(
    config: &Config,
    setup: Setup,
    recorder: Option<Recorder>,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&StageReport),
) -> Result<JobReport, HostError> {
    let Setup { world, devices, sensing, .. } = setup;
    let mut report = Job::new(config, devices, sensing, recorder, stop, progress).run()?;
    let truth = world.borrow().truth().map_err(JobError::Width)?;
    report.truth = truth.map(|truth| judge(config, &report, &truth));
    Ok(report)
}

/// Holds a job's report against what really happened.
fn judge(config: &Config, report: &JobReport, truth: &BenchTruth) -> TruthReport {
    let depth_mm = config.task.insertion_depth_mm;
    let outcome_is_true = match report.outcome {
        Outcome::Inserted { .. } => truth.deepest_mm >= depth_mm,
        Outcome::Jammed { .. } => truth.deepest_mm < depth_mm && truth.fit.depth_mm > truth.fit.limit_mm,
        Outcome::NothingFelt { .. } => truth.fit.depth_mm <= truth.fit.limit_mm,
        _ => truth.deepest_mm < depth_mm,
    };
    let axis = config.insertion_axis();
    let found = report.localized.as_ref().and_then(|l| Pose::from_rows(&l.t_gripper_object).ok());
    let found = found.unwrap_or_else(|| config.expected_t_gripper_object());
    let real = truth.t_gripper_object;
    let (found_axis, real_axis) = (found.transform_vector(axis), real.transform_vector(axis));
    let across =
        |error_mm: gelstereo_core::math::DVec3| (error_mm - real_axis * error_mm.dot(real_axis)).length();
    let origin_error_mm = found.translation_mm - real.translation_mm;
    let tip = axis * truth.half_length_mm;
    TruthReport {
        lateral_error_mm: across(origin_error_mm),
        tip_error_mm: across(found.transform_point(tip) - real.transform_point(tip)),
        tilt_error_rad: gelstereo_core::math::atan2(
            found_axis.cross(real_axis).length(),
            found_axis.dot(real_axis),
        ),
        axial_error_mm: origin_error_mm.dot(real_axis),
        inserted_mm: truth.deepest_mm,
        limit_mm: truth.fit.limit_mm,
        outcome_is_true,
    }
}
