//! The paper's job: grasp, localize, align, insert (section V-A).

use crate::config::Config;
use crate::gripper::{Gripper, GripperError};
use crate::notes::{action_note, frame_note};
use crate::recording::{MessageSink, Recording, Topic, messages};
use crate::report::{Figure, JobReport, Localized, Outcome, Stage, StageReport, Trace};
use crate::robot::{Robot, RobotError};
use crate::sensing::{self, Action, Sensing, SensingError};
use crate::source::{FrameSource, Next, SourceError, StereoPair};
use gelstereo_core::digest::Digest;
use gelstereo_core::frames::{WidthError, adjusted_gripper};
use gelstereo_core::math::{DVec3, Pose, sqrt};
use gelstereo_core::register::Registration;
use gelstereo_core::track::MarkerState;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Why a job broke off. The gripper and the robot were told to stop, and the recording was closed.
#[derive(Debug)]
pub enum JobError {
    /// No stereo pair.
    Source(SourceError),
    /// The gripper.
    Gripper(GripperError),
    /// The robot.
    Robot(RobotError),
    /// The gripper stands where the mount says that it cannot.
    Width(WidthError),
    /// Frames could not be sensed, or a request of the pipeline was refused.
    Sensing {
        /// During this stage.
        stage: Stage,
        /// Frames that failed in a row; 0 for a request.
        bad_frames: u32,
        /// Why, at last.
        error: SensingError,
    },
    /// A stage did not end.
    StageTimeout {
        /// Which.
        stage: Stage,
        /// `task.stage_timeout_s`.
        limit_s: f64,
    },
}

impl std::fmt::Display for JobError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Source(error) => error.fmt(f),
            Self::Gripper(error) => error.fmt(f),
            Self::Robot(error) => error.fmt(f),
            Self::Width(error) => error.fmt(f),
            Self::Sensing { stage, bad_frames: 0, error } => write!(f, "{}: {error}", stage.name()),
            Self::Sensing { stage, bad_frames, error } => {
                write!(f, "{}: {bad_frames} bad frames in a row, at last: {error}", stage.name())
            }
            Self::StageTimeout { stage, limit_s } => write!(
                f,
                "{} did not end within {limit_s} s (task.stage_timeout_s); do gripper and robot move?",
                stage.name()
            ),
        }
    }
}

impl std::error::Error for JobError {}

/// Why the stages did not go on.
enum Halt {
    Outcome(Outcome),
    Error(JobError),
}

macro_rules! halt_from {
    ($($error:ty => $variant:ident),*) => {
        $(impl From<$error> for Halt {
            fn from(error: $error) -> Self {
                Self::Error(JobError::$variant(error))
            }
        })*
    };
}
halt_from!(SourceError => Source, GripperError => Gripper, RobotError => Robot, WidthError => Width);

/// What the job works with.
pub struct Devices {
    /// Stereo pairs.
    pub source: Box<dyn FrameSource>,
    /// The gripper.
    pub gripper: Box<dyn Gripper>,
    /// The robot.
    pub robot: Box<dyn Robot>,
}

/// One job.
pub struct Job<'a> {
    config: &'a Config,
    devices: Devices,
    sensing: Sensing,
    recording: Option<Recording>,
    trace: &'a mut Trace,
    stop: &'a AtomicBool,
    progress: &'a mut dyn FnMut(&StageReport),
    pair: StereoPair,
    stage: Stage,
    begun: Instant,
    /// The source's time at the beginning; unknown before the job's first pair.
    begun_ns: Option<u64>,
    frames: u64,
    bad_frames: u64,
    stages: Vec<StageReport>,
    localized: Option<Localized>,
    digest: Digest,
}

impl<'a> Job<'a> {
    /// Ready to run; `stop` is looked at once per frame, `progress` hears of every stage that is over, `trace`
    /// collects what the run's page shows.
    pub fn new(
        config: &'a Config,
        devices: Devices,
        sensing: Sensing,
        recording: Option<Recording>,
        trace: &'a mut Trace,
        stop: &'a AtomicBool,
        progress: &'a mut dyn FnMut(&StageReport),
    ) -> Self {
        Self {
            config,
            devices,
            sensing,
            recording,
            trace,
            stop,
            progress,
            pair: StereoPair::default(),
            stage: Stage::Open,
            begun: Instant::now(),
            begun_ns: None,
            frames: 0,
            bad_frames: 0,
            stages: Vec::new(),
            localized: None,
            digest: Digest::new(),
        }
    }

    /// Runs all stages, whatever happens stops the devices and closes the recording.
    ///
    /// # Errors
    /// [`JobError`]; a job that ends without success is no error but an [`Outcome`].
    pub fn run(mut self) -> Result<JobReport, JobError> {
        let result = match self.stages() {
            Ok(outcome) | Err(Halt::Outcome(outcome)) => Ok(outcome),
            Err(Halt::Error(error)) => Err(error),
        };
        let stopped = (self.devices.gripper.stop(), self.devices.robot.stop());
        self.trigger("end");
        self.trace.finish(&self.pair, self.sensing.frame());
        match &result {
            Ok(outcome) => self.note(&serde_json::json!({ "stage": Stage::Done, "outcome": outcome })),
            Err(error) => self.note(&serde_json::json!({ "stage": self.stage, "error": error.to_string() })),
        }
        let recording = self.recording.take().map(Recording::finish);
        let outcome = result?;
        stopped.0.map_err(JobError::Gripper)?;
        stopped.1.map_err(JobError::Robot)?;
        Ok(JobReport {
            outcome,
            stages: self.stages,
            localized: self.localized,
            truth: None,
            digest: format!("{:016x}", self.digest.value()),
            recording,
            light_fault: None,
            page: None,
        })
    }

    fn stages(&mut self) -> Result<Outcome, Halt> {
        self.open()?;
        self.rest()?;
        self.close()?;
        let t_gripper_object = self.localize()?;
        let t_base_gripper = self.align(&t_gripper_object)?;
        self.insert(&t_base_gripper, &t_gripper_object)
    }

    fn open(&mut self) -> Result<(), Halt> {
        self.begin(Stage::Open)?;
        let task = &self.config.task;
        self.devices.gripper.activate()?;
        self.devices.gripper.move_to(task.open_width_mm, task.opening_speed_mm_s, task.closing_force)?;
        self.devices.robot.move_to(&task.grasp_pose.pose(), task.move_speed_mm_s)?;
        // Frames on the way show neither rest nor contact: they are let go.
        while self.devices.gripper.status()?.moving || self.devices.robot.status()?.moving {
            self.take_pair()?;
        }
        let width_mm = self.devices.gripper.status()?.width_mm;
        self.end(vec![figure("width_mm", width_mm)]);
        Ok(())
    }

    fn rest(&mut self) -> Result<(), Halt> {
        self.begin(Stage::Rest)?;
        self.act(&Action::Reset)?;
        self.frame()?;
        if let (Some(recording), Some(record)) = (&mut self.recording, self.sensing.rest_record()) {
            recording.rest(&record);
        }
        let frame = self.sensing.frame();
        let seen = frame.state.iter().filter(|&&state| state == MarkerState::Seen).count();
        self.end(vec![figure("markers", frame.state.len() as f64), figure("seen", seen as f64)]);
        Ok(())
    }

    fn close(&mut self) -> Result<(), Halt> {
        self.begin(Stage::Close)?;
        let (task, trigger_px) = (&self.config.task, self.config.params.contact.grasp_trigger_px);
        let (min_mm, _) = self.config.mount.kinematics.width_range_mm();
        self.devices.gripper.move_to(min_mm, task.closing_speed_mm_s, task.closing_force)?;
        let motion_px = loop {
            let motion_px = self.frame()?;
            if motion_px >= trigger_px {
                break motion_px;
            }
            let status = self.devices.gripper.status()?;
            if !status.moving {
                return Err(Halt::Outcome(Outcome::NotGrasped { motion_px, width_mm: status.width_mm }));
            }
        };
        self.devices.gripper.stop()?;
        self.trigger("grasp");
        while self.devices.gripper.status()?.moving {
            self.frame()?;
        }
        let frame = self.sensing.frame();
        let salient = frame.salient.iter().filter(|&&salient| salient).count();
        let pressed_mm = frame.indentation_mm.iter().copied().fold(0.0, f64::max);
        let width_mm = self.devices.gripper.status()?.width_mm;
        self.end(vec![
            figure("motion_px", motion_px),
            figure("width_mm", width_mm),
            figure("salient", salient as f64),
            figure("pressed_mm", pressed_mm),
        ]);
        Ok(())
    }

    fn localize(&mut self) -> Result<Pose, Halt> {
        self.begin(Stage::Localize)?;
        let width_mm = self.devices.gripper.status()?.width_mm;
        let t_gripper_sensor = self.config.mount.t_gripper_sensor(width_mm)?;
        let guess = t_gripper_sensor.inverse() * self.config.expected_t_gripper_object();
        let found = match self.act(&Action::localize(&guess)) {
            Ok(Some(found)) if found.converged => found,
            Ok(Some(found)) => {
                let reason = format!("registration did not come to rest in {} iterations", found.iterations);
                return Err(Halt::Outcome(Outcome::NotLocalized { reason }));
            }
            Ok(None) => {
                let reason = "registration gave nothing".to_owned();
                return Err(Halt::Outcome(Outcome::NotLocalized { reason }));
            }
            Err(Halt::Error(JobError::Sensing { error, .. })) => {
                return Err(Halt::Outcome(Outcome::NotLocalized { reason: error.to_string() }));
            }
            Err(halt) => return Err(halt),
        };
        let t_gripper_object = t_gripper_sensor * found.t_sensor_object;
        let localized = self.evidence(&found, &t_gripper_object)?;
        self.end(vec![
            figure("points", found.points as f64),
            figure("inliers", found.inliers as f64),
            figure("iterations", f64::from(found.iterations)),
            figure("rmse_mm", found.rmse_mm),
            figure("axial_sigma_mm", localized.axial_sigma_mm),
            figure("free", found.free.len() as f64),
        ]);
        self.localized = Some(localized);
        Ok(t_gripper_object)
    }

    /// Puts a registration's evidence together, and records the pose with its covariance.
    fn evidence(&mut self, found: &Registration, t_gripper_object: &Pose) -> Result<Localized, Halt> {
        let task = &self.config.task;
        let covariance = sensing::covariance(
            &found.information,
            &found.t_sensor_object,
            task.part_sigma_mm,
            task.part_sigma_rad,
        );
        let axis = found.t_sensor_object.transform_vector(self.config.insertion_axis());
        let axial: f64 = (0..3)
            .flat_map(|i| (0..3).map(move |j| (i, j)))
            .map(|(i, j)| axis[i] * covariance[i][j] * axis[j])
            .sum();
        let metres = sensing::in_metres(&covariance);
        let time_ns = self.pair.time_ns;
        self.record(Topic::Pose, time_ns, || {
            messages::pose_with_covariance(time_ns, &found.t_sensor_object, &metres)
        });
        Ok(Localized {
            t_sensor_object: found.t_sensor_object.to_rows(),
            t_gripper_object: t_gripper_object.to_rows(),
            converged: found.converged,
            iterations: found.iterations,
            inliers: found.inliers,
            points: found.points,
            rmse_mm: found.rmse_mm,
            sigma: core::array::from_fn(|i| sqrt(covariance[i][i])),
            axial_sigma_mm: sqrt(axial),
            free: found.free.iter().map(ToString::to_string).collect(),
        })
    }

    /// Lifts the part and brings it above the hole; returns the gripper's pose there.
    fn align(&mut self, t_gripper_object: &Pose) -> Result<Pose, Halt> {
        self.begin(Stage::Align)?;
        let task = &self.config.task;
        let lift = Pose::from_translation_mm(DVec3::Z * task.lift_mm);
        let from = self.devices.robot.status()?.t_base_gripper;
        self.go(&(lift * from), task.move_speed_mm_s)?;
        let goal = task.goal_pose.pose();
        let back_mm = task.insertion_depth_mm + task.approach_mm;
        let above = goal * Pose::from_translation_mm(-self.config.insertion_axis() * back_mm);
        let t_base_gripper = adjusted_gripper(&above, t_gripper_object);
        self.go(&t_base_gripper, task.move_speed_mm_s)?;
        // The paper's adjustment: between what is in the hand and what was expected there.
        let expected = adjusted_gripper(&above, &self.config.expected_t_gripper_object());
        let (turn, shift_mm) = (expected.inverse() * t_base_gripper).log();
        self.end(vec![figure("turn_rad", turn.length()), figure("shift_mm", shift_mm.length())]);
        Ok(t_base_gripper)
    }

    fn insert(&mut self, above: &Pose, t_gripper_object: &Pose) -> Result<Outcome, Halt> {
        self.begin(Stage::Insert)?;
        self.act(&Action::MarkReference)?;
        let (task, trigger_px) = (&self.config.task, self.config.params.contact.insertion_trigger_px);
        let inwards = (*above * *t_gripper_object).transform_vector(self.config.insertion_axis());
        let way_mm = task.approach_mm + task.insertion_depth_mm + task.overtravel_mm;
        let last = Pose::from_translation_mm(inwards * way_mm) * *above;
        self.devices.robot.move_to(&last, task.insertion_speed_mm_s)?;
        let (motion_px, triggered) = loop {
            let motion_px = self.frame()?;
            if motion_px >= trigger_px {
                self.devices.robot.stop()?;
                self.trigger("insertion");
                break (motion_px, true);
            }
            if !self.devices.robot.status()?.moving {
                break (motion_px, false);
            }
        };
        let now = self.devices.robot.status()?.t_base_gripper;
        let depth_mm = (now.translation_mm - above.translation_mm).dot(inwards) - task.approach_mm;
        // The robot cannot know the depth better than the part's place along the axis: three sigma.
        let axial_sigma_mm = self.localized.as_ref().map_or(task.part_sigma_mm, |l| l.axial_sigma_mm);
        let within_mm = 3.0 * axial_sigma_mm;
        let enough = depth_mm >= task.insertion_depth_mm - within_mm;
        self.end(vec![figure("motion_px", motion_px), figure("depth_mm", depth_mm)]);
        Ok(match (triggered, enough) {
            (true, true) => Outcome::Inserted { depth_mm, within_mm },
            (true, false) => Outcome::Jammed { depth_mm, within_mm },
            (false, _) => Outcome::NothingFelt { depth_mm },
        })
    }

    /// Moves the robot, sensing on the way.
    fn go(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), Halt> {
        self.devices.robot.move_to(t_base_gripper, speed_mm_s)?;
        while self.devices.robot.status()?.moving {
            self.frame()?;
        }
        Ok(())
    }

    fn take_pair(&mut self) -> Result<(), Halt> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Halt::Outcome(Outcome::Interrupted { stage: self.stage }));
        }
        let timeout = Duration::from_secs_f64(self.config.task.frame_timeout_s);
        let asked = Instant::now();
        loop {
            let left = timeout.saturating_sub(asked.elapsed());
            match self.devices.source.next_pair(left, &mut self.pair)? {
                Next::Pair => break,
                Next::Event(event) => {
                    if let Some(recording) = &mut self.recording {
                        recording.event(self.pair.time_ns, &event);
                    }
                }
                Next::End => return Err(Halt::Outcome(Outcome::SourceEnded { stage: self.stage })),
            }
            if asked.elapsed() >= timeout {
                return Err(SourceError::Timeout { waited: timeout }.into());
            }
        }
        self.begun_ns.get_or_insert(self.pair.time_ns);
        let limit_s = self.config.task.stage_timeout_s;
        if self.source_s() > limit_s {
            return Err(Halt::Error(JobError::StageTimeout { stage: self.stage, limit_s }));
        }
        Ok(())
    }

    /// How long the stage has taken on the frame source's clock.
    fn source_s(&self) -> f64 {
        self.begun_ns.map_or(0.0, |begun_ns| self.pair.time_ns.saturating_sub(begun_ns) as f64 * 1e-9)
    }

    /// Goes on to the next frame that can be sensed; returns its mean marker motion in pixels.
    fn frame(&mut self) -> Result<f64, Halt> {
        let mut bad_frames = 0;
        loop {
            self.take_pair()?;
            self.frames += 1;
            let Err(error) = self.sense()? else {
                return Ok(self.sensing.frame().motion_px);
            };
            bad_frames += 1;
            self.bad_frames += 1;
            if bad_frames > self.config.task.max_bad_frames {
                return Err(Halt::Error(JobError::Sensing { stage: self.stage, bad_frames, error }));
            }
        }
    }

    /// Senses the pair and records it with what came of it, or why nothing did.
    fn sense(&mut self) -> Result<Result<(), SensingError>, Halt> {
        let time_ns = self.pair.time_ns;
        if let Some(recording) = &mut self.recording {
            recording.write_pair(&self.pair);
        }
        let gripper = self.devices.gripper.status()?;
        self.record(Topic::Gripper, time_ns, || messages::joint_state(time_ns, &gripper));
        let robot = self.devices.robot.status()?.t_base_gripper;
        self.record(Topic::Robot, time_ns, || messages::pose(time_ns, messages::BASE_FRAME, &robot));
        let sensed = self.sensing.process(&self.pair).map(|_| ());
        self.trace.sensed(time_ns, &sensed, self.sensing.frame());
        let note = frame_note(&sensed, &self.sensing).to_string();
        self.digest = self.digest.bytes(note.as_bytes());
        self.record(Topic::Frame, time_ns, || messages::string(&note));
        if let (Some(recording), Ok(())) = (&mut self.recording, &sensed) {
            let points = messages::points(time_ns, self.sensing.frame());
            recording.write(Topic::Points, time_ns, &points);
        }
        Ok(sensed)
    }

    /// Asks something of the pipeline, and records that it was asked and what came of it.
    fn act(&mut self, action: &Action) -> Result<Option<Registration>, Halt> {
        let result = self.sensing.act(action);
        self.trace.asked(action, self.sensing.frame());
        let note = action_note(self.stage, action, &result, self.sensing.standing());
        self.digest = self.digest.bytes(note.to_string().as_bytes());
        self.note(&note);
        result.map_err(|error| Halt::Error(JobError::Sensing { stage: self.stage, bad_frames: 0, error }))
    }

    fn begin(&mut self, stage: Stage) -> Result<(), Halt> {
        (self.stage, self.frames, self.bad_frames) = (stage, 0, 0);
        self.trace.begin(stage, &self.pair, self.sensing.frame());
        self.begun = Instant::now();
        // Before the first pair the source's clock is unknown: it may count from its start or from the epoch.
        self.begun_ns = self.begun_ns.map(|_| self.pair.time_ns);
        self.note(&serde_json::json!({ "stage": stage }));
        Ok(())
    }

    fn end(&mut self, figures: Vec<Figure>) {
        let report = StageReport {
            stage: self.stage,
            wall_s: self.begun.elapsed().as_secs_f64(),
            source_s: self.source_s(),
            frames: self.frames,
            bad_frames: self.bad_frames,
            figures,
        };
        (self.progress)(&report);
        self.trace.end(&report);
        self.stages.push(report);
    }

    fn note(&mut self, note: &serde_json::Value) {
        let time_ns = self.pair.time_ns;
        self.record(Topic::Stage, time_ns, || messages::string(&note.to_string()));
    }

    fn trigger(&mut self, cause: &str) {
        self.trace.trigger(self.pair.time_ns, cause);
        if let Some(recording) = &mut self.recording {
            recording.trigger(self.pair.time_ns, cause);
        }
    }

    fn record(&mut self, topic: Topic, time_ns: u64, message: impl FnOnce() -> Vec<u8>) {
        if let Some(recording) = &mut self.recording {
            recording.write(topic, time_ns, &message());
        }
    }
}

fn figure(name: &'static str, value: f64) -> Figure {
    Figure { name, value }
}
