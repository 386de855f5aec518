//! Distances of points from the part: on the exact triangles, and on the field, which takes one weighted sum.

use super::normal_system::Placement;
use super::smooth_normals::Relief;
use crate::math::{DVec3, abs, sqrt};
use crate::surface::{Facing, Feature, Field, Solid};

/// Least cosine to the press of a face that can be in contact; negative, to allow for noise and for the
/// tilt of a guess.
const MIN_COSINE: f64 = -0.1;
/// Lookups along the way through the part to a face that can be in contact.
const MAX_LOOKUPS: usize = 8;

/// Distance to the part, and outward normal at the nearest point; object frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    pub distance_mm: f64,
    pub normal: DVec3,
    /// Rotation of the normal along the surface; 0 where unknown.
    pub curvature_per_mm: f64,
}

/// Distance queries to a part.
pub(super) trait Distances {
    /// `press` is the direction from the part into the gel, object frame; distances out of `range` need
    /// not be exact.
    fn at(&self, x_mm: DVec3, press: DVec3, range: Range, last: &mut Last) -> Near;
}

/// Range of distances at which a point matters, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub from_mm: f64,
    pub to_mm: f64,
}

/// State of a point that is kept between lookups.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Last {
    /// The last nearest triangle.
    pub triangle: u32,
    /// Work of the lookups, in lookups of the field.
    pub work: u64,
}

/// The part's surface under a marker, along the press.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foot {
    /// Height of the marker over it; negative inside the part.
    pub over_mm: f64,
    /// Outward normal, object frame.
    pub normal: DVec3,
    pub curvature_per_mm: f64,
}

/// Search range along the press: largest distance of the marker over the part, and under its surface.
const OVER_MM: f64 = 2.0;
pub(super) const UNDER_MM: f64 = 1.5;
/// Faces with a smaller cosine to the press are intersected with the line itself, not found by distances.
const STEEP_COSINE: f64 = 0.2;
/// Faces with a smaller cosine, within 2 degrees of the press, are walls beside which the gel is free.
const WALL_COSINE: f64 = 0.03;
/// Accuracy of a foot on a steep face from the field.
const MET_MM: f64 = 0.4;
/// Steps of sphere tracing (Hart 1996), and the distance at which they end, in cells.
const MAX_STEPS: usize = 12;
const NEAR: f64 = 0.2;
/// Newton steps on the triangles, and their convergence limit.
const MAX_REFINED: usize = 4;
const ON_MM: f64 = 2e-3;
/// Step length within which a face is flat to a micrometre.
const CLOSE_MM: f64 = 0.03;

/// Number of interleaved lines: each step depends on the previous one of its line, and on no other line.
const TOGETHER: usize = 4;

/// Line through a marker along the press, and what is known of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    x_mm: DVec3,
    /// Current position, as the height over the marker; it moves against the press.
    at_mm: f64,
    is_done: bool,
    /// First intersection with the part.
    pub foot: Option<Foot>,
    /// Least distance from the part so far.
    pub clear_mm: f64,
    /// Height of the marker over the first position whose distance is within the field's error.
    near_over_mm: Option<f64>,
}

impl Line {
    /// The line through a marker, object frame, from `start_mm` over it on.
    pub const fn new(x_mm: DVec3, start_mm: f64) -> Self {
        Self {
            x_mm,
            at_mm: start_mm,
            is_done: false,
            foot: None,
            clear_mm: f64::INFINITY,
            near_over_mm: None,
        }
    }

    /// A line that is known to miss the part.
    pub const fn past() -> Self {
        Self { is_done: true, ..Self::new(DVec3::ZERO, 0.0) }
    }
}

impl Coarse<'_> {
    /// Marches all lines to the part, or past it.
    pub fn march(&self, lines: &mut [Line], press: DVec3) {
        for few in lines.chunks_mut(TOGETHER) {
            for _ in 0..MAX_STEPS {
                few.iter_mut().filter(|line| !line.is_done).for_each(|line| self.go_on(line, press));
                if few.iter().all(|line| line.is_done) {
                    break;
                }
            }
        }
    }

    /// One step.
    #[inline(always)]
    fn go_on(&self, line: &mut Line, press: DVec3) {
        let step_mm = match self.field.distance(line.x_mm + press * line.at_mm) {
            Some((distance_mm, gradient)) => self.look(line, distance_mm, gradient, press),
            None => self.field.reach_mm(),
        };
        line.at_mm -= step_mm;
        line.is_done |= line.at_mm < -OVER_MM * self.gel_scale;
    }

    /// Evaluates the field at the line's position; returns the next step length.
    #[inline(always)]
    fn look(&self, line: &mut Line, distance_mm: f64, gradient: DVec3, press: DVec3) -> f64 {
        let near_mm = NEAR * self.field.cell_mm();
        line.clear_mm = line.clear_mm.min(distance_mm);
        if distance_mm < FIELD_ERROR * self.field.cell_mm() && line.near_over_mm.is_none() {
            line.near_over_mm = Some(-line.at_mm);
        }
        if distance_mm < near_mm {
            let length = sqrt(gradient.length_squared());
            let normal = if length > 1e-3 { gradient / length } else { press };
            let cosine = normal.dot(press);
            let is_on = distance_mm < 0.25 * near_mm;
            if cosine >= STEEP_COSINE || (is_on && cosine >= WALL_COSINE) {
                let over_mm = distance_mm / cosine.max(STEEP_COSINE) - line.at_mm;
                line.foot = Some(Foot { over_mm, normal, curvature_per_mm: 0.0 });
                line.is_done = true;
            }
            line.is_done |= is_on;
        }
        distance_mm.max(0.5 * near_mm)
    }
}

impl Exact<'_> {
    /// First intersection with the triangles of a line that has marched on the field. Without one, the
    /// error is the least distance from the part.
    pub fn foot(&self, line: &Line, press: DVec3, hint: &mut u32) -> Result<Foot, f64> {
        let (scale, x_mm) = (self.field.gel_scale, line.x_mm);
        let mut foot = match (line.foot, line.near_over_mm) {
            (Some(foot), _) => foot,
            // An edge that the field cuts off: use the triangles.
            (None, Some(near_mm)) => {
                return self.first_met(x_mm, near_mm, press, hint).ok_or(line.clear_mm);
            }
            (None, None) => return Err(line.clear_mm),
        };
        let coarse_mm = foot.over_mm;
        let facing = Facing { direction: press, least_cosine: MIN_COSINE };
        for _ in 0..MAX_REFINED {
            let at_mm = x_mm - press * foot.over_mm;
            let found =
                self.solid.closest_facing(at_mm, &facing, REACH_MM * scale, Some(*hint)).ok_or(0.0)?;
            *hint = found.triangle;
            let slope = self.relief.slope(self.solid, &found, at_mm - found.point_mm, scale);
            let cosine = slope.normal.dot(press);
            if cosine < STEEP_COSINE {
                break;
            }
            let step_mm = found.distance_mm / cosine;
            foot = Foot {
                over_mm: foot.over_mm + step_mm,
                normal: slope.normal,
                curvature_per_mm: slope.curvature_per_mm,
            };
            let is_flat = abs(step_mm) < CLOSE_MM * scale && found.feature == Feature::Face;
            if abs(step_mm) < ON_MM * scale || is_flat {
                return Ok(foot);
            }
        }
        self.first_met(x_mm, coarse_mm, press, hint).ok_or(0.0)
    }

    /// Intersects the line with the triangles: on a steep face or beside an edge, the nearest face may be
    /// another one.
    #[cold]
    fn first_met(&self, x_mm: DVec3, coarse_mm: f64, press: DVec3, hint: &mut u32) -> Option<Foot> {
        let facing = Facing { direction: press, least_cosine: WALL_COSINE };
        let found = self.solid.first_met(x_mm - press * coarse_mm, &facing, MET_MM * self.field.gel_scale)?;
        *hint = found.triangle;
        let slope = self.relief.slope(self.solid, &found, DVec3::ZERO, self.field.gel_scale);
        let is_seen = slope.normal.dot(press) >= WALL_COSINE;
        Some(Foot {
            over_mm: coarse_mm + found.distance_mm,
            normal: if is_seen { slope.normal } else { found.normal },
            curvature_per_mm: slope.curvature_per_mm,
        })
    }
}

/// The distance field, trilinear between its nodes.
#[derive(Clone, Copy)]
pub(super) struct Coarse<'a> {
    pub field: &'a Field,
    /// As [`AdvancedRegisterParams::gel_scale`](crate::params::AdvancedRegisterParams::gel_scale).
    pub gel_scale: f64,
}

impl Distances for Coarse<'_> {
    #[inline]
    fn at(&self, x_mm: DVec3, press: DVec3, _: Range, last: &mut Last) -> Near {
        last.work += 1;
        self.near_at(x_mm, press)
    }
}

impl Coarse<'_> {
    /// Distance of a point, and its normal.
    #[inline(always)]
    pub fn near_at(&self, x_mm: DVec3, press: DVec3) -> Near {
        let near = self.lookup(x_mm, press);
        if near.normal.dot(press) >= MIN_COSINE { near } else { self.through(x_mm, press, near) }
    }

    /// As [`Self::near_at`]. If the point is surely outside the part, which needs no direction, the error
    /// is its distance: ∞ out of the field's reach.
    #[inline(always)]
    pub fn within(&self, x_mm: DVec3, press: DVec3) -> Result<Near, f64> {
        let (distance_mm, gradient) = self.field.distance(x_mm).ok_or(f64::INFINITY)?;
        if distance_mm >= 0.0 && gradient.dot(press) >= 0.0 {
            return Err(distance_mm);
        }
        let near = Self::near(distance_mm, gradient, press);
        let is_touched = near.normal.dot(press) >= MIN_COSINE;
        Ok(if is_touched { near } else { self.through(x_mm, press, near) })
    }

    /// Out of the field's reach the distance is that reach.
    #[inline(always)]
    fn lookup(&self, x_mm: DVec3, press: DVec3) -> Near {
        let (distance_mm, gradient) = self.field.distance(x_mm).unwrap_or((self.field.reach_mm(), press));
        Self::near(distance_mm, gradient, press)
    }

    #[inline]
    fn near(distance_mm: f64, gradient: DVec3, press: DVec3) -> Near {
        let length_squared = gradient.length_squared();
        let normal = if length_squared > 1e-6 { gradient * (1.0 / sqrt(length_squared)) } else { press };
        Near { distance_mm, normal, curvature_per_mm: 0.0 }
    }

    /// For a nearest face that cannot be in contact, such as the back of a thin plate. Continues along
    /// the press until the nearest face can be, and takes the distance to its plane. If the way leaves
    /// the part, keeps the first result.
    #[cold]
    fn through(&self, x_mm: DVec3, press: DVec3, first: Near) -> Near {
        let min_mm = self.field.cell_mm();
        let (mut way_mm, mut near) = (0.0, first);
        for _ in 0..MAX_LOOKUPS {
            way_mm += abs(near.distance_mm).max(min_mm);
            let next = self.lookup(x_mm + press * way_mm, press);
            if next.normal.dot(press) >= MIN_COSINE {
                let distance_mm = next.distance_mm - way_mm * next.normal.dot(press);
                // Out of the part already: nothing is in the way.
                return if near.distance_mm > 0.0 { first } else { Near { distance_mm, ..next } };
            }
            if near.distance_mm > 0.0 && next.distance_mm > near.distance_mm {
                return first;
            }
            near = next;
        }
        first
    }
}

/// Exact distances to the triangles.
#[derive(Clone, Copy)]
pub(super) struct Exact<'a> {
    pub solid: &'a Solid,
    pub relief: &'a Relief,
    pub field: Coarse<'a>,
}

/// Distance from which a part has no influence.
const REACH_MM: f64 = 20.0;
/// Work of a lookup on the triangles, in lookups of the field.
const EXACT_WORK: u64 = 16;
/// Largest error of the field of a closed surface, in cells: √3 / 2.
const FIELD_ERROR: f64 = 0.867;

impl Distances for Exact<'_> {
    /// The field determines which points need no lookup on the triangles, and bounds their search radius.
    #[inline]
    fn at(&self, x_mm: DVec3, press: DVec3, range: Range, last: &mut Last) -> Near {
        last.work += 1;
        let farthest_mm = REACH_MM * self.field.gel_scale;
        let mut reach_mm = farthest_mm;
        if let Some((distance_mm, gradient)) = self.field.field.distance(x_mm) {
            let near = Coarse::near(distance_mm, gradient, press);
            let error_mm = FIELD_ERROR * self.field.field.cell_mm();
            let matters = (range.from_mm - error_mm..range.to_mm + error_mm).contains(&distance_mm);
            if !matters && near.normal.dot(press) >= MIN_COSINE && self.solid.is_closed() {
                return near;
            }
            reach_mm = abs(distance_mm) + error_mm;
        }
        last.work += EXACT_WORK;
        self.nearest(x_mm, press, reach_mm, last)
            .or_else(|| self.nearest(x_mm, press, farthest_mm, last))
            .unwrap_or(Near { distance_mm: farthest_mm, normal: press, curvature_per_mm: 0.0 })
    }
}

impl Exact<'_> {
    #[inline]
    fn nearest(&self, x_mm: DVec3, press: DVec3, reach_mm: f64, last: &mut Last) -> Option<Near> {
        let facing = Facing { direction: press, least_cosine: MIN_COSINE };
        let found = self.solid.closest_facing(x_mm, &facing, reach_mm, Some(last.triangle))?;
        last.triangle = found.triangle;
        let slope = self.relief.slope(self.solid, &found, x_mm - found.point_mm, self.field.gel_scale);
        Some(Near {
            distance_mm: found.distance_mm,
            normal: slope.normal,
            curvature_per_mm: slope.curvature_per_mm,
        })
    }
}

/// The press direction in the object's frame.
pub(super) fn press_in_object(placement: &Placement, press_direction: DVec3) -> DVec3 {
    placement.object_direction(press_direction)
}
