//! Contact state of a frame, and crossings of the triggers.

use crate::config::{Config, SenseConfig};
use gelstereo_core::params::ContactParams;
use gelstereo_core::pipeline::Frame;
use serde::{Deserialize, Serialize};

/// A trigger of the robot task, evaluated here without a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trigger {
    /// `contact.grasp_trigger_px`.
    Grasp,
    /// `contact.insertion_trigger_px`.
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
    /// Triggers crossed in this frame.
    pub crossings: Vec<Crossing>,
}

/// Tracks contact from frame to frame.
#[derive(Clone, Debug)]
pub struct ContactMeter {
    min_salient: u32,
    triggers: [(Trigger, f64, bool); 2],
}

impl ContactMeter {
    /// Starts with every trigger below its threshold.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let SenseConfig { min_salient, .. } = config.sense;
        let ContactParams { grasp_trigger_px, insertion_trigger_px, .. } = config.params.contact;
        let triggers =
            [(Trigger::Grasp, grasp_trigger_px, false), (Trigger::Insertion, insertion_trigger_px, false)];
        Self { min_salient, triggers }
    }

    /// Evaluates contact in the next frame.
    pub fn next(&mut self, frame: &Frame) -> Contact {
        let pressed = frame.indentation_mm.iter().zip(&frame.salient).filter(|&(_, &salient)| salient);
        let (salient, max_indentation_mm) =
            pressed.fold((0, 0.0_f64), |(count, max_mm), (&mm, _)| (count + 1, max_mm.max(mm)));
        let mut crossings = Vec::new();
        for (trigger, trigger_px, was_above) in &mut self.triggers {
            let above = frame.motion_px >= *trigger_px;
            if above != std::mem::replace(was_above, above) {
                crossings.push(Crossing { trigger: *trigger, above });
            }
        }
        Contact {
            touching: salient >= self.min_salient,
            salient,
            max_indentation_mm,
            motion_px: frame.motion_px,
            crossings,
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

    #[test]
    fn few_salient_markers_are_noise() {
        let mut meter = ContactMeter::new(&Config::default());
        let contact = meter.next(&frame(0.0, &[0.5, 0.9, 0.1]));
        assert_eq!((contact.touching, contact.salient, contact.max_indentation_mm), (false, 2, 0.9));
        let contact = meter.next(&frame(0.0, &[0.5, 0.9, 0.4]));
        assert_eq!((contact.touching, contact.salient), (true, 3));
    }
}
