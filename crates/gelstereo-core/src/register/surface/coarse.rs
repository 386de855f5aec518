//! Coarse passes over some of the points, on the field, for convergence.

use super::contact::Samples;
use super::distances::{Coarse, Near, press_in_object};
use super::mixture::{coarse_pressed, coarse_unpressed};
use super::normal_system::{Normal, Placement};
use super::point::Sample;
use crate::math::DVec3;

/// The points of a pass.
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

    /// Number of points.
    pub fn len(&self) -> u64 {
        (self.pressed.len() + self.unpressed.len()) as u64
    }

    /// The linear system of a placement, with the same width for all points.
    pub fn look(&self, part: &Coarse<'_>, placement: &Placement, width_mm: f64) -> Normal {
        let within = |_, x_mm, press| part.within(x_mm, press).ok();
        self.sum(part, placement, width_mm, within)
    }

    /// The same for successive passes: markers that were clear of the part are evaluated again only when
    /// they may be inside it. Points outside the field count as `reach_mm` away.
    pub fn look_again(
        &self,
        part: &Coarse<'_>,
        placement: &Placement,
        width_mm: f64,
        clear: &mut [Clear],
        reach_mm: f64,
    ) -> Normal {
        self.sum(part, placement, width_mm, |k: usize, x_mm, press| {
            if clear[k].is_over(x_mm, 0.0) {
                return None;
            }
            let within = part.within(x_mm, press);
            clear[k] = within.err().map_or(Clear::NOT, |over_mm| Clear::new(x_mm, over_mm.min(reach_mm)));
            within.ok()
        })
    }

    #[inline]
    fn sum(
        &self,
        part: &Coarse<'_>,
        placement: &Placement,
        width_mm: f64,
        within: impl FnMut(usize, DVec3, DVec3) -> Option<Near>,
    ) -> Normal {
        let (per_radius, per_width) = (1.0 / self.radius_mm, 1.0 / width_mm);
        let mut sum = Normal::ZERO;
        self.each(part, placement, per_width, within, |sample, near, (weight, cost)| {
            let n = placement.sensor_direction(near.normal);
            sum.add(sample.p_mm, n, near.distance_mm, weight * per_width * per_width, per_radius);
            sum.cost += cost;
        });
        sum
    }

    /// The cost alone.
    pub fn cost(&self, part: &Coarse<'_>, placement: &Placement, width_mm: f64) -> f64 {
        let mut sum = 0.0;
        let within = |_, x_mm, press| part.within(x_mm, press).ok();
        self.each(part, placement, 1.0 / width_mm, within, |_, _, (_, cost)| sum += cost);
        sum
    }

    /// Passes every point that contributes to `seen`, with its weight and cost.
    #[inline]
    fn each(
        &self,
        part: &Coarse<'_>,
        placement: &Placement,
        per_width: f64,
        mut within: impl FnMut(usize, DVec3, DVec3) -> Option<Near>,
        mut seen: impl FnMut(&Sample, &Near, (f64, f64)),
    ) {
        let press = press_in_object(placement, self.press_direction);
        for sample in self.pressed {
            let near = part.near_at(placement.object_point(sample.p_mm), press);
            seen(sample, &near, coarse_pressed(near.distance_mm * per_width));
        }
        for (k, sample) in self.unpressed.iter().enumerate() {
            let near = within(k, placement.object_point(sample.p_mm), press);
            if let Some(near) = near.filter(|near| near.distance_mm < 0.0) {
                seen(sample, &near, coarse_unpressed(near.distance_mm * per_width));
            }
        }
    }
}

/// Position at which a marker was evaluated, and its distance from the part there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clear {
    at_mm: DVec3,
    over_mm: f64,
}

impl Clear {
    /// Nothing is known.
    pub const NOT: Self = Self { at_mm: DVec3::ZERO, over_mm: f64::NEG_INFINITY };

    pub fn new(at_mm: DVec3, over_mm: f64) -> Self {
        Self { at_mm, over_mm }
    }

    /// Whether the distance at `x_mm` is surely above `level_mm`. Between nodes the slope of the field
    /// along each axis is at most 1, √3 in all.
    #[inline]
    pub fn is_over(&self, x_mm: DVec3, level_mm: f64) -> bool {
        let above_mm = self.over_mm - level_mm;
        above_mm > 0.0 && above_mm * above_mm > 3.0 * x_mm.distance_squared(self.at_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;
    use crate::surface::{Field, Solid, TriangleMesh};

    /// A wedge whose sharp edge the field cuts off, and random pairs of positions, some of them along its
    /// slopes.
    #[test]
    fn what_was_clear_and_has_not_gone_far_is_not_within() {
        let corners = [[0.0, 0.0], [6.0, 0.0], [3.0, 1.0]];
        let places = [-5.0, 5.0].iter().flat_map(|&z| corners.map(|[x, y]| DVec3::new(x, y, z))).collect();
        let triangles =
            [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]];
        let mesh = TriangleMesh::new(places, triangles.to_vec());
        let solid = mesh.ok().and_then(|mesh| Solid::new(&mesh).ok());
        let field = solid.and_then(|solid| Field::new(&solid, 0.4, 4.0));
        let Some(field) = field else { return assert!(field.is_some()) };
        let part = Coarse { field: &field, gel_scale: 1.0 };
        let (mut random, mut clear) = (Stream::new(1, "clear"), 0);
        for _ in 0..20_000 {
            let mut place = |size_mm: f64| {
                DVec3::new(random.uniform(), random.uniform(), random.uniform()) * size_mm - 0.5 * size_mm
            };
            let here = DVec3::new(3.0, 0.5, 0.0) + place(8.0);
            let (there, press) = (here + place(1.5), DVec3::Y);
            let Err(over_mm) = part.within(here, press) else { continue };
            if Clear::new(here, over_mm.min(field.reach_mm())).is_over(there, 0.0) {
                clear += 1;
                assert!(part.within(there, press).map_or_else(|mm| mm, |near| near.distance_mm) > 0.0);
            }
        }
        assert!(clear > 2000, "{clear}");
    }
}
