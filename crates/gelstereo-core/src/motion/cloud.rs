//! The markers of a frame as points and surface elements.

use crate::force::MovedMarkers;
use crate::lattice::Topology;
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, Factor};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Squared deviation, in variances, up to which a third difference is noise: four standard deviations.
const NOISE: f64 = 16.0;

/// A marker in contact.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Element {
    /// Whether it is in contact and seen, with a valid covariance.
    pub is_used: bool,
    pub point_mm: DVec3,
    pub covariance_mm2: DMat3,
    /// Unit normal towards the camera; zero if too few neighbours are in contact.
    pub normal: DVec3,
    /// Variance of the normal along each tangent.
    pub normal_variance: f64,
    /// The part of it by what is not quadratic in the surface.
    pub sharpness: f64,
    /// Whether four markers in its row and in its column tell how far the surface is from quadratic.
    pub is_checked: bool,
}

impl Element {
    pub fn has_normal(&self) -> bool {
        self.is_used && self.normal != DVec3::ZERO
    }
}

/// Markers of one frame, row by row.
#[derive(Clone, Debug)]
pub(super) struct Cloud {
    pub elements: Vec<Element>,
    topology: Topology,
    /// Towards the camera.
    up: DVec3,
}

impl Cloud {
    pub fn new(topology: Topology, up: DVec3) -> Self {
        let mut elements = Vec::new();
        elements.resize(topology.places(), Element::default());
        Self { elements, topology, up }
    }

    pub fn copy(&mut self, other: &Self) {
        self.elements.copy_from_slice(&other.elements);
    }

    pub fn fill(&mut self, moved: &MovedMarkers<'_>) {
        for (i, element) in self.elements.iter_mut().enumerate() {
            let (point_mm, covariance) = (moved.points_mm[i], &moved.covariance_mm2[i]);
            let is_seen = moved.patch[i] && moved.state[i] == MarkerState::Seen && point_mm.is_finite();
            let is_used = is_seen && is_valid(covariance);
            let covariance_mm2 = DMat3::from_cols_array_2d(covariance);
            *element = Element { is_used, point_mm, covariance_mm2, ..Element::default() };
        }
        for i in 0..self.elements.len() {
            if let Some((normal, variance, sharpness)) = self.normal(i) {
                let element = &mut self.elements[i];
                (element.normal, element.is_checked) = (normal, sharpness.is_some());
                element.sharpness = sharpness.unwrap_or(0.0);
                element.normal_variance = variance + element.sharpness;
            }
        }
    }

    /// Mean position of the markers in contact; `None` without any.
    pub fn centroid_mm(&self) -> Option<DVec3> {
        let used = || self.elements.iter().filter(|e| e.is_used);
        let count = used().count();
        (count > 0).then(|| used().map(|e| e.point_mm).sum::<DVec3>() / count as f64)
    }

    /// Normal of the surface at a marker, from differences along its row and down, between nearest
    /// neighbours. They are exact for quadratic surfaces. With the variance by noise and, if it is known, by
    /// what is not quadratic.
    fn normal(&self, i: usize) -> Option<(DVec3, f64, Option<f64>)> {
        let element = self.elements.get(i).filter(|e| e.is_used)?;
        let from = self.topology.row_and_col(i);
        let line = |axis| move |k: isize| self.used_at(self.topology.step_from(from, axis, k)?);
        let along = line(0);
        let (u, share_u) = slope(&along)?;
        let downwards = (1..self.topology.axes()).map(line);
        let (down, (v, share_v)) = downwards.map(|down| slope(&down).map(|v| (down, v))).find_map(|it| it)?;
        let normal = u.cross(v).try_normalize()?;
        let normal = if normal.dot(self.up) < 0.0 { -normal } else { normal };
        let variance = normal.dot(element.covariance_mm2 * normal);
        let angle = (share_u / u.length_squared()).max(share_v / v.length_squared());
        let sharp = |at: &dyn Fn(isize) -> Option<DVec3>, step: DVec3| {
            Some(sharpness(at, normal, variance)? / step.length_squared())
        };
        let sharpness = sharp(&along, u).zip(sharp(&down, v)).map(|(u, v)| u.max(v));
        Some((normal, variance * angle, sharpness))
    }

    fn used_at(&self, i: usize) -> Option<DVec3> {
        self.elements.get(i).filter(|e| e.is_used).map(|e| e.point_mm)
    }

    /// Whether a neighbour is not in contact, or missing.
    pub fn is_border(&self, i: usize) -> bool {
        let touching = self.topology.neighbours(i).filter(|&k| self.elements[k].is_used);
        touching.count() < 2 * self.topology.axes()
    }
}

/// Derivative for one marker distance, from three markers in a row, with the sum of its squared weights.
fn slope(at: &impl Fn(isize) -> Option<DVec3>) -> Option<(DVec3, f64)> {
    if let (Some(before), Some(after)) = (at(-1), at(1)) {
        return Some(((after - before) * 0.5, 0.5));
    }
    for side in [1, -1] {
        if let (Some(zero), Some(one), Some(two)) = (at(0), at(side), at(2 * side)) {
            let outward = (one * 4.0 - zero * 3.0 - two) * 0.5;
            return Some((outward * side as f64, 6.5));
        }
    }
    None
}

/// Squared error of [`slope`] along the normal by what is not quadratic: a third of the third difference of
/// four markers in a row at most, without its noise. `None` without four markers.
fn sharpness(at: &dyn Fn(isize) -> Option<DVec3>, normal: DVec3, variance: f64) -> Option<f64> {
    let third = |first: isize| {
        Some((at(first + 3)? - at(first)? + (at(first + 1)? - at(first + 2)?) * 3.0).dot(normal))
    };
    let largest = (-3..=0).filter_map(third).map(|x| x * x).reduce(f64::max)?;
    // The variance of a third difference is 20 times that of a marker.
    Some(((largest - NOISE * 20.0 * variance) / 9.0).max(0.0))
}

fn is_valid(covariance: &Symmetric<3>) -> bool {
    covariance.as_flattened().iter().all(|x| x.is_finite()) && Factor::new(covariance).is_some()
}

/// Mean distance of neighbours in a row.
pub(super) fn pitch_mm(points_mm: &[DVec3], cols: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for row in points_mm.chunks_exact(cols.max(1)) {
        for pair in row.windows(2) {
            sum += pair[0].distance(pair[1]);
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sqrt;
    use proptest::prelude::*;

    const SIDE: usize = 9;
    const PITCH_MM: f64 = 0.9;

    proptest! {
        /// Normals of quadratic surfaces are exact inside the contact, whatever the print's layout.
        #[test]
        fn normals_of_quadratic_surfaces_are_exact(
            hexagonal in any::<bool>(), forward in any::<bool>(),
            slopes in prop::array::uniform2(-0.3..0.3_f64), curves in prop::array::uniform3(-0.1..0.1_f64),
        ) {
            let square = Topology::square(SIDE, SIDE);
            let topology = if hexagonal { Topology::hexagonal(SIDE, SIDE, forward) } else { square };
            let row_mm = PITCH_MM * if hexagonal { sqrt(0.75) } else { 1.0 };
            let points_mm: Vec<DVec3> = (0..topology.places())
                .map(|i| {
                    let (x, y) = (PITCH_MM * topology.along(i), row_mm * (i / SIDE) as f64);
                    let quadratic = curves[0] * x * x + curves[1] * x * y + curves[2] * y * y;
                    DVec3::new(x, y, 30.0 + slopes[0] * x + slopes[1] * y + quadratic)
                })
                .collect();
            let count = points_mm.len();
            let covariance = DMat3::from_diagonal(DVec3::splat(1e-6)).to_cols_array_2d();
            let mut cloud = Cloud::new(topology, DVec3::NEG_Z);
            cloud.fill(&MovedMarkers {
                points_mm: &points_mm,
                covariance_mm2: &alloc::vec![covariance; count],
                state: &alloc::vec![MarkerState::Seen; count],
                patch: &alloc::vec![true; count],
            });
            for (i, element) in cloud.elements.iter().enumerate() {
                let DVec3 { x, y, .. } = points_mm[i];
                let right = slopes[0] + 2.0 * curves[0] * x + curves[1] * y;
                let down = slopes[1] + curves[1] * x + 2.0 * curves[2] * y;
                let normal = DVec3::new(right, down, -1.0).normalize();
                prop_assert!(element.normal.distance(normal) < 1e-9, "{i}: {} for {normal}", element.normal);
                let is_inside = topology.neighbours(i).count() == 2 * topology.axes();
                prop_assert_eq!(cloud.is_border(i), !is_inside);
            }
        }
    }
}
