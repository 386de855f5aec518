//! Contacts over time.

use crate::scene::{GelKeyframe, Keyframe, Scene};
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::{Pose, floor, so3};

/// Keyframes of every part and of the gel, each in order of time.
#[derive(Clone, Debug)]
pub(crate) struct Trajectory {
    parts: Vec<Vec<Keyframe>>,
    gel: Vec<GelKeyframe>,
    frame_rate_hz: f64,
}

impl Trajectory {
    pub(crate) fn new(scene: &Scene) -> Self {
        let parts = scene.parts().map(|(_, keyframes)| keyframes.to_vec()).collect();
        Self { parts, gel: scene.gel_motion.clone(), frame_rate_hz: scene.frame_rate_hz }
    }

    /// Times of the first and the last keyframe; 0 without any.
    pub(crate) fn span_s(&self) -> [f64; 2] {
        let firsts = self.parts.iter().filter_map(|keyframes| keyframes.first()).map(|k| k.time_s);
        let lasts = self.parts.iter().filter_map(|keyframes| keyframes.last()).map(|k| k.time_s);
        let ends = [
            firsts.chain(self.gel.first().map(|k| k.time_s)).reduce(f64::min),
            lasts.chain(self.gel.last().map(|k| k.time_s)).reduce(f64::max),
        ];
        ends.map(Option::unwrap_or_default)
    }

    /// Frames from the first keyframe to the last, both included.
    pub(crate) fn frames(&self) -> usize {
        let [first, last] = self.span_s();
        // With rounding, 0.1 s at 30 Hz is 3.0000000000000004 frames, and 0.7 s is 20.999999999999996.
        floor((last - first) * self.frame_rate_hz + 1e-6) as usize + 1
    }

    pub(crate) fn time_s(&self, frame: u64) -> f64 {
        self.span_s()[0] + frame as f64 / self.frame_rate_hz
    }

    /// Contact of a part at a time. Translation, shear and twist are linear between keyframes; rotation
    /// follows the shortest arc. The first keyframe applies before it, and the last one after it.
    pub(crate) fn contact(&self, part: usize, time_s: f64) -> Option<ContactState> {
        let (before, after, share) = around(self.parts.get(part)?, |k| k.time_s, time_s)?;
        Some(match share {
            Some(share) => between(&before.contact, &after.contact, share),
            None => before.contact,
        })
    }

    /// Moves a part's contact from one time to another by its trajectory's motion between them.
    pub(crate) fn carried(
        &self,
        part: usize,
        contact: &ContactState,
        [from_s, to_s]: [f64; 2],
    ) -> ContactState {
        let [from, to] = [from_s, to_s].map(|time_s| self.contact(part, time_s));
        let (Some(from), Some(to)) = (from, to) else { return *contact };
        let (before, after, own) = (from.t_sensor_object, to.t_sensor_object, contact.t_sensor_object);
        let along = |axis: usize| contact.shear_mm[axis] + (to.shear_mm[axis] - from.shear_mm[axis]);
        let turn = after.rotation * before.rotation.conjugate();
        ContactState {
            t_sensor_object: Pose {
                rotation: (turn * own.rotation).normalize(),
                translation_mm: own.translation_mm + (after.translation_mm - before.translation_mm),
            },
            shear_mm: [along(0), along(1)],
            twist_rad: contact.twist_rad + (to.twist_rad - from.twist_rad),
        }
    }

    /// Motion of the gel at a time, linear between keyframes; `None` when it never moves.
    pub(crate) fn gel_at(&self, time_s: f64) -> Option<GelKeyframe> {
        let (before, after, share) = around(&self.gel, |k| k.time_s, time_s)?;
        let share = share.unwrap_or_default();
        let mix = |a: f64, b: f64| a + (b - a) * share;
        let (from, to) = (before.shift_mm, after.shift_mm);
        Some(GelKeyframe {
            time_s,
            shift_mm: [mix(from[0], to[0]), mix(from[1], to[1])],
            rotation_rad: mix(before.rotation_rad, after.rotation_rad),
        })
    }
}

/// The keyframes before and after a time, and the fraction of the interval between them. Outside all
/// keyframes, the nearest one twice and no fraction. `None` without keyframes.
fn around<K>(keyframes: &[K], at: impl Fn(&K) -> f64, time_s: f64) -> Option<(&K, &K, Option<f64>)> {
    let next = keyframes.partition_point(|k| at(k) <= time_s);
    let before = keyframes.get(next.saturating_sub(1))?;
    Some(match keyframes.get(next) {
        Some(after) if next > 0 => (before, after, Some((time_s - at(before)) / (at(after) - at(before)))),
        _ => (before, before, None),
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::Shape;
    use alloc::vec;
    use gelstereo_core::math::{DVec3, abs};
    use proptest::prelude::*;

    fn trajectory(times_s: &[f64], rotations: &[DVec3], frame_rate_hz: f64) -> Trajectory {
        let keyframe = |(&time_s, &omega): (&f64, &DVec3)| Keyframe {
            time_s,
            contact: ContactState::pressed(Pose::exp(omega, DVec3::ZERO)),
        };
        let trajectory = times_s.iter().zip(rotations).map(keyframe).collect();
        let indenter = Some(Shape::Sphere { radius_mm: 1.0 });
        Trajectory::new(&Scene { indenter, trajectory, frame_rate_hz, ..Scene::default() })
    }

    proptest! {
        /// The shortest arc, at a constant rate: the angles to both ends have the shares of the time.
        #[test]
        fn rotations_follow_the_shortest_arc(
            from in prop::array::uniform3(-1.0..1.0_f64), to in prop::array::uniform3(-1.0..1.0_f64),
            share in 0.01..0.99_f64,
        ) {
            let ends = [DVec3::from_array(from), DVec3::from_array(to)];
            let path = trajectory(&[0.0, 2.0], &ends, 30.0);
            let at = |time_s: f64| path.contact(0, time_s).unwrap().t_sensor_object.rotation;
            let angle = |a: f64, b: f64| so3::log(at(a).conjugate() * at(b)).length();
            let (whole, there) = (angle(0.0, 2.0), 2.0 * share);
            prop_assert!(abs(angle(0.0, there) - share * whole) < 1e-12);
            prop_assert!(abs(angle(there, 2.0) - (1.0 - share) * whole) < 1e-12);
        }

        /// A whole number of frames has its last one, although 21 / 30 s times 30 Hz is less than 21.
        #[test]
        fn round_off_takes_no_frame(
            count in 0usize..3000, rate_hz in prop::sample::select(vec![24.0, 30.0, 50.0, 60.0, 90.0, 120.0]),
            start_s in prop::sample::select(vec![0.0, 0.1, 3.3]),
        ) {
            let times_s = [start_s, start_s + count as f64 / rate_hz];
            prop_assert_eq!(trajectory(&times_s, &[DVec3::ZERO; 2], rate_hz).frames(), count + 1);
        }
    }
}
