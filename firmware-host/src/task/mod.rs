//! The paper's task: grasp, localize, align, insert (section V-A), then retreat from the hole.

mod align;
mod belief;
mod cell;
mod chance;
mod devices;
mod driver_thread;
mod error;
mod grasp;
mod insert;
mod latency;
mod localize;
mod log;
mod noise;
mod onset;
mod prepare;
mod regrasp;
mod retreat;
mod search;
mod second_look;
mod teach;
mod touch;
mod touch_plan;
mod touch_point;
mod watch;

pub use devices::Devices;
pub use driver_thread::{Driver, DriverThread};
pub use error::TaskError;
pub use latency::{LatencyReport, StopReport};

use crate::config::Config;
use crate::recording::Recording;
use crate::report::{JobReport, Localized, Outcome, Stage, StageReport, Trace};
use crate::sensing::Sensing;
use crate::taught::Taught;
use align::align;
use cell::Cell;
use error::Halt;
use gelstereo_core::math::Pose;
use grasp::grasp;
use localize::{Localization, localize};
use log::Log;
use prepare::{open, rest};
use search::insert_by_search;
use second_look::look_until_known;
use std::sync::atomic::AtomicBool;
use teach::teach;

/// One run of the task.
pub struct Task<'a> {
    cell: Cell<'a>,
    localized: Option<Localized>,
}

/// Outputs of a task.
pub struct Sinks<'a> {
    /// The recording, if any.
    pub recording: Option<Recording>,
    /// Data for the page of the run.
    pub trace: &'a mut Trace,
    /// Receives the report of each completed stage.
    pub progress: &'a mut dyn FnMut(&StageReport),
}

/// Result of teaching.
pub struct Teaching {
    /// Report of the run.
    pub report: JobReport,
    /// The goal, if the part was localized in it.
    pub taught: Option<Taught>,
}

impl<'a> Task<'a> {
    /// Prepares a task. `goal` is the part's pose when inserted (`t_base_object`); `stop` is read at
    /// least once per frame.
    pub fn new(
        config: &'a Config,
        devices: Devices,
        sensing: Sensing,
        goal: Pose,
        sinks: Sinks<'a>,
        stop: &'a AtomicBool,
    ) -> Self {
        let log = Log::new(sinks);
        Self { cell: Cell::new(config, devices, sensing, goal, log, stop), localized: None }
    }

    /// Runs all stages. Always stops the devices and closes the recording.
    ///
    /// # Errors
    /// [`TaskError`]; a task that ends without success is not an error but an [`Outcome`].
    pub fn run(mut self) -> Result<JobReport, TaskError> {
        let result = self.stages();
        self.finish(result)
    }

    /// Grasps the part at its goal and localizes it there. With `stay` the robot does not approach: the
    /// open fingers are already around the part.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn teach(mut self, stay: bool) -> Result<Teaching, TaskError> {
        let mut taught = None;
        let result = teach(&mut self.cell, stay).map(|lesson| match lesson {
            Ok(lesson) => {
                let position_mm = lesson.taught.goal().translation_mm.to_array();
                self.localized = Some(lesson.held.localized);
                taught = Some(lesson.taught);
                Outcome::Taught { position_mm }
            }
            Err(outcome) => outcome,
        });
        self.finish(result).map(|report| Teaching { report, taught })
    }

    fn finish(mut self, result: Result<Outcome, Halt>) -> Result<JobReport, TaskError> {
        let result = match result {
            Ok(outcome) | Err(Halt::Outcome(outcome)) => Ok(outcome),
            Err(Halt::Error(error)) => Err(error),
        };
        let stopped = self.cell.devices.stop();
        let log = &mut self.cell.log;
        log.trigger("end");
        match &result {
            Ok(outcome) => log.note(&serde_json::json!({ "stage": Stage::Done, "outcome": outcome })),
            Err(error) => log.note(&serde_json::json!({ "stage": log.stage(), "error": error.to_string() })),
        }
        let recording = log.close();
        let outcome = result?;
        stopped?;
        let latency = self.cell.latency();
        let summary = self.cell.log.into_parts();
        Ok(JobReport {
            why: outcome.to_string(),
            outcome,
            latency,
            stages: summary.stages,
            localized: self.localized,
            truth: None,
            digest: summary.digest,
            recording,
            light_fault: None,
            page: None,
        })
    }

    fn stages(&mut self) -> Result<Outcome, Halt> {
        let cell = &mut self.cell;
        open(cell, Some(&cell.config.task.grasp_pose.pose()))?;
        rest(cell)?;
        grasp(cell)?;
        let guess = cell.config.expected_t_gripper_object();
        let known = match localize(cell, &guess)? {
            Localization::Go(first) => look_until_known(cell, *first)?,
            other => other,
        };
        let held = match known {
            Localization::Go(held) => held,
            Localization::Declined { reason } => return Ok(Outcome::NotLocalized { reason }),
            Localization::TooUncertain { localized, forecast } => {
                let outcome = Outcome::declined(&localized, forecast);
                self.localized = Some(*localized);
                return Ok(outcome);
            }
        };
        self.localized = Some(held.localized.clone());
        let above = align(cell, &held)?;
        insert_by_search(cell, &above, &held)
    }
}
