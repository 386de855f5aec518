//! The soft nearest neighbour of FilterReg (Gao and Tedrake 2019, Eq. 8): exact Gaussian sums over the
//! template.

use crate::math::{DVec3, exp_nonpositive, ln, sqrt};
use crate::register::blocks::{Block, LANES, Lanes};
use crate::register::observe::Sighting;
use crate::register::template::Template;
use core::array;

/// Gaussian-weighted view of the template from a point, with width σ and p_k ∝ exp(-|y_k - x|² / 2σ²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftMatch {
    /// ln Σ exp(-|y_k - x|² / 2σ²). Finite at any distance of the template unless σ² underflows; never NaN.
    pub log_mass: f64,
    /// m - x, with m = Σ p_k y_k.
    pub offset_mm: DVec3,
    /// Σ p_k |y_k - m|².
    pub spread_mm2: f64,
    /// Unit mean normal Σ p_k n_k; the nearest point's if that vanishes.
    pub normal: DVec3,
    /// Σ p_k n_k·(y_k - x), the mean distance to the planes of the template's points.
    pub plane_distance_mm: f64,
    /// Index of the nearest point.
    pub nearest: usize,
    /// Distance of the nearest point.
    pub distance_mm: f64,
}

impl SoftMatch {
    /// The point's row of the linear system.
    ///
    /// On a curved surface n̂·(m - x) is too short by κ σ² and Σ p n·(y - x) too long by as much. Their
    /// mean, the distance along the mean of the two points' normals, is accurate to second order
    /// (Rusinkiewicz 2019).
    pub(super) fn sighting(&self, template: &Template, lever: DVec3, weight: f64, sigma_mm: f64) -> Sighting {
        let along = self.normal.dot(self.offset_mm);
        Sighting {
            lever,
            normal: self.normal,
            residual: 0.5 * (along + self.plane_distance_mm),
            weight,
            normal_variance: template.step_variance(self.nearest, self.offset_mm, sigma_mm),
        }
    }
}

/// Log of the share of a sum that may be omitted. e^-28 = 7e-13 of a distance is far below the accuracy
/// of measured f64 coordinates.
const LOG_LEFT_OUT: f64 = -28.0;

/// The soft match of `point` (object frame) at width `sigma_mm`.
///
/// Sums are relative to the nearest point's term, so that none underflows. A block is omitted only if all
/// its terms are below e^-28 / N of the nearest point's. That term is part of the sum, so at most N
/// omitted points weigh less than e^-28 = 7e-13 of it. On a surface, where the sum beyond the radius R is
/// e^(-R²/2σ²) of the whole, they weigh less than e^-28 / N.
#[must_use]
pub fn soft_match(template: &Template, point: DVec3, sigma_mm: f64) -> SoftMatch {
    let (tree, blocks) = (template.tree(), template.blocks());
    let (nearest, min_squared) = tree.nearest(point).unwrap_or((0, 0.0));
    let twice_variance = 2.0 * sigma_mm * sigma_mm;
    let reach = min_squared + twice_variance * (ln(template.points_mm().len() as f64) - LOG_LEFT_OUT);
    let mut sums = Sums::new(point, template.points_mm()[nearest], min_squared, twice_variance);
    tree.ranges(point, reach, &mut |range| {
        blocks[range.start / LANES..range.end.div_ceil(LANES)].iter().for_each(|block| sums.add(block));
    });
    sums.soft_match(template, nearest)
}

/// Weighted moments about the nearest point.
///
/// The nearest point has the largest weight, p₀ >= 1/N of the whole, and offset 0. By Cauchy-Schwarz
/// |Σ p e|² <= (1 - p₀) Σ p |e|². The cancellation loss of Σ p |e|² - |Σ p e|² is therefore bounded by
/// 1/p₀; with the nearest point alone both are exactly 0.
struct Sums {
    point: DVec3,
    origin: DVec3,
    min_squared: f64,
    /// 1 / 2σ².
    rate: f64,
    twice_variance: f64,
    mass: Lanes,
    offset: [Lanes; 3],
    squared: Lanes,
    normal: [Lanes; 3],
    plane: Lanes,
}

impl Sums {
    fn new(point: DVec3, origin: DVec3, min_squared: f64, twice_variance: f64) -> Self {
        // A width whose square underflows uses only the nearest point.
        let rate = (1.0 / twice_variance).min(f64::MAX);
        let zero = [0.0; LANES];
        Self {
            point,
            origin,
            min_squared,
            rate,
            twice_variance,
            mass: zero,
            offset: [zero; 3],
            squared: zero,
            normal: [zero; 3],
            plane: zero,
        }
    }

    #[inline(always)]
    fn add(&mut self, block: &Block) {
        let (x, n) = (&block.points_mm, &block.normals);
        let (point, origin) = (self.point.to_array(), self.origin.to_array());
        let from: [Lanes; 3] = array::from_fn(|axis| each(|k| x[axis][k] - point[axis]));
        let offset: [Lanes; 3] = array::from_fn(|axis| each(|k| x[axis][k] - origin[axis]));
        let distance_squared = dot(&from, &from);
        let weight = each(|k| exp_nonpositive((self.min_squared - distance_squared[k]) * self.rate));
        for k in 0..LANES {
            self.mass[k] += weight[k];
        }
        for axis in 0..3 {
            add(&mut self.offset[axis], &weight, &offset[axis]);
            add(&mut self.normal[axis], &weight, &n[axis]);
        }
        add(&mut self.squared, &weight, &dot(&offset, &offset));
        add(&mut self.plane, &weight, &dot(n, &from));
    }

    fn soft_match(&self, template: &Template, nearest: usize) -> SoftMatch {
        let mass = total(&self.mass);
        let from_origin = DVec3::from_array(self.offset.map(|lanes| total(&lanes))) / mass;
        let mean_normal = DVec3::from_array(self.normal.map(|lanes| total(&lanes))) / mass;
        let length = sqrt(mean_normal.length_squared());
        // The term of a coincident point is 1, even if σ² underflows.
        let exponent = if self.min_squared > 0.0 { self.min_squared / self.twice_variance } else { 0.0 };
        SoftMatch {
            log_mass: ln(mass) - exponent,
            offset_mm: (self.origin - self.point) + from_origin,
            spread_mm2: (total(&self.squared) / mass - from_origin.length_squared()).max(0.0),
            normal: if length > 1e-6 { mean_normal / length } else { template.normals()[nearest] },
            plane_distance_mm: total(&self.plane) / mass,
            nearest,
            distance_mm: sqrt(self.min_squared),
        }
    }
}

fn total(lanes: &Lanes) -> f64 {
    lanes.iter().sum()
}

#[inline(always)]
fn each(of: impl FnMut(usize) -> f64) -> Lanes {
    array::from_fn(of)
}

#[inline(always)]
fn dot(a: &[Lanes; 3], b: &[Lanes; 3]) -> Lanes {
    each(|k| a[0][k] * b[0][k] + a[1][k] * b[1][k] + a[2][k] * b[2][k])
}

#[inline(always)]
fn add(sum: &mut Lanes, weight: &Lanes, value: &Lanes) {
    for k in 0..LANES {
        sum[k] += weight[k] * value[k];
    }
}
