//! Coarse looks: one pass over some of the points, on the field, for convergence.

use super::contact::{Sample, Samples};
use super::noise::{coarse_pressed, coarse_unpressed};
use super::part::{Coarse, Near, press_in_object};
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
        let (per_radius, per_width) = (1.0 / self.radius_mm, 1.0 / width_mm);
        let mut sum = Normal::ZERO;
        self.each(part, placement, per_width, |sample, near, (weight, cost)| {
            let n = placement.sensor_direction(near.normal);
            sum.add(sample.p_mm, n, near.distance_mm, weight * per_width * per_width, per_radius);
            sum.cost += cost;
        });
        sum
    }

    /// Its cost alone.
    pub fn cost(&self, part: &Coarse<'_>, placement: &Placement, width_mm: f64) -> f64 {
        let mut sum = 0.0;
        self.each(part, placement, 1.0 / width_mm, |_, _, (_, cost)| sum += cost);
        sum
    }

    /// Every point that says something, with its weight and cost.
    #[inline]
    fn each(
        &self,
        part: &Coarse<'_>,
        placement: &Placement,
        per_width: f64,
        mut seen: impl FnMut(&Sample, &Near, (f64, f64)),
    ) {
        let press = press_in_object(placement, self.press_direction);
        for sample in self.pressed {
            let near = part.near_at(placement.object_point(sample.p_mm), press);
            seen(sample, &near, coarse_pressed(near.distance_mm * per_width));
        }
        for sample in self.unpressed {
            let near = part.within(placement.object_point(sample.p_mm), press);
            if let Some(near) = near.filter(|near| near.distance_mm < 0.0) {
                seen(sample, &near, coarse_unpressed(near.distance_mm * per_width));
            }
        }
    }
}
