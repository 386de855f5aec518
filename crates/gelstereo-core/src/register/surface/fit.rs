//! Coarse looks: one pass over some of the points, on the field, for convergence.

use super::contact::{Sample, Samples};
use super::noise::{coarse_pressed, coarse_unpressed};
use super::part::{Coarse, press_in_object};
use super::step::{Normal, Placement};
use crate::math::DVec3;

/// Which points are looked at.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub pressed: &'a [Sample],
    pub unpressed: &'a [Sample],
    pub radius_mm: f64,
    /// Sensor frame.
    pub press_direction: DVec3,
}

impl<'a> View<'a> {
    pub fn of(samples: &'a Samples, pressed: usize, unpressed: usize, press_direction: DVec3) -> Self {
        Self {
            pressed: &samples.pressed[..pressed.min(samples.pressed.len())],
            unpressed: &samples.unpressed[..unpressed.min(samples.unpressed.len())],
            radius_mm: samples.radius_mm,
            press_direction,
        }
    }

    /// Points looked at.
    pub fn len(&self) -> u64 {
        (self.pressed.len() + self.unpressed.len()) as u64
    }

    /// The linear system of a placement, all points with the same width.
    pub fn look(&self, part: &Coarse<'_>, placement: &Placement, width_mm: f64) -> Normal {
        let press = press_in_object(placement, self.press_direction);
        let (per_radius, per_width) = (1.0 / self.radius_mm, 1.0 / width_mm);
        let mut sum = Normal::ZERO;
        for sample in self.pressed {
            let near = part.near_at(placement.object_point(sample.p_mm), press);
            let (weight, cost) = coarse_pressed(near.distance_mm * per_width);
            let n = placement.sensor_direction(near.normal);
            sum.add(sample.p_mm, n, near.distance_mm, weight * per_width * per_width, per_radius);
            sum.cost += cost;
        }
        for sample in self.unpressed {
            let near = part.within(placement.object_point(sample.p_mm), press);
            if let Some(near) = near.filter(|near| near.distance_mm < 0.0) {
                let (weight, cost) = coarse_unpressed(near.distance_mm * per_width);
                let n = placement.sensor_direction(near.normal);
                sum.add(sample.p_mm, n, near.distance_mm, weight * per_width * per_width, per_radius);
                sum.cost += cost;
            }
        }
        sum
    }
}
