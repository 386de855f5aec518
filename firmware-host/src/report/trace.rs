//! Data of a run for its page: motion over time, triggers, and the last frame of each stage.

use super::{Stage, StageReport};
use crate::sensing::{Action, SensingError};
use crate::source::{Gray, StereoPair};
use gelstereo_core::math::DVec2;
use gelstereo_core::pipeline::Frame;
use gelstereo_core::track::MarkerState;

/// Largest number of samples; more would overlap in a plot a thousand pixels wide.
const MAX_SAMPLES: usize = 4096;
/// Largest number of pictures: at most 20 MB for 640 x 480 pixels. Allows eight stages eight times.
const MAX_PICTURES: usize = 64;

/// Collects the data of a run's page in bounded memory.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    stages: Vec<TracedStage>,
    motion: MotionCurve,
    triggers: Vec<Trigger>,
    /// Markers in the left image at the reference frame of motion.
    reference_px: Vec<DVec2>,
    /// Whether the next frame becomes the reference.
    awaits_reference: bool,
    /// The last image; its buffer is reused.
    last: Picture,
    time_ns: u64,
}

/// A stage that was started.
#[derive(Clone, Debug)]
pub(super) struct TracedStage {
    pub(super) stage: Stage,
    /// Source time at its start; unknown before the first pair.
    pub(super) begun_ns: Option<u64>,
    pub(super) ended_ns: Option<u64>,
    pub(super) frames: u64,
    pub(super) bad_frames: u64,
    /// `None` if the stage did not complete.
    pub(super) report: Option<StageReport>,
    pub(super) picture: Option<Picture>,
}

/// The last left image of a stage, and its result.
#[derive(Clone, Debug, Default)]
pub(super) struct Picture {
    pub(super) left: Gray,
    pub(super) sensed: Sensed,
}

#[derive(Clone, Debug, Default)]
pub(super) enum Sensed {
    /// The stage does not process its frames.
    #[default]
    Nothing,
    Markers(Markers),
    /// Why the frame could not be processed.
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

/// Time at which motion crossed a trigger, or the end of the job.
#[derive(Clone, Debug)]
pub(super) struct Trigger {
    pub(super) time_ns: u64,
    pub(super) cause: String,
}

/// Mean marker motion at one time; `None` for a frame that could not be processed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) time_ns: u64,
    pub(super) motion_px: Option<f64>,
}

/// Samples over time. If there are too many, each two are merged and the larger motion is kept.
#[derive(Clone, Debug)]
struct MotionCurve {
    samples: Vec<Sample>,
    /// Number of frames per sample.
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
    /// Starts a stage. The last image becomes the picture of the previous stage.
    pub fn begin(&mut self, stage: Stage) {
        self.finish();
        self.stages.push(TracedStage {
            stage,
            begun_ns: self.last_time_ns(),
            ended_ns: None,
            frames: 0,
            bad_frames: 0,
            report: None,
            picture: None,
        });
    }

    /// Takes a pair that is not processed.
    pub fn passed(&mut self, pair: &StereoPair) {
        self.keep(pair);
        self.last.sensed = Sensed::Nothing;
    }

    /// Takes the pipeline's result for a pair; `frame` is its last good frame.
    pub fn sensed(&mut self, pair: &StereoPair, result: &Result<(), SensingError>, frame: &Frame) {
        self.keep(pair);
        if result.is_ok() && std::mem::take(&mut self.awaits_reference) {
            self.reference_px.clone_from(&frame.left_px);
        }
        let motion_px = result.is_ok().then_some(frame.motion_px);
        self.motion.push(Sample { time_ns: pair.time_ns, motion_px });
        if let Some(stage) = self.stages.last_mut() {
            stage.frames += 1;
            stage.bad_frames += u64::from(result.is_err());
        }
        self.last.sensed = match result {
            Ok(()) => Sensed::Markers(self.markers(frame)),
            Err(error) => Sensed::Bad(error.to_string()),
        };
    }

    /// Takes a pipeline action; `frame` is its last good frame.
    pub fn asked(&mut self, action: &Action, frame: &Frame) {
        match action {
            Action::Reset => self.awaits_reference = true,
            Action::MarkReference => self.reference_px.clone_from(&frame.left_px),
            _ => {}
        }
    }

    /// A trigger fired, or the run ends.
    pub fn trigger(&mut self, cause: &str) {
        self.triggers.push(Trigger { time_ns: self.time_ns, cause: cause.to_owned() });
    }

    /// Completes the stage.
    pub fn end(&mut self, report: &StageReport) {
        if let Some(stage) = self.stages.last_mut() {
            stage.report = Some(report.clone());
        }
    }

    /// The run or a stage is over; the last image becomes its picture.
    pub fn finish(&mut self) {
        let ended_ns = self.last_time_ns();
        let pictures = self.stages.iter().filter(|stage| stage.picture.is_some()).count();
        let Some((stage, before)) = self.stages.split_last_mut() else { return };
        stage.ended_ns = ended_ns;
        stage.picture = ended_ns.map(|_| self.last.clone());
        // Drops the latest earlier picture: the first stages and the last one matter most.
        if pictures >= MAX_PICTURES
            && let Some(older) = before.iter_mut().rev().find(|stage| stage.picture.is_some())
        {
            older.picture = None;
        }
    }

    fn keep(&mut self, pair: &StereoPair) {
        self.time_ns = pair.time_ns;
        (self.last.left.width, self.last.left.height) = (pair.left.width, pair.left.height);
        self.last.left.pixels.clone_from(&pair.left.pixels);
    }

    /// Time of the last pair, if any.
    fn last_time_ns(&self) -> Option<u64> {
        (!self.last.left.pixels.is_empty()).then_some(self.time_ns)
    }

    fn markers(&self, frame: &Frame) -> Markers {
        Markers {
            rows: frame.rows,
            cols: frame.cols,
            now_px: frame.left_px.clone(),
            reference_px: self.reference_px.clone(),
            state: frame.state.clone(),
            salient: frame.salient.clone(),
            motion_px: frame.motion_px,
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Runs of any length give few samples, ordered in time, including the largest motion.
        #[test]
        fn a_curve_is_bounded_and_keeps_its_peak(count in 1_u64..40_000, peak in 0_u64..40_000) {
            let mut curve = MotionCurve::default();
            for i in 0..count {
                let motion_px = if i == peak % count { 9.0 } else { (i % 7) as f64 };
                let is_good = i % 5 != 4 || motion_px > 8.0;
                curve.push(Sample { time_ns: i, motion_px: is_good.then_some(motion_px) });
            }
            let samples: Vec<Sample> = curve.samples.iter().copied().chain(curve.pending).collect();
            let at_least = count.min(MAX_SAMPLES as u64 / 2) as usize;
            prop_assert!((at_least..=MAX_SAMPLES).contains(&samples.len()));
            prop_assert!(samples.windows(2).all(|two| two[0].time_ns < two[1].time_ns));
            prop_assert!(samples.iter().any(|s| s.motion_px == Some(9.0) && s.time_ns == peak % count));
        }
    }

    #[test]
    fn pictures_are_bounded_and_the_last_stage_keeps_its_own() {
        let mut trace = Trace::default();
        let left = Gray { width: 2, height: 1, pixels: vec![0, 1] };
        for time_ns in 0..200 {
            trace.begin(Stage::Close);
            trace.passed(&StereoPair { time_ns, left: left.clone(), ..StereoPair::default() });
        }
        trace.finish();
        let kept: Vec<bool> = trace.stages().iter().map(|stage| stage.picture.is_some()).collect();
        assert_eq!(kept.iter().filter(|&&kept| kept).count(), MAX_PICTURES);
        assert!(kept[0] && kept[199] && trace.stages().len() == 200);
    }
}
