//! Cubic polynomials over the tiles of a square, for values, and linear ones for their derivatives.

use super::chebyshev::{Series, checks, nodes};
use crate::math::DVec3;
use alloc::vec::Vec;

/// Terms of a cubic polynomial in three variables, and nodes along each of them.
const TERMS: usize = 20;
const NODES: usize = 4;
/// Points along each variable at which a tile is checked.
const CHECKS: usize = 5;

/// X, Y, Z and row difference: four numbers that go through the same arithmetic.
pub(super) type Four = [f64; 4];

/// Polynomials over [-1, 1]³, which is cut along the first two variables.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    side: usize,
    tiles: Vec<Tile>,
}

#[derive(Clone, Debug)]
struct Tile {
    /// Of x^a y^b z^c, all exponents falling, the first variable's fastest.
    values: [Four; TERMS],
    /// Of the derivatives by each input: 1, x, y, z.
    slopes: [[Four; 3]; 4],
}

impl Tiles {
    /// `side` * `side` tiles that follow `values` and `slopes`, or `None` where one of them is farther from `values` than
    /// `tolerance_mm`.
    pub fn fit(
        side: usize,
        values: &Series<4>,
        slopes: &Series<12>,
        tolerance_mm: f64,
    ) -> Option<(Self, f64)> {
        let (mut tiles, mut worst_mm) = (Vec::with_capacity(side * side), 0.0_f64);
        for n in 0..side * side {
            let place = |local: DVec3| {
                let at = |x: f64, tile: usize| (x + (2 * tile + 1) as f64) / side as f64 - 1.0;
                DVec3::new(at(local.x, n % side), at(local.y, n / side), local.z)
            };
            let tile = Tile::fit(|local| values.at(place(local)), |local| slopes.at(place(local)));
            for local in checks::<CHECKS>() {
                let off = DVec3::from_slice(&tile.value(local)) - DVec3::from_slice(&values.at(place(local)));
                worst_mm = worst_mm.max(off.length());
            }
            if !(worst_mm <= tolerance_mm) {
                return None;
            }
            tiles.push(tile);
        }
        Some((Self { side, tiles }, worst_mm))
    }

    /// The values and their derivatives by each input, or `None` beyond the cube.
    #[inline]
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
    fn fit(value: impl Fn(DVec3) -> Four, slope: impl Fn(DVec3) -> [f64; 12]) -> Self {
        let values: Vec<Four> = nodes::<NODES>().map(value).collect();
        let slopes: Vec<[f64; 12]> = nodes::<NODES>().map(slope).collect();
        let mut tile = Self { values: [[0.0; 4]; TERMS], slopes: [[[0.0; 4]; 3]; 4] };
        for (n, (_, coefficients)) in Series::fit::<NODES>(3, &values).powers().enumerate() {
            tile.values[TERMS - 1 - n] = coefficients;
        }
        for (exponents, coefficients) in Series::fit::<NODES>(1, &slopes).powers() {
            let place = exponents.iter().position(|&exponent| exponent > 0).map_or(0, |axis| axis + 1);
            for (by, four) in tile.slopes[place].iter_mut().zip(coefficients.chunks_exact(4)) {
                by.copy_from_slice(four);
            }
        }
        tile
    }

    /// Horner's scheme in z, of schemes in y, of schemes in x.
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

/// a x + b
#[inline]
pub(super) fn multiply_add(a: &Four, x: f64, b: &Four) -> Four {
    [a[0] * x + b[0], a[1] * x + b[1], a[2] * x + b[2], a[3] * x + b[3]]
}
