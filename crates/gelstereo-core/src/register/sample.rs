//! Even sampling of a mesh by dart throwing (Cook 1986).

use super::error::TemplateError;
use super::limits::{MAX_POINTS, MIN_POINTS};
use crate::math::random::Stream;
use crate::math::{DVec3, floor, sqrt};
use crate::stop::{Stop, ask};
use crate::surface::{TriangleMesh, area_vector};
use alloc::vec::Vec;

/// Darts per wanted point. Random discs of diameter r jam at a coverage of 0.547 (Feder 1980), which is
/// 0.70 A / r² points on an area A; this many darts reach 0.66.
const DARTS_PER_POINT: f64 = 30.0;
/// Least point distance in spacings, which gives one point per spacing², as 0.66 / 0.81² = 1.
const MIN_DISTANCE: f64 = 0.81;

/// Points and unit normals, sampled evenly on the mesh.
pub(super) fn evenly(
    mesh: &TriangleMesh,
    spacing_mm: f64,
    seed: u64,
    stop: Stop<'_>,
) -> Result<(Vec<DVec3>, Vec<DVec3>), TemplateError> {
    let cumulative_mm2 = cumulative_areas(mesh);
    let area_mm2 = cumulative_mm2.last().copied().unwrap_or(0.0);
    if !(spacing_mm.is_finite() && spacing_mm > 0.0) {
        let (low, high) = mesh.bounds_mm();
        return Err(TemplateError::Spacing { found_mm: spacing_mm, extent_mm: (high - low).max_element() });
    }
    let expected = area_mm2 / spacing_mm / spacing_mm;
    if expected.is_nan() || expected > MAX_POINTS as f64 {
        return Err(TemplateError::TooMany { found: expected, spacing_mm });
    }
    if expected < MIN_POINTS as f64 {
        return Err(TemplateError::TooFew { found: expected as usize, min_points: MIN_POINTS });
    }
    let mut random = Stream::new(seed, "template");
    let mut darts = Darts::new(MIN_DISTANCE * spacing_mm, expected as usize);
    for dart in 0..(expected * DARTS_PER_POINT) as usize {
        ask(stop, dart)?;
        // Every dart draws three numbers, accepted or not.
        let (pick, u, v) = (random.uniform() * area_mm2, random.uniform(), random.uniform());
        let triangle = cumulative_mm2.partition_point(|&sum| sum <= pick).min(cumulative_mm2.len() - 1);
        let corners = mesh.triangles()[triangle].map(|i| mesh.vertices_mm()[i as usize]);
        let area = area_vector(&corners);
        let length = sqrt(area.length_squared());
        if length > 0.0 {
            darts.throw(inside(&corners, u, v), area / length);
        }
    }
    Ok((darts.points_mm, darts.normals))
}

fn cumulative_areas(mesh: &TriangleMesh) -> Vec<f64> {
    let mut sum = 0.0;
    mesh.corners()
        .map(|corners| {
            sum += sqrt(area_vector(&corners).length_squared());
            sum
        })
        .collect()
}

/// The point of a triangle for two uniform numbers, uniform by area.
fn inside([a, b, c]: &[DVec3; 3], u: f64, v: f64) -> DVec3 {
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    *a + (*b - *a) * u + (*c - *a) * v
}

/// End of a list.
const NONE: u32 = u32::MAX;

/// Accepted points, in cells as wide as their least distance.
struct Darts {
    min_mm: f64,
    /// Last point of each hash list of cells. Collisions cost time but do not change the result, because
    /// points of other cells are too far away.
    last: Vec<u32>,
    /// The previous point in the list of each point.
    before: Vec<u32>,
    points_mm: Vec<DVec3>,
    normals: Vec<DVec3>,
}

impl Darts {
    /// Sized for about `expected` points.
    fn new(min_mm: f64, expected: usize) -> Self {
        let last = alloc::vec![NONE; (2 * expected).next_power_of_two()];
        Self { min_mm, last, before: Vec::new(), points_mm: Vec::new(), normals: Vec::new() }
    }

    fn throw(&mut self, point: DVec3, normal: DVec3) {
        let at = point.to_array().map(|x| x / self.min_mm);
        let cells = at.map(nearest_cells);
        if self.is_free(&cells, point, normal) {
            let list = self.list(cells.map(|along| along[0]));
            self.before.push(self.last[list]);
            self.last[list] = self.points_mm.len() as u32;
            self.points_mm.push(point);
            self.normals.push(normal);
        }
    }

    /// The list of a cell: a hash with odd, patternless multipliers.
    fn list(&self, [x, y, z]: [i64; 3]) -> usize {
        let mixed = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
            ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F)
            ^ (z as u64).wrapping_mul(0x1656_67B1_9E37_79F9);
        (mixed >> 32) as usize & (self.last.len() - 1)
    }

    /// Faces of different orientation are sampled separately, so that edges stay sharp and thin plates
    /// two-sided.
    fn is_free(&self, [x, y, z]: &[[i64; 3]; 3], point: DVec3, normal: DVec3) -> bool {
        let min_squared = self.min_mm * self.min_mm;
        let blocks = |k: usize| {
            self.points_mm[k].distance_squared(point) < min_squared && self.normals[k].dot(normal) > 0.5
        };
        let in_list = |list: usize| {
            let mut k = self.last[list];
            while k != NONE {
                if blocks(k as usize) {
                    return true;
                }
                k = self.before[k as usize];
            }
            false
        };
        // Nearest cells first: almost all darts are too close to a point, most of them in their own cell.
        !NEAREST_FIRST.iter().any(|&[i, j, k]| in_list(self.list([x[i], y[j], z[k]])))
    }
}

/// Index triples along three axes, each 0 to 2, ordered by their sum.
const NEAREST_FIRST: [[usize; 3]; 27] = {
    let (mut out, mut count, mut sum) = ([[0; 3]; 27], 0, 0);
    while sum <= 6 {
        let mut place = 0;
        while place < 27 {
            let [i, j, k] = [place % 3, place / 3 % 3, place / 9];
            if i + j + k == sum {
                out[count] = [i, j, k];
                count += 1;
            }
            place += 1;
        }
        sum += 1;
    }
    out
};

/// Along one axis: the cell of a coordinate in cell units, the neighbour on the nearer side, and the
/// other one.
fn nearest_cells(at: f64) -> [i64; 3] {
    let below = floor(at);
    let cell = below as i64;
    let (low, high) = (cell.saturating_sub(1), cell.saturating_add(1));
    if at - below < 0.5 { [cell, low, high] } else { [cell, high, low] }
}
