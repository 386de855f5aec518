//! Cubic polynomials for values over the tiles of a square, and linear ones for their derivatives.

use super::chebyshev::{Series, checks, extremes, roots};
use crate::math::DVec3;
use alloc::vec::Vec;

/// Terms of a cubic polynomial in three variables, and nodes along each of them.
const TERMS: usize = 20;
const NODES: usize = 4;
/// Points along each variable at which a tile is checked.
const CHECKS: usize = 5;

/// X, Y, Z and row difference: four numbers with the same arithmetic.
pub(super) type Four = [f64; 4];

/// Polynomials over [-1, 1]³, divided into tiles along the first two variables.
#[derive(Clone, Debug, Default)]
pub(super) struct Tiles {
    side: usize,
    tiles: Vec<Tile>,
}

#[derive(Clone, Debug)]
struct Tile {
    /// Coefficients of x^a y^b z^c, all exponents falling, the first variable's fastest.
    values: [Four; TERMS],
    /// Coefficients of the derivatives by each input: 1, x, y, z.
    slopes: [[Four; 3]; 4],
}

impl Tiles {
    /// Reserves memory for `side` tiles along each of two variables.
    pub fn with_room(side: usize) -> Self {
        Self { side: 0, tiles: Vec::with_capacity(side * side) }
    }

    /// Divides the square into `side` * `side` tiles that approximate `values` and `slopes`. Returns
    /// their largest distance from `values`, or `None` where one exceeds `tolerance_mm`.
    pub fn fit(
        &mut self,
        side: usize,
        values: &Series<4>,
        slopes: &Series<12>,
        tolerance_mm: f64,
    ) -> Option<f64> {
        let mut worst_mm = 0.0_f64;
        (self.side, _) = (side, self.tiles.clear());
        for n in 0..side * side {
            let axis = |local: f64, tile: usize| (local + (2 * tile + 1) as f64) / side as f64 - 1.0;
            let tile = Tile::fit(&places(roots(), n % side, n / side, axis), values, slopes);
            let mut locals = checks::<CHECKS>();
            values.on_grid(&places(extremes::<CHECKS>(), n % side, n / side, axis), |value| {
                if let Some(local) = locals.next() {
                    worst_mm = worst_mm.max(distance(&tile.value(local), &value));
                }
            });
            if !(worst_mm <= tolerance_mm) {
                return None;
            }
            self.tiles.push(tile);
        }
        Some(worst_mm)
    }

    /// The values and their derivatives by each input, or `None` outside the cube.
    #[inline(always)]
    pub fn at(&self, input: DVec3) -> Option<(Four, [Four; 3])> {
        if !(input.abs().max_element() <= 1.0) {
            return None;
        }
        let scaled = (input + 1.0) * (0.5 * self.side as f64);
        let last = self.side - 1;
        let (col, row) = ((scaled.x as usize).min(last), (scaled.y as usize).min(last));
        let tile = self.tiles.get(row * self.side + col)?;
        let (x, y) = (2.0 * (scaled.x - col as f64) - 1.0, 2.0 * (scaled.y - row as f64) - 1.0);
        let local = DVec3::new(x, y, input.z);
        Some((tile.value(local), tile.slope(local)))
    }
}

impl Tile {
    /// Fits a tile whose nodes have these coordinates in the whole.
    fn fit(nodes: &[[f64; NODES]; 3], values: &Series<4>, slopes: &Series<12>) -> Self {
        let values = on_nodes(values, nodes);
        let slopes = on_nodes(slopes, nodes);
        let mut tile = Self { values: [[0.0; 4]; TERMS], slopes: [[[0.0; 4]; 3]; 4] };
        for (n, (_, coefficients)) in Series::fit::<NODES, _>(3, values.iter()).powers().enumerate() {
            tile.values[TERMS - 1 - n] = coefficients;
        }
        for (exponents, coefficients) in Series::fit::<NODES, _>(1, slopes.iter()).powers() {
            let place = exponents.iter().position(|&exponent| exponent > 0).map_or(0, |axis| axis + 1);
            for (by, four) in tile.slopes[place].iter_mut().zip(coefficients.chunks_exact(4)) {
                by.copy_from_slice(four);
            }
        }
        tile
    }

    /// Nested Horner schemes in z, y and x.
    #[inline]
    fn value(&self, at: DVec3) -> Four {
        let c = &self.values;
        let line = |first: usize, terms: usize| {
            c[first + 1..first + terms].iter().fold(c[first], |sum, next| multiply_add(&sum, at.x, next))
        };
        let by_y = |sum: &Four, next: Four| multiply_add(sum, at.y, &next);
        let z2 = by_y(&c[1], line(2, 2));
        let z1 = by_y(&by_y(&c[4], line(5, 2)), line(7, 3));
        let z0 = by_y(&by_y(&by_y(&c[10], line(11, 2)), line(13, 3)), line(16, 4));
        let high = multiply_add(&multiply_add(&c[0], at.z, &z2), at.z, &z1);
        multiply_add(&high, at.z, &z0)
    }

    #[inline]
    fn slope(&self, at: DVec3) -> [Four; 3] {
        let [constant, by_x, by_y, by_z] = &self.slopes;
        core::array::from_fn(|k| {
            let plane = multiply_add(&by_x[k], at.x, &constant[k]);
            multiply_add(&by_z[k], at.z, &multiply_add(&by_y[k], at.y, &plane))
        })
    }
}

/// Coordinates along all three variables of a tile in this column and row.
fn places<const M: usize>(
    local: [f64; M],
    col: usize,
    row: usize,
    axis: impl Fn(f64, usize) -> f64,
) -> [[f64; M]; 3] {
    [local.map(|x| axis(x, col)), local.map(|y| axis(y, row)), local]
}

fn on_nodes<const N: usize>(
    series: &Series<N>,
    nodes: &[[f64; NODES]; 3],
) -> [[f64; N]; NODES * NODES * NODES] {
    let mut found = [[0.0; N]; NODES * NODES * NODES];
    let mut all = found.iter_mut();
    series.on_grid(nodes, |values| {
        if let Some(found) = all.next() {
            *found = values;
        }
    });
    found
}

/// Distance of two points.
pub(super) fn distance(a: &Four, b: &Four) -> f64 {
    DVec3::from_slice(a).distance(DVec3::from_slice(b))
}

/// a x + b
#[inline]
pub(super) fn multiply_add(a: &Four, x: f64, b: &Four) -> Four {
    [a[0] * x + b[0], a[1] * x + b[1], a[2] * x + b[2], a[3] * x + b[3]]
}
