//! Continuous sensing without a robot: points, contact and pose from stereo pairs.
//!
//! One thread processes the frames in order; recording, publishing and printing wait on other threads.
//! Pipeline actions are recorded as in the robot task, so that a recording replays bit for bit.

mod contact;
mod follow;
mod histogram;
mod line;
mod outputs;
mod report;
mod rest;
mod setup;
pub mod supervisor;

pub use contact::{Contact, ContactMeter, Crossing, Trigger};
pub use follow::Follower;
pub use histogram::Histogram;
pub use line::{FrameLine, PoseLine};
pub use outputs::{Closed, Lines, Outputs};
pub use report::{Meter, PairCost, Quantiles, Report, Status, Totals};
pub use rest::{RestState, RestStep};
pub use setup::{Listeners, NamedSource, SenseError, named_source, open_outputs, recording_path};

use crate::config::Config;
use crate::notes::{action_note, frame_note, slip_note};
use crate::recording::{Recording, Topic, messages};
use crate::report::Stage;
use crate::sensing::{self, Action, Sensing};
use crate::source::{Next, SourceError, SourceEvent, StereoPair, monotonic_ns};
use gelstereo_core::pipeline::PitchCheck;
use gelstereo_core::register::{Registration, TrackingStatus};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use supervisor::Supervisor;

/// Longest wait for a pair before the flags are checked again.
const STEP: Duration = Duration::from_millis(200);
/// Interval between status reports.
const STATUS_EVERY: Duration = Duration::from_secs(1);

/// Flags set by other threads.
#[derive(Debug, Default)]
pub struct Control {
    /// Ends sensing.
    pub stop: AtomicBool,
    /// Learns a new rest state from the next good frames; nothing may touch the gel. Cleared when acted on.
    pub relearn: AtomicBool,
}

/// Inputs and outputs of sensing.
pub struct Parts<'a> {
    /// Settings.
    pub config: &'a Config,
    /// Stereo pairs.
    pub source: NamedSource,
    /// Pipeline and template.
    pub sensing: Sensing,
    /// Where results go.
    pub outputs: Outputs,
    /// Reports the state to a supervisor.
    pub supervisor: Supervisor,
    /// Ends after this many pairs; `None` for no limit.
    pub max_frames: Option<u64>,
}

/// Result of a sensing run.
#[derive(Clone, Debug, PartialEq)]
pub struct Ended {
    /// Why it ended.
    pub reason: &'static str,
    /// Status over the whole run.
    pub status: Status,
    /// How the outputs were closed.
    pub closed: Closed,
    /// Whether an output failed during the run.
    pub lost_output: bool,
}

/// Sensing loop, until it is stopped or its source ends.
pub struct Sense<'a> {
    parts: Parts<'a>,
    control: &'a Control,
    say: &'a mut dyn FnMut(&Report),
    pair: StereoPair,
    rest: RestState,
    contact: ContactMeter,
    follower: Follower,
    meter: Meter,
    touching: bool,
    /// The last frame was bad; reported once per run of bad frames.
    last_was_bad: bool,
    /// The gel was not at rest while the rest state was learned; reported once.
    is_restless: bool,
    last_good: Instant,
    begun: Instant,
    last_status: Instant,
    last_alive: Instant,
    /// Descriptions of outputs that failed.
    lost_outputs: Vec<String>,
    outputs_at_start: usize,
}

impl<'a> Sense<'a> {
    /// Prepares the loop; `say` receives all reports.
    ///
    /// # Errors
    /// [`SenseError::Width`] when the mount cannot reach the grasp width.
    pub fn new(
        parts: Parts<'a>,
        control: &'a Control,
        say: &'a mut dyn FnMut(&Report),
    ) -> Result<Self, SenseError> {
        let now = Instant::now();
        Ok(Self {
            contact: ContactMeter::new(parts.config),
            follower: Follower::new(parts.config).map_err(SenseError::Width)?,
            outputs_at_start: parts.outputs.names().len(),
            parts,
            control,
            say,
            pair: StereoPair::default(),
            rest: RestState::default(),
            meter: Meter::default(),
            touching: false,
            last_was_bad: false,
            is_restless: false,
            last_good: now,
            begun: now,
            last_status: now,
            last_alive: now,
            lost_outputs: Vec::new(),
        })
    }

    /// Runs until the source ends, a stop is requested, or no output is left. Always closes the outputs.
    ///
    /// # Errors
    /// [`SenseError::Source`] when the source fails.
    pub fn run(mut self) -> Result<Ended, SenseError> {
        let started =
            Report::Started { source: self.parts.source.name.clone(), outputs: self.parts.outputs.names() };
        (self.say)(&started);
        self.parts.supervisor.ready();
        self.reset();
        let result = self.until_end();
        self.parts.supervisor.stopping();
        let closed = self.parts.outputs.finish();
        let mut status = self.meter.whole(self.begun.elapsed());
        self.complete(&mut status);
        let reason = match &result {
            Ok(reason) => reason,
            Err(_) => "the source broke",
        };
        (self.say)(&Report::Ended { reason, status: status.clone() });
        let lost_output = !self.lost_outputs.is_empty();
        result.map(|reason| Ended { reason, status, closed, lost_output }).map_err(SenseError::Source)
    }

    fn until_end(&mut self) -> Result<&'static str, SourceError> {
        loop {
            if self.control.stop.load(Ordering::Relaxed) {
                return Ok("stopped");
            }
            if self.parts.max_frames.is_some_and(|max| self.meter.totals.frames >= max) {
                return Ok("as many frames as asked for");
            }
            if self.outputs_at_start > 0 && self.parts.outputs.names().is_empty() {
                return Ok("no output is left");
            }
            if self.control.relearn.swap(false, Ordering::Relaxed) {
                self.forget_rest("asked for");
            }
            match self.parts.source.source.next_pair(STEP, &mut self.pair) {
                Ok(Next::Pair) => self.frame(),
                Ok(Next::Event(event)) => self.event(event),
                Ok(Next::End) => return Ok("the source ended"),
                Err(SourceError::Timeout { .. }) => {}
                Err(error) => return Err(error),
            }
            self.supervise();
        }
    }

    fn event(&mut self, event: SourceEvent) {
        self.meter.totals.source_events += 1;
        self.parts.outputs.event(self.pair.time_ns, &event);
        (self.say)(&Report::Source(event));
    }

    /// Processes the pair and writes its results, or the reason for failure.
    fn frame(&mut self) {
        let begun = Instant::now();
        let (time_ns, capture) = (self.pair.time_ns, self.pair.capture);
        self.parts.outputs.pair(&self.pair);
        let sensed = self.parts.sensing.process(&self.pair).map(|_| ());
        let note = || frame_note(&sensed, &self.parts.sensing).to_string();
        self.parts.outputs.text(Topic::Frame, time_ns, note);
        let mut line = FrameLine { time_ns, capture, ..FrameLine::default() };
        match &sensed {
            Ok(()) => self.good_frame(&mut line),
            Err(error) => {
                let reason = error.to_string();
                if !std::mem::replace(&mut self.last_was_bad, true) {
                    (self.say)(&Report::BadFrame { reason: reason.clone(), time_ns });
                }
                line.error = Some(reason);
            }
        }
        self.parts.outputs.line(&line, &self.control.stop);
        let latency = capture.driver_ns.map(|ns| Duration::from_nanos(monotonic_ns().saturating_sub(ns)));
        self.meter.pair(&PairCost {
            latency,
            compute: begun.elapsed(),
            dropped: capture.dropped,
            good: sensed.is_ok(),
        });
    }

    fn good_frame(&mut self, line: &mut FrameLine) {
        let time_ns = self.pair.time_ns;
        self.last_good = Instant::now();
        self.last_was_bad = false;
        let frame = self.parts.sensing.frame();
        let with_points = self.parts.outputs.lines.as_ref().is_some_and(|lines| lines.with_points);
        line.add_frame(frame, with_points);
        self.parts.outputs.message(Topic::Points, time_ns, &messages::points(time_ns, frame));
        if let Some(wrench) = &frame.wrench {
            self.parts.outputs.message(Topic::Wrench, time_ns, &messages::wrench(time_ns, wrench));
        }
        if let Some(slip) = &frame.slip {
            self.parts.outputs.text(Topic::Slip, time_ns, || slip_note(slip).to_string());
        }
        match self.rest.step(frame, &self.parts.config.sense) {
            RestStep::Learning => return,
            RestStep::Restart => {
                if !std::mem::replace(&mut self.is_restless, true) {
                    (self.say)(&Report::RestForgotten { reason: "the gel moved or was touched" });
                }
                self.reset();
                return;
            }
            RestStep::Learned => {
                self.is_restless = false;
                let markers = frame.state.len();
                self.keep_rest();
                let pitch = self.parts.sensing.pitch_check().filter(PitchCheck::is_off);
                let trouble = pitch.map(|pitch| pitch.to_string());
                (self.say)(&Report::RestLearned { markers, trouble });
            }
            RestStep::Known => {}
        }
        self.touch(line);
        self.localize(line);
    }

    /// Evaluates contact and triggers of the last frame.
    fn touch(&mut self, line: &mut FrameLine) {
        let time_ns = self.pair.time_ns;
        let contact = self.contact.next(self.parts.sensing.frame());
        let note = || serde_json::json!(contact).to_string();
        self.parts.outputs.text(Topic::Contact, time_ns, note);
        if contact.touching != std::mem::replace(&mut self.touching, contact.touching) {
            (self.say)(&Report::Touch { touching: contact.touching, time_ns });
        }
        for &crossing in &contact.crossings {
            (self.say)(&Report::Trigger { crossing, time_ns });
            if let (true, Some(recording)) = (crossing.above, &mut self.parts.outputs.recording) {
                let cause = format!("{:?} trigger", crossing.trigger).to_lowercase();
                recording.trigger(time_ns, &cause);
            }
        }
        line.contact = Some(contact);
    }

    /// Localizes the part in the last frame where this is due.
    fn localize(&mut self, line: &mut FrameLine) {
        let time_ns = self.pair.time_ns;
        for action in self.follower.actions(self.touching, time_ns) {
            let result = self.act(&action);
            if action != Action::Follow {
                continue;
            }
            let tracking = self.parts.sensing.tracking();
            if self.follower.take(tracking, time_ns) {
                (self.say)(&Report::pose(tracking.unwrap_or(TrackingStatus::Lost), time_ns));
            }
            match (result, tracking) {
                (Ok(Some(found)), Some(tracking)) => self.pose(&found, tracking, line),
                (Ok(_), _) => {}
                (Err(error), _) => line.error = Some(error),
            }
        }
    }

    fn pose(&mut self, found: &Registration, tracking: TrackingStatus, line: &mut FrameLine) {
        let (time_ns, task) = (self.pair.time_ns, &self.parts.config.task);
        let covariance = sensing::covariance(
            &found.information,
            &found.t_sensor_object,
            task.part_sigma_mm,
            task.part_sigma_rad,
        );
        if tracking != TrackingStatus::Lost {
            let metres = sensing::in_metres(&covariance);
            let message = messages::pose_with_covariance(time_ns, &found.t_sensor_object, &metres);
            self.parts.outputs.message(Topic::Pose, time_ns, &message);
        }
        line.pose = Some(PoseLine::new(found, tracking, &covariance));
    }

    /// Runs a pipeline action, and records it with its result.
    fn act(&mut self, action: &Action) -> Result<Option<Registration>, String> {
        let result = self.parts.sensing.act(action);
        let tracking = self.parts.sensing.tracking();
        let note = || action_note(Stage::Sense, action, &result, tracking).to_string();
        self.parts.outputs.text(Topic::Stage, self.pair.time_ns, note);
        result.map_err(|error| error.to_string())
    }

    /// Makes the next good frame the rest frame.
    fn reset(&mut self) {
        // Only localizations can fail.
        let _ = self.act(&Action::Reset);
    }

    fn forget_rest(&mut self, reason: &'static str) {
        self.rest.forget();
        self.contact = ContactMeter::new(self.parts.config);
        self.follower.let_go();
        self.touching = false;
        (self.say)(&Report::RestForgotten { reason });
        self.reset();
    }

    fn keep_rest(&mut self) {
        let record = self.parts.sensing.rest_record();
        if let (Some(recording), Some(record)) = (&mut self.parts.outputs.recording, record) {
            Recording::rest(recording, &record);
        }
    }

    /// Sends watchdog signals and periodic status reports.
    fn supervise(&mut self) {
        let alive_every =
            self.parts.supervisor.alive_within().map_or(STATUS_EVERY, |within| STATUS_EVERY.min(within / 3));
        if self.last_alive.elapsed() >= alive_every {
            self.last_alive = Instant::now();
            self.parts.supervisor.alive();
        }
        let over = self.last_status.elapsed();
        if over < STATUS_EVERY {
            return;
        }
        self.last_status = Instant::now();
        for failed in self.parts.outputs.take_failed() {
            self.lost_outputs.push(failed.to_string());
            (self.say)(&failed);
        }
        let mut status = self.meter.interval(over);
        self.complete(&mut status);
        if let Err(error) = self.parts.supervisor.status(&status) {
            let reason = error.to_string();
            (self.say)(&Report::OutputLost { output: "the health file".to_owned(), reason });
        }
        (self.say)(&Report::Status(status));
    }

    fn complete(&self, status: &mut Status) {
        status.unpublished = self.parts.outputs.dropped();
        status.rest_known = self.rest.is_known();
        status.touching = self.touching;
        status.pose = self.follower.tracking().map(crate::notes::tracking_name);
        let silent_s = self.last_good.elapsed().as_secs_f64();
        let is_silent = silent_s > self.parts.config.sense.max_silence_s;
        let silence = is_silent.then(|| format!("no good frame for {silent_s:.1} s"));
        let troubles: Vec<String> = silence.into_iter().chain(self.lost_outputs.iter().cloned()).collect();
        status.trouble = (!troubles.is_empty()).then(|| troubles.join("; "));
    }
}
