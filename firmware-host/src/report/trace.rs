//! What a run leaves for its page: motion over time, triggers, and the last frame of each stage.

use super::{Stage, StageReport};
use crate::sensing::{Action, SensingError};
use crate::source::{Gray, StereoPair};
use gelstereo_core::math::DVec2;
use gelstereo_core::pipeline::Frame;
use gelstereo_core::track::MarkerState;

/// Beyond it the samples of a plot a thousand pixels wide lie on top of each other.
const MAX_SAMPLES: usize = 4096;
/// Pictures of 640 x 480 pixels then take at most 20 MB of memory. A task of eight stages may repeat itself eight times.
const MAX_PICTURES: usize = 64;

/// Collects what a run's page shows. Its memory is bounded, however long the run takes.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    stages: Vec<TracedStage>,
    motion: MotionCurve,
    triggers: Vec<Trigger>,
    /// Markers in the left image from which motion counts.
    reference_px: Vec<DVec2>,
    /// The next frame is the reference.
    awaits_reference: bool,
    last: Option<LastSensed>,
}

/// The last pair that was handed to the pipeline.
#[derive(Clone, Debug)]
struct LastSensed {
    time_ns: u64,
    /// Why it could not be sensed, if it could not.
    fault: Option<String>,
}

/// A stage that was begun.
#[derive(Clone, Debug)]
pub(super) struct TracedStage {
    pub(super) stage: Stage,
    /// Source's time when it began; unknown before the first pair.
    pub(super) begun_ns: Option<u64>,
    pub(super) ended_ns: Option<u64>,
    pub(super) frames: u64,
    pub(super) bad_frames: u64,
    /// Absent if the stage did not come to its end.
    pub(super) report: Option<StageReport>,
    pub(super) picture: Option<Picture>,
}

/// The last left image of a stage, and what was sensed in it.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub(super) left: Gray,
    pub(super) sensed: Sensed,
}

#[derive(Clone, Debug)]
pub(super) enum Sensed {
    /// The stage does not sense its frames.
    Nothing,
    Markers(Markers),
    /// Why the frame could not be sensed.
    Bad(String),
}

/// Markers of the left image.
#[derive(Clone, Debug)]
pub(super) struct Markers {
    pub(super) rows: usize,
    pub(super) cols: usize,
    pub(super) now_px: Vec<DVec2>,
    pub(super) reference_px: Vec<DVec2>,
    pub(super) state: Vec<MarkerState>,
    pub(super) salient: Vec<bool>,
    pub(super) motion_px: f64,
}

/// A moment at which motion crossed a trigger, or the end of the job.
#[derive(Clone, Debug)]
pub(super) struct Trigger {
    pub(super) time_ns: u64,
    pub(super) cause: String,
}

/// Mean marker motion at a moment; `None` for a frame that could not be sensed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) time_ns: u64,
    pub(super) motion_px: Option<f64>,
}

/// Samples over time. When there are too many, the largest motion of each two stays.
#[derive(Clone, Debug)]
struct MotionCurve {
    samples: Vec<Sample>,
    /// Frames that become one sample.
    stride: u64,
    pending: Option<Sample>,
    merged: u64,
}

impl Default for MotionCurve {
    fn default() -> Self {
        Self { samples: Vec::new(), stride: 1, pending: None, merged: 0 }
    }
}

impl MotionCurve {
    fn push(&mut self, sample: Sample) {
        let largest = self.pending.map_or(sample, |pending| larger(pending, sample));
        self.merged += 1;
        if self.merged < self.stride {
            self.pending = Some(largest);
            return;
        }
        (self.merged, self.pending) = (0, None);
        self.samples.push(largest);
        if self.samples.len() >= MAX_SAMPLES {
            self.samples =
                self.samples.chunks(2).filter_map(|two| two.iter().copied().reduce(larger)).collect();
            self.stride *= 2;
        }
    }
}

/// The sample with the larger motion, at its own time.
fn larger(a: Sample, b: Sample) -> Sample {
    if a.motion_px >= b.motion_px { a } else { b }
}

impl Trace {
    /// A stage begins. The last pair and the last frame are the picture of the stage before.
    pub fn begin(&mut self, stage: Stage, pair: &StereoPair, frame: &Frame) {
        self.close_stage(pair, frame);
        let begun_ns = (!pair.left.pixels.is_empty()).then_some(pair.time_ns);
        self.stages.push(TracedStage {
            stage,
            begun_ns,
            ended_ns: None,
            frames: 0,
            bad_frames: 0,
            report: None,
            picture: None,
        });
    }

    /// The pipeline did this with a frame.
    pub fn sensed(&mut self, time_ns: u64, result: &Result<(), SensingError>, frame: &Frame) {
        if result.is_ok() && std::mem::take(&mut self.awaits_reference) {
            self.reference_px.clone_from(&frame.left_px);
        }
        let motion_px = result.is_ok().then_some(frame.motion_px);
        self.motion.push(Sample { time_ns, motion_px });
        if let Some(stage) = self.stages.last_mut() {
            stage.frames += 1;
            stage.bad_frames += u64::from(result.is_err());
        }
        self.last = Some(LastSensed { time_ns, fault: result.as_ref().err().map(ToString::to_string) });
    }

    /// The pipeline was asked for this.
    pub fn asked(&mut self, action: &Action, frame: &Frame) {
        match action {
            Action::Reset => self.awaits_reference = true,
            Action::MarkReference => self.reference_px.clone_from(&frame.left_px),
            _ => {}
        }
    }

    /// A trigger acted.
    pub fn trigger(&mut self, time_ns: u64, cause: &str) {
        self.triggers.push(Trigger { time_ns, cause: cause.to_owned() });
    }

    /// The stage came to its end.
    pub fn end(&mut self, report: &StageReport) {
        if let Some(stage) = self.stages.last_mut() {
            stage.report = Some(report.clone());
        }
    }

    /// The job is over.
    pub fn finish(&mut self, pair: &StereoPair, frame: &Frame) {
        self.close_stage(pair, frame);
    }

    fn close_stage(&mut self, pair: &StereoPair, frame: &Frame) {
        let pictures = self.stages.iter().filter(|stage| stage.picture.is_some()).count();
        let picture = (!pair.left.pixels.is_empty()).then(|| self.picture(pair, frame));
        let Some(stage) = self.stages.last_mut() else { return };
        stage.ended_ns = picture.is_some().then_some(pair.time_ns);
        stage.picture = picture;
        // The first stages and the last one say most.
        if pictures >= MAX_PICTURES {
            let last = self.stages.len() - 1;
            if let Some(older) = self.stages[..last].iter_mut().rev().find(|stage| stage.picture.is_some()) {
                older.picture = None;
            }
        }
    }

    fn picture(&self, pair: &StereoPair, frame: &Frame) -> Picture {
        let last = self.last.as_ref().filter(|last| last.time_ns == pair.time_ns);
        let sensed = match last.map(|last| &last.fault) {
            None => Sensed::Nothing,
            Some(Some(fault)) => Sensed::Bad(fault.clone()),
            Some(None) => Sensed::Markers(Markers {
                rows: frame.rows,
                cols: frame.cols,
                now_px: frame.left_px.clone(),
                reference_px: self.reference_px.clone(),
                state: frame.state.clone(),
                salient: frame.salient.clone(),
                motion_px: frame.motion_px,
            }),
        };
        Picture { left: pair.left.clone(), sensed }
    }

    pub(super) fn stages(&self) -> &[TracedStage] {
        &self.stages
    }

    pub(super) fn triggers(&self) -> &[Trigger] {
        &self.triggers
    }

    /// Motion over time, in order.
    pub(super) fn motion(&self) -> impl Iterator<Item = Sample> + '_ {
        self.motion.samples.iter().copied().chain(self.motion.pending)
    }
}
