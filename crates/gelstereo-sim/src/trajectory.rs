//! Contacts over time.

use crate::scene::{Keyframe, Scene};
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::{Pose, floor, so3};

/// Keyframes in order of time.
#[derive(Clone, Debug)]
pub(crate) struct Trajectory {
    keyframes: Vec<Keyframe>,
    frame_rate_hz: f64,
}

impl Trajectory {
    pub(crate) fn new(scene: &Scene) -> Self {
        Self { keyframes: scene.trajectory.clone(), frame_rate_hz: scene.frame_rate_hz }
    }

    /// Frames from the first keyframe to the last, both included.
    pub(crate) fn frames(&self) -> usize {
        let [Some(first), Some(last)] = [self.keyframes.first(), self.keyframes.last()] else { return 1 };
        // 0.1 s at 30 Hz is 3.0000000000000004 frames, and 0.7 s is 20.999999999999996.
        floor((last.time_s - first.time_s) * self.frame_rate_hz + 1e-6) as usize + 1
    }

    /// Contact at a frame: translation, shear and twist linear between keyframes, rotation along the shortest
    /// arc; the last keyframe holds on.
    pub(crate) fn contact(&self, frame: usize) -> Option<ContactState> {
        let time_s = self.keyframes.first()?.time_s + frame as f64 / self.frame_rate_hz;
        let next = self.keyframes.partition_point(|k| k.time_s <= time_s);
        let before = &self.keyframes[next.saturating_sub(1)];
        let Some(after) = self.keyframes.get(next) else { return Some(before.contact) };
        let share = (time_s - before.time_s) / (after.time_s - before.time_s);
        Some(between(&before.contact, &after.contact, share))
    }
}

fn between(a: &ContactState, b: &ContactState, share: f64) -> ContactState {
    let mix = |a: f64, b: f64| a + (b - a) * share;
    let (from, to) = (a.t_sensor_object, b.t_sensor_object);
    let turn = so3::log(from.rotation.conjugate() * to.rotation);
    ContactState {
        t_sensor_object: Pose {
            rotation: from.rotation * so3::exp(turn * share),
            translation_mm: from.translation_mm.lerp(to.translation_mm, share),
        },
        shear_mm: [mix(a.shear_mm[0], b.shear_mm[0]), mix(a.shear_mm[1], b.shear_mm[1])],
        twist_rad: mix(a.twist_rad, b.twist_rad),
    }
}
