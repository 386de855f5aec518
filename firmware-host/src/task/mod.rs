//! The paper's task: grasp, localize, align, insert (section V-A), and then leave the hole.

mod align;
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
mod prepare;
mod retreat;
mod search;
mod second_look;
mod watch;

pub use devices::Devices;
pub use driver_thread::{Driver, DriverThread};
pub use error::TaskError;
pub use latency::{LatencyReport, StopReport};

use crate::config::Config;
use crate::recording::Recording;
use crate::report::{Forecast, JobReport, Localized, Outcome, Stage, StageReport};
use crate::sensing::Sensing;
use align::align;
use cell::Cell;
use error::Halt;
use grasp::grasp;
use localize::{Localization, localize};
use log::Log;
use prepare::{open, rest};
use search::insert_by_search;
use second_look::look_until_known;
use std::sync::atomic::AtomicBool;

/// One task.
pub struct Task<'a> {
    cell: Cell<'a>,
    localized: Option<Localized>,
}

impl<'a> Task<'a> {
    /// Ready to run. `stop` is read once per frame; `progress` gets the report of every stage that is over.
    pub fn new(
        config: &'a Config,
        devices: Devices,
        sensing: Sensing,
        recording: Option<Recording>,
        stop: &'a AtomicBool,
        progress: &'a mut dyn FnMut(&StageReport),
    ) -> Self {
        let log = Log::new(recording, progress);
        Self { cell: Cell::new(config, devices, sensing, log, stop), localized: None }
    }

    /// Runs all stages. Whatever happens, stops the devices and closes the recording.
    ///
    /// # Errors
    /// [`TaskError`]; a task that ends without success is no error but an [`Outcome`].
    pub fn run(mut self) -> Result<JobReport, TaskError> {
        let result = match self.stages() {
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
        })
    }

    fn stages(&mut self) -> Result<Outcome, Halt> {
        let cell = &mut self.cell;
        open(cell)?;
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
                let looks = localized.looks;
                self.localized = Some(*localized);
                let Forecast { chance, weakest, .. } = forecast;
                return Ok(Outcome::Declined { chance, looks, weakest });
            }
        };
        self.localized = Some(held.localized.clone());
        let above = align(cell, &held)?;
        insert_by_search(cell, &above, &held)
    }
}
