//! Runs a job from its configuration: devices, template, recording, and in simulation the ground truth.

use crate::compliance::{self, ComplianceFileError};
use crate::config::{Config, ConfigError, RobotConfig, SourceConfig, TaskConfig};
use crate::gripper::{Gripper, GripperConfig, GripperError};
use crate::hid::HidError;
use crate::light::{LightOn, set_up_camera};
use crate::part::{Part, PartError};
use crate::recording::{ATTACHMENT_COMPLIANCE, Content, LogClock, Recording, RecordingError};
use crate::report::{JobReport, Outcome, PageReport, Stage, StageReport, Trace, TruthReport};
use crate::robot::{Robot, RobotError};
use crate::sensing::{Sensing, SensingError};
use crate::source::{CameraSource, FolderSource, FrameSource, SourceError, StreamSource};
use crate::task::{Devices, DriverThread, Sinks, Task, TaskError, Teaching};
use crate::taught::{Taught, TaughtError};
use crate::world::{
    BenchTruth, PacedSource, Place, SimulatedCamera, SimulatedGripper, SimulatedRobot, TimedSource, World,
    WorldError,
};
use gelstereo_core::math::Pose;
use std::cell::RefCell;
use std::fmt::Display;
use std::rc::Rc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Reason why the host could not carry out a request.
#[derive(Debug)]
pub enum HostError {
    /// Invalid configuration.
    Config(ConfigError),
    /// The part cannot be loaded.
    Part(PartError),
    /// The gel's compliance matrix cannot be loaded.
    Compliance(ComplianceFileError),
    /// The simulated world cannot be created.
    World(WorldError),
    /// Error of the light, or of the camera's settings by HID.
    Hid(HidError),
    /// Error of the frame source.
    Source(SourceError),
    /// The pipeline cannot start.
    Sensing(SensingError),
    /// The gripper cannot be reached.
    Gripper(GripperError),
    /// The robot cannot be reached.
    Robot(RobotError),
    /// No thread could be started.
    Thread(std::io::Error),
    /// Error of the recording.
    Recording(RecordingError),
    /// Error of the taught goal.
    Taught(TaughtError),
    /// The task broke off.
    Task(TaskError),
}

impl HostError {
    /// Kind of error, as used in the JSON summary.
    #[must_use]
    pub const fn cause(&self) -> &'static str {
        match self {
            Self::Config(_) => "config",
            Self::Part(_) => "part",
            Self::Compliance(_) => "compliance",
            Self::World(_) => "world",
            Self::Hid(_) => "hid",
            Self::Source(_) => "source",
            Self::Sensing(_) => "sensing",
            Self::Gripper(_) => "gripper",
            Self::Robot(_) => "robot",
            Self::Thread(_) => "thread",
            Self::Recording(_) => "recording",
            Self::Taught(_) => "taught",
            Self::Task(error) => error.cause(),
        }
    }
}

impl std::fmt::Display for HostError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Config(error) => error.fmt(f),
            Self::Part(error) => error.fmt(f),
            Self::Compliance(error) => error.fmt(f),
            Self::World(error) => error.fmt(f),
            Self::Hid(error) => error.fmt(f),
            Self::Source(error) => error.fmt(f),
            Self::Sensing(error) => error.fmt(f),
            Self::Gripper(error) => error.fmt(f),
            Self::Robot(error) => error.fmt(f),
            Self::Thread(error) => write!(f, "no thread for a driver: {error}"),
            Self::Recording(error) => error.fmt(f),
            Self::Taught(error) => error.fmt(f),
            Self::Task(error) => error.fmt(f),
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
host_from!(ConfigError => Config, PartError => Part, ComplianceFileError => Compliance,
           WorldError => World, HidError => Hid,
           SourceError => Source, SensingError => Sensing, GripperError => Gripper, RobotError => Robot,
           RecordingError => Recording, TaskError => Task, TaughtError => Taught);

/// Everything that a job works with.
pub struct Setup {
    /// The simulated world.
    pub world: Rc<RefCell<World>>,
    /// The devices.
    pub devices: Devices,
    /// Pipeline and template.
    pub sensing: Sensing,
    /// The part.
    pub part: Part,
    /// Names and bytes of the files that a replay needs: the part's mesh and the compliance matrix.
    pub attachments: Vec<(String, Vec<u8>)>,
    /// Part pose at the goal (`t_base_object`), taught or configured.
    pub goal: Pose,
}

impl Setup {
    /// As [`Self::new`], for sensing without a robot: neither the gripper nor the robot is opened.
    ///
    /// # Errors
    /// [`HostError`].
    pub fn without_robot(config: &Config) -> Result<Self, HostError> {
        config.validate()?;
        let (gripper, robot) = (GripperConfig::Simulated, RobotConfig::Simulated);
        Self::with_part_at(&Config { gripper, robot, ..config.clone() }, Place::Holder)
    }

    /// Opens and builds everything in the configuration except the recording.
    ///
    /// # Errors
    /// [`HostError`].
    pub fn new(config: &Config) -> Result<Self, HostError> {
        config.validate_task()?;
        Self::with_part_at(config, Place::Holder)
    }

    /// As [`Self::new`], with a simulated part at its goal. A previously taught goal is ignored.
    ///
    /// # Errors
    /// [`HostError`].
    pub fn for_teaching(config: &Config) -> Result<Self, HostError> {
        config.validate_task()?;
        let task = TaskConfig { taught: None, ..config.task.clone() };
        Self::with_part_at(&Config { task, ..config.clone() }, Place::Goal)
    }

    fn with_part_at(config: &Config, place: Place) -> Result<Self, HostError> {
        config.validate()?;
        let part = Part::load(&config.part.shape)?;
        let compliance = compliance::load(config)?;
        let mut attachments: Vec<_> = part.file.clone().into_iter().collect();
        let bytes = compliance.as_ref().map(|matrix| (ATTACHMENT_COMPLIANCE.to_owned(), matrix.to_bytes()));
        attachments.extend(bytes);
        let sensing = Sensing::new(&config.rig()?, &config.params, part.template(&config.part)?)?
            .with_compliance(compliance)?
            .with_deadline(config.deadline_ms);
        let goal = goal(config, &sensing)?;
        let world = World::shared(config, place)?;
        let source: Box<dyn FrameSource> = match open_source(&config.source)? {
            None => Box::new(SimulatedCamera(Rc::clone(&world))),
            Some(source) if config.source.is_live() => Box::new(TimedSource::new(source, Rc::clone(&world))),
            Some(source) => Box::new(PacedSource { source, world: Rc::clone(&world) }),
        };
        let max_silence = Duration::from_secs_f64(config.task.device_timeout_s);
        let gripper: Box<dyn Gripper> = match config.gripper.open()? {
            Some(driver) => {
                let name = config.gripper.port().unwrap_or_default();
                Box::new(DriverThread::start(driver, name, max_silence).map_err(HostError::Thread)?)
            }
            None => Box::new(SimulatedGripper(Rc::clone(&world))),
        };
        let robot: Box<dyn Robot> = match config.robot.open()? {
            Some(driver) => {
                let name = config.robot.address().unwrap_or_default();
                Box::new(DriverThread::start(driver, name, max_silence).map_err(HostError::Thread)?)
            }
            None => Box::new(SimulatedRobot(Rc::clone(&world))),
        };
        let devices = Devices { source, gripper, robot };
        Ok(Self { world, devices, sensing, part, attachments, goal })
    }
}

/// The part's goal. A taught goal is valid only for its own rig and settings, because others have other
/// errors.
fn goal(config: &Config, sensing: &Sensing) -> Result<Pose, HostError> {
    let Some(path) = &config.task.taught else { return Ok(config.task.goal_pose.pose()) };
    let taught = Taught::load(path)?;
    let fits = sensing.clone().resume(&taught.rest);
    fits.map_err(|error| TaughtError::Settings { path: path.clone(), error })?;
    Ok(taught.goal())
}

/// Opens the source of real stereo pairs; `None` for the simulated sensor, which needs its world.
///
/// # Errors
/// [`SourceError`].
pub fn open_source(source: &SourceConfig) -> Result<Option<Box<dyn FrameSource>>, SourceError> {
    Ok(match source {
        SourceConfig::Simulated => None,
        SourceConfig::Folder { path, frame_rate_hz } => {
            Some(Box::new(FolderSource::open(path, *frame_rate_hz)?))
        }
        SourceConfig::Camera(camera) => {
            Some(Box::new(CameraSource::open(camera).map_err(SourceError::Camera)?))
        }
        SourceConfig::Stream(stream) => Some(Box::new(StreamSource::open(stream)?)),
    })
}

/// The configuration for a recording, including its rig.
///
/// # Errors
/// [`ConfigError`].
pub fn recorded_config(config: &Config) -> Result<String, ConfigError> {
    Config { rig: Some(config.rig()?), ..config.clone() }.to_toml()
}

/// Log clock for a recording of this source.
#[must_use]
pub fn log_clock(source: &SourceConfig) -> LogClock {
    // A simulated run uses no real clock, so that it can be repeated byte for byte.
    if source.is_live() { LogClock::Wall } else { LogClock::Source }
}

/// Runs the job and records it as configured.
///
/// # Errors
/// [`HostError`].
pub fn run(
    config: &Config,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&StageReport),
) -> Result<JobReport, HostError> {
    set_up_camera(&config.camera_hid)?;
    let light = LightOn::new(&config.light)?;
    let setup = Setup::new(config)?;
    let recording = begin_recording(config, &setup)?;
    let mut trace = Trace::default();
    let mut result = run_traced(config, setup, Some(recording), &mut trace, stop, progress);
    finish(config, &trace, light, result.as_mut());
    result
}

/// Switches the light off and writes the page, also for a job that broke off.
///
/// The job's result takes precedence over a light that stays on or a page that cannot be written.
fn finish(config: &Config, trace: &Trace, light: LightOn, result: Result<&mut JobReport, &mut HostError>) {
    let light_fault = light.off().err().map(|error| error.to_string());
    match result {
        Ok(report) => {
            report.light_fault = light_fault;
            report.page = config.recording.report.then(|| PageReport::write(config, trace, Ok(report)));
        }
        Err(error) if config.recording.report => {
            // The job's error takes precedence.
            let _ = PageReport::write(config, trace, Err(error as &dyn Display));
        }
        Err(_) => {}
    }
}

fn begin_recording(config: &Config, setup: &Setup) -> Result<Recording, HostError> {
    let content = Content { config_toml: recorded_config(config)?, attachments: setup.attachments.clone() };
    Ok(Recording::create(&config.recording, content, log_clock(&config.source))?)
}

/// Teaches the goal and records it as configured; see [`Task::teach`].
///
/// # Errors
/// [`HostError`].
pub fn teach(
    config: &Config,
    stay: bool,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&StageReport),
) -> Result<Teaching, HostError> {
    set_up_camera(&config.camera_hid)?;
    let light = LightOn::new(&config.light)?;
    let setup = Setup::for_teaching(config)?;
    let recording = begin_recording(config, &setup)?;
    let mut trace = Trace::default();
    let sinks = Sinks { recording: Some(recording), trace: &mut trace, progress };
    let mut result = teach_with(config, setup, sinks, stay, stop);
    finish(config, &trace, light, result.as_mut().map(|teaching| &mut teaching.report));
    result
}

/// Teaches the goal with the given setup.
///
/// # Errors
/// [`HostError::Task`].
pub fn teach_with<'a>(
    config: &'a Config,
    setup: Setup,
    sinks: Sinks<'a>,
    stay: bool,
    stop: &'a AtomicBool,
) -> Result<Teaching, HostError> {
    let Setup { devices, sensing, goal, .. } = setup;
    Ok(Task::new(config, devices, sensing, goal, sinks, stop).teach(stay)?)
}

/// Runs the job with the given setup.
///
/// # Errors
/// [`HostError::Task`].
pub fn run_with(
    config: &Config,
    setup: Setup,
    recording: Option<Recording>,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&StageReport),
) -> Result<JobReport, HostError> {
    run_traced(config, setup, recording, &mut Trace::default(), stop, progress)
}

fn run_traced(
    config: &Config,
    setup: Setup,
    recording: Option<Recording>,
    trace: &mut Trace,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&StageReport),
) -> Result<JobReport, HostError> {
    let Setup { world, devices, sensing, goal, .. } = setup;
    let sinks = Sinks { recording, trace, progress };
    let mut report = Task::new(config, devices, sensing, goal, sinks, stop).run()?;
    let truth = world.borrow().truth().map_err(TaskError::Width)?;
    report.truth = truth.map(|truth| judge(config, &report, &truth));
    Ok(report)
}

/// Compares a job's report with the ground truth.
fn judge(config: &Config, report: &JobReport, truth: &BenchTruth) -> TruthReport {
    let depth_mm = config.task.insertion_depth_mm;
    let outcome_is_true = match report.outcome {
        Outcome::Inserted { .. } => truth.deepest_mm >= depth_mm,
        Outcome::Jammed { .. } => truth.deepest_mm < depth_mm && truth.fit.depth_mm > truth.fit.limit_mm,
        Outcome::NothingFelt { .. } => truth.fit.depth_mm <= truth.fit.limit_mm,
        Outcome::Interrupted { stage: Stage::Retreat } => true,
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
        hole_offset_mm: truth.fit.lateral_mm,
        hole_tilt_rad: truth.fit.tilt_rad,
        outcome_is_true,
    }
}
