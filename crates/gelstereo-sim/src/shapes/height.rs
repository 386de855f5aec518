//! Entry point of a line into a solid, in closed form.

use super::{BOARD_THICKNESS_MM, Shape};
use gelstereo_core::math::{DVec3, sqrt};

/// Parameter interval of a line within a convex solid; empty when `enter > leave`.
#[derive(Clone, Copy)]
struct Span {
    enter: f64,
    leave: f64,
}

impl Span {
    const WHOLE: Self = Self { enter: f64::NEG_INFINITY, leave: f64::INFINITY };
    const EMPTY: Self = Self { enter: f64::INFINITY, leave: f64::NEG_INFINITY };

    fn and(self, other: Self) -> Self {
        Self { enter: self.enter.max(other.enter), leave: self.leave.min(other.leave) }
    }

    fn entry(self) -> Option<f64> {
        (self.enter <= self.leave && self.enter.is_finite()).then_some(self.enter)
    }
}

impl Shape {
    /// Smallest s with `origin + s direction` in the solid (object frame, `direction` of unit length); `None`
    /// where the line misses it, and for mesh files.
    #[inline(always)]
    pub(crate) fn entry_mm(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        match self {
            Self::Sphere { radius_mm } => {
                let [a, b] = [direction.length_squared(), origin.dot(direction)];
                // Uses the line's foot point: |o|² - R² alone would cancel for a far origin.
                let foot = origin - direction * (b / a);
                round(a, b, radius_mm * radius_mm - foot.length_squared()).entry()
            }
            Self::Cylinder { radius_mm, length_mm } => {
                let end = slab(origin.z, direction.z, -0.5 * length_mm, 0.5 * length_mm);
                barrel(origin, direction, *radius_mm).and(end).entry()
            }
            Self::Box { size_mm } => {
                let half = DVec3::from_array(*size_mm) * 0.5;
                cuboid(origin, direction, -half, half)
            }
            Self::Board { size_mm: [w, h], block_mm: [bw, bh], protrusion_mm } => {
                let plate = DVec3::new(0.5 * w, 0.5 * h, 0.0);
                let block = DVec3::new(0.5 * bw, 0.5 * bh, *protrusion_mm);
                let down = DVec3::new(0.0, 0.0, BOARD_THICKNESS_MM);
                let in_plate = cuboid(origin, direction, -plate - down, plate);
                let in_block = cuboid(origin, direction, DVec3::new(-block.x, -block.y, 0.0), block);
                match (in_plate, in_block) {
                    (Some(a), Some(b)) => Some(a.min(b)),
                    (a, b) => a.or(b),
                }
            }
            Self::Mesh { .. } => None,
        }
    }
}

/// The interval where a quadratic a s² + 2 b s is within `room` of its minimum at -b / a.
fn round(a: f64, b: f64, room: f64) -> Span {
    if room.is_nan() || room < 0.0 {
        return Span::EMPTY;
    }
    let half = sqrt(room / a);
    Span { enter: -b / a - half, leave: -b / a + half }
}

fn barrel(origin: DVec3, direction: DVec3, radius: f64) -> Span {
    let (o, d) = (origin.truncate(), direction.truncate());
    let a = d.length_squared();
    // Parallel to the axis, the whole line is inside or outside; 1e-24 is a rotation of 1e-12 rad, below
    // round-off of a pose.
    if a < 1e-24 {
        return if o.length_squared() <= radius * radius { Span::WHOLE } else { Span::EMPTY };
    }
    let foot = o - d * (o.dot(d) / a);
    round(a, o.dot(d), radius * radius - foot.length_squared())
}

fn slab(origin: f64, direction: f64, low: f64, high: f64) -> Span {
    if direction == 0.0 {
        return if (low..=high).contains(&origin) { Span::WHOLE } else { Span::EMPTY };
    }
    let (a, b) = ((low - origin) / direction, (high - origin) / direction);
    Span { enter: a.min(b), leave: a.max(b) }
}

fn cuboid(origin: DVec3, direction: DVec3, low: DVec3, high: DVec3) -> Option<f64> {
    let axis = |i: usize| slab(origin[i], direction[i], low[i], high[i]);
    axis(0).and(axis(1)).and(axis(2)).entry()
}
