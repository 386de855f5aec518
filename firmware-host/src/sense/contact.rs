//! Contact state of a frame, and crossings of the triggers.

use crate::config::{Config, SenseConfig};
use crate::rest_noise::{FRAMES, RestNoise};
use gelstereo_core::params::ContactParams;
use gelstereo_core::pipeline::Frame;
use serde::{Deserialize, Serialize};

/// A trigger of the robot task, evaluated here without a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trigger {
    /// `task.grasp_trigger_sigmas`, or `contact.grasp_trigger_px`.
    Grasp,
    /// `task.insertion_trigger_sigmas`, or `contact.insertion_trigger_px`.
    Insertion,
}

/// The moment at which the mean marker motion crossed a trigger.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Crossing {
    /// The trigger.
    pub trigger: Trigger,
    /// Whether the motion is above it now.
    pub above: bool,
}

/// Contact in one frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// Whether the gel is in contact: at least `sense.min_salient` markers are salient.
    pub touching: bool,
    /// Number of markers in contact.
    pub salient: u32,
    /// Largest indentation of a marker in contact; 0 without contact.
    pub max_indentation_mm: f64,
    /// Mean motion of the markers since the rest state.
    pub motion_px: f64,
    /// The same above its median at rest, in standard deviations at rest; absent until 34 frames without
    /// contact were seen, and if their motions are equal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion_sigmas: Option<f64>,
    /// Triggers crossed in this frame.
    pub crossings: Vec<Crossing>,
}

/// Tracks contact from frame to frame.
#[derive(Clone, Debug)]
pub struct ContactMeter {
    min_salient: u32,
    triggers: [Level; 2],
    /// Motions of the first frames without contact.
    at_rest_px: Vec<f64>,
    noise: Option<RestNoise>,
}

/// A trigger and whether the motion is above it.
#[derive(Clone, Copy, Debug)]
struct Level {
    trigger: Trigger,
    px: f64,
    /// In place of pixels.
    sigmas: Option<f64>,
    above: bool,
}

impl Level {
    /// Whether a motion is above it; a trigger in standard deviations waits until these are known.
    fn is_reached(&self, motion_px: f64, motion_sigmas: Option<f64>) -> bool {
        let Some(sigmas) = self.sigmas else { return motion_px >= self.px };
        motion_sigmas.is_some_and(|found| found >= sigmas)
    }
}

impl ContactMeter {
    /// Starts with every trigger below its threshold.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let SenseConfig { min_salient, .. } = config.sense;
        let ContactParams { grasp_trigger_px, insertion_trigger_px, .. } = config.params.contact;
        let level = |trigger, px, sigmas| Level { trigger, px, sigmas, above: false };
        let triggers = [
            level(Trigger::Grasp, grasp_trigger_px, config.task.grasp_trigger_sigmas),
            level(Trigger::Insertion, insertion_trigger_px, config.task.insertion_trigger_sigmas),
        ];
        Self { min_salient, triggers, at_rest_px: Vec::with_capacity(FRAMES), noise: None }
    }

    /// Evaluates contact in the next frame.
    pub fn next(&mut self, frame: &Frame) -> Contact {
        let pressed = frame.indentation_mm.iter().zip(&frame.salient).filter(|&(_, &salient)| salient);
        let (salient, max_indentation_mm) =
            pressed.fold((0, 0.0_f64), |(count, max_mm), (&mm, _)| (count + 1, max_mm.max(mm)));
        let touching = salient >= self.min_salient;
        self.learn(touching, frame.motion_px);
        let motion_sigmas = self.noise.and_then(|noise| noise.sigmas(frame.motion_px));
        let mut crossings = Vec::new();
        for level in &mut self.triggers {
            let above = level.is_reached(frame.motion_px, motion_sigmas);
            if above != std::mem::replace(&mut level.above, above) {
                crossings.push(Crossing { trigger: level.trigger, above });
            }
        }
        Contact {
            touching,
            salient,
            max_indentation_mm,
            motion_px: frame.motion_px,
            motion_sigmas,
            crossings,
        }
    }

    /// The noise at rest, from the first frames without contact.
    fn learn(&mut self, touching: bool, motion_px: f64) {
        if self.noise.is_some() || touching {
            return;
        }
        self.at_rest_px.push(motion_px);
        if self.at_rest_px.len() == FRAMES {
            self.noise = Some(RestNoise::of(std::mem::take(&mut self.at_rest_px)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(motion_px: f64, indentation_mm: &[f64]) -> Frame {
        Frame {
            motion_px,
            salient: indentation_mm.iter().map(|&mm| mm > 0.35).collect(),
            indentation_mm: indentation_mm.to_vec(),
            ..Frame::default()
        }
    }

    proptest! {
        /// For any sequence of motions, the crossings of each trigger alternate, and the last one agrees
        /// with the final motion.
        #[test]
        fn crossings_alternate(motions in prop::collection::vec(0.0..20.0_f64, 1..60)) {
            let config = Config::default();
            let limits = [
                (Trigger::Grasp, config.params.contact.grasp_trigger_px),
                (Trigger::Insertion, config.params.contact.insertion_trigger_px),
            ];
            let mut meter = ContactMeter::new(&config);
            let mut seen = Vec::new();
            for &motion_px in &motions {
                seen.extend(meter.next(&frame(motion_px, &[])).crossings);
            }
            for (trigger, limit_px) in limits {
                let own: Vec<bool> = seen.iter().filter(|c| c.trigger == trigger).map(|c| c.above).collect();
                prop_assert!(own.iter().enumerate().all(|(i, &above)| above == (i % 2 == 0)));
                let last = motions.last().is_some_and(|&px| px >= limit_px);
                prop_assert_eq!(own.last().copied().unwrap_or(false), last);
            }
        }
    }

    /// After 34 frames at rest, the meter states motion in their standard deviations. A trigger in that unit
    /// then fires.
    #[test]
    fn triggers_may_be_in_sigmas() {
        let mut config = Config::default();
        config.task.grasp_trigger_sigmas = Some(8.0);
        let mut meter = ContactMeter::new(&config);
        let at_rest = |i: usize| 0.1 + 0.01 * ((i * 7 % 11) as f64 - 5.0);
        for i in 0..FRAMES - 1 {
            assert_eq!(meter.next(&frame(at_rest(i), &[])).motion_sigmas, None);
        }
        let noise = RestNoise::of((0..FRAMES).map(at_rest).collect());
        meter.next(&frame(at_rest(FRAMES - 1), &[]));
        for (sigmas, crossed) in [(7.9, 0), (8.1, 1), (9.0, 0), (1.0, 1)] {
            let contact = meter.next(&frame(noise.at(sigmas), &[]));
            assert!((contact.motion_sigmas.unwrap() - sigmas).abs() < 1e-9);
            assert_eq!(contact.crossings.len(), crossed, "{sigmas}");
            assert!(contact.crossings.iter().all(|crossing| crossing.trigger == Trigger::Grasp));
        }
        // Equal motions have no noise.
        let mut still = ContactMeter::new(&config);
        let contacts: Vec<Contact> = (0..40).map(|_| still.next(&frame(0.2, &[]))).collect();
        assert!(contacts.iter().all(|contact| contact.motion_sigmas.is_none()));
        assert!(still.next(&frame(50.0, &[])).crossings.iter().all(|c| c.trigger == Trigger::Insertion));
    }

    #[test]
    fn few_salient_markers_are_noise() {
        let mut meter = ContactMeter::new(&Config::default());
        let contact = meter.next(&frame(0.0, &[0.5, 0.9, 0.1]));
        assert_eq!((contact.touching, contact.salient, contact.max_indentation_mm), (false, 2, 0.9));
        let contact = meter.next(&frame(0.0, &[0.5, 0.9, 0.4]));
        assert_eq!((contact.touching, contact.salient), (true, 3));
    }
}
