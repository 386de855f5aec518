//! Search for the symmetry axes of a surface.

use super::symmetry::Symmetry;
use crate::math::linalg::eigen;
use crate::math::{DVec3, Pose, sqrt};
use crate::stop::{Stop, Stopped, ask};
use crate::surface::{Solid, area_vector};
use alloc::vec::Vec;
use core::f64::consts::{PI, TAU};

/// Largest order searched.
const MAX_TURNS: u32 = 64;
/// Number of largest faces whose normals and sums of normals are candidate axes.
const MAX_NORMALS: usize = 24;
/// Normals within this cosine belong to one face.
const SAME: f64 = 1.0 - 1e-8;
/// Axes closer than this are duplicates: those perpendicular to an axis of order n are π / n apart.
const NEAREST_RAD: f64 = 0.5 * PI / MAX_TURNS as f64;
/// Rotations use multiples of the golden section, which belong to no finite order.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Points tested first for each rotation.
const FIRST_POINTS: usize = 256;

/// As [`super::Template::find_symmetries_unless`], for a surface and points on it.
pub(super) fn symmetries(
    solid: &Solid,
    points_mm: &[DVec3],
    tolerance_mm: f64,
    stop: Stop<'_>,
) -> Result<Vec<Symmetry>, Stopped> {
    let (centre_mm, moment) = moments(solid);
    let found = eigen(&moment);
    let trace: f64 = found.values.iter().sum();
    let is_eigenvector = |a: DVec3| {
        let image = DVec3::from_array(moment.map(|row| DVec3::from_array(row).dot(a)));
        sqrt((image - a * image.dot(a)).length_squared()) <= 1e-3 * trace
    };
    let all_alike = found.values[2] - found.values[0] <= 1e-3 * trace;
    let mut candidates = Vec::new();
    add_normals(&mut candidates, &largest_normals(solid, stop)?, all_alike);
    // Last: with degenerate moments they may be close to a true axis by chance, and would displace it.
    candidates.extend(found.vectors.iter().map(|&v| upright(DVec3::from_array(v))));
    let part = Part { solid, points_mm, tolerance_mm, stop };
    let mut axes: Vec<Symmetry> = Vec::new();
    for axis in candidates.into_iter().filter(|&a| is_eigenvector(a)) {
        let is_known =
            |known: &Symmetry| known.axis.cross(axis).length_squared() <= NEAREST_RAD * NEAREST_RAD;
        if axes.iter().any(is_known) {
            continue;
        }
        let candidate = Symmetry { axis, centre_mm, order: None };
        // Axes perpendicular to a continuous one are equivalent. After the first, only another continuous
        // one (a ball) counts.
        let has = |is_round: bool| axes.iter().any(|a| a.order.is_none() == is_round);
        let order = if has(true) && has(false) {
            part.is_round(candidate)?.then_some(None)
        } else {
            part.order(candidate)?
        };
        axes.extend(order.map(|order| Symmetry { order, ..candidate }));
    }
    if axes.iter().filter(|a| a.order.is_none()).count() > 1 {
        let every = [DVec3::X, DVec3::Y, DVec3::Z];
        return Ok(every.map(|axis| Symmetry { axis, centre_mm, order: None }).to_vec());
    }
    if let Some(round) = axes.iter().find(|a| a.order.is_none()).copied() {
        let across = axes.iter().find(|a| a.order.is_some()).copied();
        return Ok([Some(round), across].into_iter().flatten().collect());
    }
    // By descending order; the stable sort keeps the candidates' sequence of equals.
    axes.sort_by_key(|axis| core::cmp::Reverse(axis.order));
    Ok(axes)
}

struct Part<'a> {
    solid: &'a Solid,
    points_mm: &'a [DVec3],
    tolerance_mm: f64,
    stop: Stop<'a>,
}

impl Part<'_> {
    /// Order of the symmetry about an axis: `None` without symmetry, `Some(None)` if continuous.
    fn order(&self, axis: Symmetry) -> Result<Option<Option<u32>>, Stopped> {
        if self.is_round(axis)? {
            return Ok(Some(None));
        }
        // All multiples: a rotation by 1/17 maps sixteen facets nearly onto themselves; its eighth
        // multiple does not.
        let looks_the_same = |n: u32| {
            let step = TAU / f64::from(n);
            self.hold((1..=n / 2).map(|k| axis.turned(f64::from(k) * step)))
        };
        for n in (2..=MAX_TURNS).rev() {
            if looks_the_same(n)? {
                return Ok(Some(Some(n)));
            }
        }
        Ok(None)
    }

    /// Whether the part is unchanged by any rotation about an axis.
    ///
    /// Uses squared multiples, because 34 golden-section rotations return to within 1/75 of a turn. For
    /// up to 128 facets one of these rotations is at least a quarter facet off, where a facet deviates by
    /// 3/4 of its depth.
    fn is_round(&self, axis: Symmetry) -> Result<bool, Stopped> {
        self.hold((1..=8).map(|k| axis.turned(f64::from(k * k) * GOLDEN * TAU)))
    }

    /// Whether the part is unchanged by each of these rotations. A subset of points rejects most wrong
    /// ones first.
    fn hold(&self, turns: impl Iterator<Item = Pose>) -> Result<bool, Stopped> {
        let stride = self.points_mm.len().div_ceil(FIRST_POINTS);
        for turn in turns {
            if !(self.holds(&turn, stride)? && self.holds(&turn, 1)?) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Whether every `stride`-th point lies on the surface after a rotation.
    fn holds(&self, turn: &Pose, stride: usize) -> Result<bool, Stopped> {
        for (step, p) in self.points_mm.iter().step_by(stride).enumerate() {
            ask(self.stop, step)?;
            let turned = turn.transform_point(*p);
            if self.solid.closest_within(turned, self.tolerance_mm, None).is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// Centroid and second central moment of the area.
fn moments(solid: &Solid) -> (DVec3, [[f64; 3]; 3]) {
    let corners = |t: &[u32; 3]| t.map(|i| solid.vertices_mm()[i as usize]);
    let area = |c: &[DVec3; 3]| sqrt(area_vector(c).length_squared());
    let origin = solid.bounds_mm().0;
    let (mut total, mut sum) = (0.0, DVec3::ZERO);
    for [a, b, c] in solid.triangles().iter().map(corners) {
        let weight = area(&[a, b, c]);
        total += weight;
        sum += ((a - origin) + (b - origin) + (c - origin)) * (weight / 3.0);
    }
    let centre = origin + sum / total;
    let mut moment = [[0.0; 3]; 3];
    for [a, b, c] in solid.triangles().iter().map(corners) {
        let weight = area(&[a, b, c]) / (12.0 * total);
        let [a, b, c] = [a - centre, b - centre, c - centre];
        for v in [a, b, c, a + b + c] {
            for i in 0..3 {
                for j in 0..3 {
                    moment[i][j] += weight * v[i] * v[j];
                }
            }
        }
    }
    (centre, moment)
}

/// Distinct directions of the largest faces, ignoring sign.
fn largest_normals(solid: &Solid, stop: Stop<'_>) -> Result<Vec<DVec3>, Stopped> {
    let mut faces: Vec<(f64, DVec3)> = Vec::new();
    for (triangle, corners) in solid.triangles().iter().enumerate() {
        ask(stop, triangle)?;
        let normal = solid.face_normal(triangle as u32);
        if normal == DVec3::ZERO {
            continue;
        }
        let corners = corners.map(|i| solid.vertices_mm()[i as usize]);
        let area = sqrt(area_vector(&corners).length_squared());
        // Among the first ones only: a finely tessellated round part has no large faces.
        match faces.iter_mut().take(8 * MAX_NORMALS).find(|(_, n)| n.dot(normal).abs() > SAME) {
            Some(face) => face.0 += area,
            None => faces.push((area, upright(normal))),
        }
    }
    faces.sort_by(|a, b| b.0.total_cmp(&a.0));
    faces.truncate(MAX_NORMALS);
    Ok(faces.into_iter().map(|(_, normal)| normal).collect())
}

/// Adds normals, and sums of two and, if `triples`, of three of them.
fn add_normals(candidates: &mut Vec<DVec3>, normals: &[DVec3], triples: bool) {
    let mut add = |v: DVec3| {
        let length = sqrt(v.length_squared());
        if length > 1e-6 {
            candidates.push(upright(v / length));
        }
    };
    normals.iter().for_each(|&n| add(n));
    for (i, &a) in normals.iter().enumerate() {
        for (j, &b) in normals[..i].iter().enumerate() {
            add(a + b);
            add(a - b);
            for &c in normals[..j].iter().filter(|_| triples && i < 8) {
                for sum in [a + b + c, a + b - c, a - b + c, a - b - c] {
                    add(sum);
                }
            }
        }
    }
}

/// The vector or its opposite, whichever has a positive component of largest magnitude.
fn upright(v: DVec3) -> DVec3 {
    let largest = v
        .to_array()
        .into_iter()
        .fold(0.0, |largest: f64, x| if x.abs() > largest.abs() { x } else { largest });
    if largest < 0.0 { -v } else { v }
}
