//! Log of a task: its recording, the digest of its results, and the reports of its stages.

use super::Sinks;
use crate::gripper::GripperStatus;
use crate::notes::{action_note, frame_note, slip_note};
use crate::recording::{MessageSink, Recording, RecordingReport, Topic, messages};
use crate::report::{Figure, Stage, StageReport, Trace};
use crate::robot::RobotStatus;
use crate::sensing::{Action, Sensing, SensingError};
use crate::source::{SourceEvent, StereoPair};
use gelstereo_core::digest::Digest;
use gelstereo_core::pipeline::RestRecord;
use gelstereo_core::register::Registration;
use std::time::Instant;

/// The log of one task. Times are those of the last stereo pair.
pub(super) struct Log<'a> {
    recording: Option<Recording>,
    trace: &'a mut Trace,
    progress: &'a mut dyn FnMut(&StageReport),
    digest: Digest,
    stage: Stage,
    begun: Instant,
    /// The source's time at the start of the stage; `None` before the first pair.
    begun_ns: Option<u64>,
    time_ns: u64,
    frames: u64,
    bad_frames: u64,
    stages: Vec<StageReport>,
    /// Of the present stage.
    warnings: Vec<String>,
}

impl<'a> Log<'a> {
    pub(super) fn new(sinks: Sinks<'a>) -> Self {
        let Sinks { recording, trace, progress } = sinks;
        Self {
            recording,
            trace,
            progress,
            digest: Digest::new(),
            stage: Stage::Open,
            begun: Instant::now(),
            begun_ns: None,
            time_ns: 0,
            frames: 0,
            bad_frames: 0,
            stages: Vec::new(),
            warnings: Vec::new(),
        }
    }

    pub(super) const fn stage(&self) -> Stage {
        self.stage
    }

    pub(super) fn begin(&mut self, stage: Stage) {
        (self.stage, self.frames, self.bad_frames) = (stage, 0, 0);
        self.trace.begin(stage);
        self.begun = Instant::now();
        // The source's clock is unknown before the first pair: it may count from its start or from the epoch.
        self.begun_ns = self.begun_ns.map(|_| self.time_ns);
        self.note(&serde_json::json!({ "stage": stage }));
    }

    pub(super) fn end(&mut self, figures: Vec<Figure>) {
        let report = StageReport {
            stage: self.stage,
            wall_s: self.begun.elapsed().as_secs_f64(),
            source_s: self.source_s(),
            frames: self.frames,
            bad_frames: self.bad_frames,
            figures,
            warnings: std::mem::take(&mut self.warnings),
        };
        (self.progress)(&report);
        self.trace.end(&report);
        self.stages.push(report);
    }

    /// Adds a warning to the present stage's report.
    pub(super) fn warn(&mut self, text: String) {
        self.warnings.push(text);
    }

    /// Duration of the stage on the frame source's clock.
    pub(super) fn source_s(&self) -> f64 {
        self.begun_ns.map_or(0.0, |begun_ns| self.time_ns.saturating_sub(begun_ns) as f64 * 1e-9)
    }

    /// Registers the arrival of a stereo pair.
    pub(super) fn pair_came(&mut self, time_ns: u64) {
        self.time_ns = time_ns;
        self.begun_ns.get_or_insert(time_ns);
    }

    /// Skips a stereo pair, without processing or recording it.
    pub(super) fn let_go(&mut self, pair: &StereoPair) {
        self.trace.passed(pair);
    }

    /// Records a stereo pair, the state of gripper and robot, and the result of processing the pair.
    pub(super) fn sensed(
        &mut self,
        pair: &StereoPair,
        gripper: &GripperStatus,
        robot: &RobotStatus,
        result: &Result<(), SensingError>,
        sensing: &Sensing,
    ) {
        let time_ns = pair.time_ns;
        if let Some(recording) = &mut self.recording {
            recording.write_pair(pair);
        }
        self.record(Topic::Gripper, || messages::joint_state(time_ns, gripper));
        self.record(Topic::Robot, || messages::pose(time_ns, messages::BASE_FRAME, &robot.t_base_gripper));
        let note = frame_note(result, sensing).to_string();
        self.digest = self.digest.bytes(note.as_bytes());
        self.record(Topic::Frame, || messages::string(&note));
        self.trace.sensed(pair, result, sensing.frame());
        self.frames += 1;
        match result {
            Ok(()) => {
                self.record(Topic::Points, || messages::points(time_ns, sensing.frame()));
                if let Some(wrench) = &sensing.frame().wrench {
                    self.record(Topic::Wrench, || messages::wrench(time_ns, wrench));
                }
                if let Some(slip) = &sensing.frame().slip {
                    self.record(Topic::Slip, || messages::string(&slip_note(slip).to_string()));
                }
            }
            Err(_) => self.bad_frames += 1,
        }
    }

    /// Records a pipeline action and its result.
    pub(super) fn acted(
        &mut self,
        action: &Action,
        result: &Result<Option<Registration>, SensingError>,
        sensing: &Sensing,
    ) {
        self.trace.asked(action, sensing.frame());
        let note = action_note(self.stage, action, result, sensing.tracking());
        self.digest = self.digest.bytes(note.to_string().as_bytes());
        self.note(&note);
    }

    pub(super) fn rest(&mut self, record: &RestRecord) {
        if let Some(recording) = &mut self.recording {
            recording.rest(record);
        }
    }

    pub(super) fn event(&mut self, event: &SourceEvent) {
        if let Some(recording) = &mut self.recording {
            recording.event(self.time_ns, event);
        }
    }

    pub(super) fn note(&mut self, note: &serde_json::Value) {
        self.record(Topic::Stage, || messages::string(&note.to_string()));
    }

    pub(super) fn trigger(&mut self, cause: &str) {
        self.trace.trigger(cause);
        if let Some(recording) = &mut self.recording {
            recording.trigger(self.time_ns, cause);
        }
    }

    /// Records a message with the time of the last stereo pair.
    pub(super) fn record(&mut self, topic: Topic, message: impl FnOnce() -> Vec<u8>) {
        if let Some(recording) = &mut self.recording {
            recording.write(topic, self.time_ns, &message());
        }
    }

    /// Closes the recording and the last stage.
    pub(super) fn close(&mut self) -> Option<RecordingReport> {
        self.trace.finish();
        self.recording.take().map(Recording::finish)
    }

    pub(super) fn into_parts(self) -> LogSummary {
        LogSummary { stages: self.stages, digest: format!("{:016x}", self.digest.value()) }
    }
}

/// Contents of a log that go into the report.
pub(super) struct LogSummary {
    pub(super) stages: Vec<StageReport>,
    pub(super) digest: String,
}

pub(super) const fn figure(name: &'static str, value: f64) -> Figure {
    Figure { name, value }
}
