//! Covariance of the pixels of a support: w I + g (G ⊗ G) with the grain's G(d) = exp(-d² / (4 l²)).
//!
//! A support is symmetric left to right and up and down, and so is the covariance. Parts that are even or
//! odd in either direction are therefore uncorrelated (as for any functions with a symmetry: Serre,
//! Linear Representations of Finite Groups, section 2.6). A system of n pixels splits into four of a
//! quarter each, on the pixels of one quadrant, with a sixteenth of the products to factor. The system
//! odd in x is that odd in y, transposed.

use super::cholesky::Cholesky;
use super::support::Support;
use crate::detect::centre::noise::Noise;
use crate::math::exp;
use alloc::vec::Vec;
use core::f64::consts::FRAC_1_SQRT_2;

/// Least assumed white noise relative to the spectrum at frequency zero. With grain alone the weights
/// would oscillate between neighbouring pixels.
const MIN_SHARE: f64 = 0.03;
/// Columns that are summed at a time.
const LANES: usize = 8;

/// Even (0) or odd (1) from left to right, and from top to bottom.
pub(super) const PARITIES: [[usize; 2]; 4] = [[0, 0], [0, 1], [1, 0], [1, 1]];

/// One of the systems, with a given parity along each axis.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Distances from the middle along both axes.
    pixels: Vec<[u8; 2]>,
    cholesky: Cholesky,
}

/// The covariance, and solution of systems with it.
#[derive(Clone, Debug, Default)]
pub(super) struct Covariance {
    side: usize,
    /// G between two distances from the middle along one axis, for even and for odd parts.
    between: [Vec<f64>; 2],
    /// Even and even, even and odd, odd and odd.
    blocks: [Block; 3],
    /// G from the farthest pixel on one side to that on the other, and zeros for the last lanes.
    alike: Vec<f64>,
    rows: Vec<f64>,
}

impl Covariance {
    /// Reserves memory for supports of at most `side` pixels per side.
    pub fn reserve(&mut self, side: usize) {
        let quarter = (side / 2 + 1) * (side / 2 + 1);
        for list in &mut self.between {
            list.clear();
            list.reserve(quarter);
        }
        for Block { pixels, cholesky } in &mut self.blocks {
            pixels.clear();
            pixels.reserve(quarter);
            cholesky.reserve(quarter);
        }
        self.alike.clear();
        self.alike.reserve(2 * side + LANES);
        self.rows.clear();
        self.rows.reserve(side * side.next_multiple_of(LANES));
    }

    /// Factors the covariance of this noise, normalised by the pixel variance, with enough white noise
    /// for smooth weights.
    pub fn factor(&mut self, support: Support, noise: &Noise) {
        let white = noise.white_levels2.max(MIN_SHARE * noise.spectrum(0.0));
        let all = white + noise.grain_levels2;
        let (white, grain) = (white / all, noise.grain_levels2 / all);
        self.side = support.side;
        self.measure(noise.grain_size_px);
        let (Self { between, blocks, .. }, half) = (self, support.half());
        for (Block { pixels, cholesky }, [a, b]) in blocks.iter_mut().zip([[0, 0], [0, 1], [1, 1]]) {
            pixels.clear();
            let all = (b..=half).flat_map(|v| (a..=half).map(move |u| [u, v]));
            pixels.extend(all.filter(|&[u, v]| support.has_at(u, v)).map(|at| at.map(|at| at as u8)));
            let (along, across) = (&between[a], &between[b]);
            cholesky.factor(pixels.len(), |i, j| {
                let ([u, v], [p, q]) = (pixels[i].map(usize::from), pixels[j].map(usize::from));
                let own = if i == j { white } else { 0.0 };
                own + grain * along[u * (half + 1) + p] * across[v * (half + 1) + q]
            });
        }
    }

    /// Computes the grain's G for this size, between pixels and between even or odd parts.
    fn measure(&mut self, grain_size_px: f64) {
        self.grain_of(grain_size_px);
        let Self { side, between, alike, .. } = self;
        let (half, at) = (*side / 2, |apart: usize| alike[*side - 1 + apart]);
        for (list, sign) in between.iter_mut().zip([1.0, -1.0]) {
            list.clear();
            let pairs = (0..=half).flat_map(|i| (0..=half).map(move |j| (i, j)));
            // The middle is its own mirror image.
            list.extend(
                pairs.map(|(i, j)| 2.0 * scale(i) * scale(j) * (at(i.abs_diff(j)) + sign * at(i + j))),
            );
        }
    }

    fn grain_of(&mut self, grain_size_px: f64) {
        let (last, per_l2) = (self.side - 1, 0.25 / (grain_size_px * grain_size_px));
        self.alike.clear();
        let apart = (0..=2 * last).map(|k| k.abs_diff(last));
        self.alike.extend(apart.map(|d| exp(-per_l2 * (d * d) as f64)));
        self.alike.resize(2 * last + 1 + LANES, 0.0);
    }

    /// Part of this parity of lists over all pixels of the square, for the pixels of [`Self::factor`]'s
    /// support.
    pub fn fold<const N: usize>(&self, parity: [usize; 2], lists: &[[f64; N]], out: &mut Vec<[f64; N]>) {
        out.clear();
        for (places, signs, scale) in self.mirrored(parity) {
            let [a, b, c, d] = places.map(|place| &lists[place]);
            let [_, left, up, both] = signs;
            out.push(core::array::from_fn(|k| scale * (a[k] + left * b[k] + up * c[k] + both * d[k])));
        }
    }

    /// Adds a part of this parity to lists over all pixels of the square.
    pub fn unfold<const N: usize>(
        &self,
        parity: [usize; 2],
        part: &[[f64; N]],
        mut add: impl FnMut(usize, [f64; N]),
    ) {
        for ((places, signs, scale), part) in self.mirrored(parity).zip(part) {
            for (place, sign) in places.into_iter().zip(signs) {
                add(place, part.map(|x| sign * scale * x));
            }
        }
    }

    /// For each pixel of a system: its index and those of its mirror images to the left, upwards and
    /// both; their signs; and the factor of each, for which folding preserves lengths.
    fn mirrored(&self, [x, y]: [usize; 2]) -> impl Iterator<Item = ([usize; 4], [f64; 4], f64)> {
        let (side, half, transposed) = (self.side, self.side / 2, x > y);
        let [left, up] = [x, y].map(|odd| if odd == 1 { -1.0 } else { 1.0 });
        self.blocks[x + y].pixels.iter().map(move |pixel| {
            let [u, v] = pixel.map(usize::from);
            let (u, v) = if transposed { (v, u) } else { (u, v) };
            let at = |u: usize, v: usize| v * side + u;
            let (right, below) = (half + u, half + v);
            let places = [at(right, below), at(half - u, below), at(right, half - v), at(half - u, half - v)];
            (places, [1.0, left, up, left * up], scale(u) * scale(v))
        })
    }

    /// L⁻¹ b for the parts of this parity of several b, in place, with C = L Lᵀ.
    pub fn forward<const N: usize>(&self, [x, y]: [usize; 2], right: &mut [[f64; N]]) {
        self.blocks[x + y].cholesky.forward(right);
    }

    /// L⁻ᵀ b, as [`Self::forward`].
    pub fn backward<const N: usize>(&self, [x, y]: [usize; 2], right: &mut [[f64; N]]) {
        self.blocks[x + y].cholesky.backward(right);
    }

    /// Variance of a sum with these weights over the support, per unit variance of grain of this size.
    pub fn grain_gain(&mut self, weights: &[f64], grain_size_px: f64) -> f64 {
        self.grain_of(grain_size_px);
        let (side, stride) = (self.side, self.side.next_multiple_of(LANES));
        let Self { alike, rows, .. } = self;
        rows.clear();
        rows.resize(side * stride, 0.0);
        for (weights, row) in weights.chunks_exact(side).zip(rows.chunks_exact_mut(stride)) {
            for (block, row) in row.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                let alike = alike[block * LANES..].windows(LANES).take(side).rev();
                *row = weighted(weights.iter().zip(alike));
            }
        }
        let mut gain = 0.0;
        for (y, weights) in weights.chunks_exact(side).enumerate() {
            for (block, weights) in weights.chunks(LANES).enumerate() {
                let rows = rows.chunks_exact(stride).map(|row| &row[block * LANES..]);
                let sums = weighted(alike[side - 1 - y..].iter().zip(rows));
                gain += weights.iter().zip(sums).map(|(weight, sum)| weight * sum).sum::<f64>();
            }
        }
        gain
    }
}

/// Factor of each of two mirror images along one axis; the middle counts as both.
const fn scale(from_middle: usize) -> f64 {
    if from_middle == 0 { 0.5 } else { FRAC_1_SQRT_2 }
}

/// Sum of the first numbers of lists, each list times its factor.
#[inline]
fn weighted<'a>(lists: impl Iterator<Item = (&'a f64, &'a [f64])>) -> [f64; LANES] {
    let mut sum = [0.0; LANES];
    for (share, list) in lists {
        let Some(list) = list.first_chunk::<LANES>() else { break };
        sum.iter_mut().zip(list).for_each(|(sum, x)| *sum += share * x);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec2;

    /// The solution by parts, multiplied by the full pixel covariance, gives back the right-hand side.
    #[test]
    fn what_is_solved_for_comes_back_by_the_product() {
        let mut covariance = Covariance::default();
        for (radius_px, grain_levels2) in [(2.5, 0.0), (4.0, 0.5), (7.3, 4.0), (11.9, 8.0)] {
            let support = Support::new(radius_px);
            let noise = Noise { white_levels2: 1.0, grain_levels2, grain_size_px: 1.3, gel_level: 0.0 };
            covariance.factor(support, &noise);
            let inside: Vec<bool> = support.places().map(|at| support.has(at)).collect();
            let v: Vec<[f64; 2]> = (0..)
                .zip(&inside)
                .map(|(n, &on)| if on { [f64::from(n % 7) - 2.5, f64::from(n % 11)] } else { [0.0; 2] })
                .collect();
            let (mut part, mut solution) = (Vec::new(), alloc::vec![[0.0; 2]; v.len()]);
            for parity in PARITIES {
                covariance.fold(parity, &v, &mut part);
                covariance.forward(parity, &mut part);
                covariance.backward(parity, &mut part);
                covariance.unfold(parity, &part, |place, x| {
                    solution[place].iter_mut().zip(x).for_each(|(sum, x)| *sum += x);
                });
            }
            let white = f64::max(1.0, MIN_SHARE * noise.spectrum(0.0));
            let places: Vec<DVec2> = support.places().collect();
            let between = |a: usize, b: usize| {
                let grain = grain_levels2 * exp(-0.25 * places[a].distance_squared(places[b]) / (1.3 * 1.3));
                (grain + if a == b { white } else { 0.0 }) / (white + grain_levels2)
            };
            // White noise is at least 3 % of the spectrum: a condition below 40, so that 500 sums of
            // round-off stay below 1e-11.
            for a in (0..v.len()).filter(|&a| inside[a]) {
                let back = |k: usize| (0..v.len()).map(|b| between(a, b) * solution[b][k]).sum::<f64>();
                assert!((0..2).all(|k| crate::math::abs(back(k) - v[a][k]) < 1e-11), "{radius_px} px");
            }
            assert!(solution.iter().zip(&inside).all(|(x, &inside)| inside || *x == [0.0; 2]));
        }
    }

    /// Against the sum over all pairs of pixels.
    #[test]
    fn the_gain_is_the_sum_over_all_pairs() {
        let (support, size_px) = (Support::new(5.2), 1.7);
        let mut covariance = Covariance::default();
        covariance.factor(support, &Noise { grain_size_px: 0.9, ..Noise::default() });
        let weights: Vec<f64> = (0..support.side * support.side).map(|n| (n % 13) as f64 - 5.0).collect();
        let alike = |a: DVec2, b: DVec2| exp(-0.25 * a.distance_squared(b) / (size_px * size_px));
        let pairs =
            support.places().zip(&weights).flat_map(|a| support.places().zip(&weights).map(move |b| (a, b)));
        let expected: f64 = pairs.map(|((a, x), (b, y))| x * y * alike(a, b)).sum();
        let found = covariance.grain_gain(&weights, size_px);
        assert!(crate::math::abs(found / expected - 1.0) < 1e-12, "{found} {expected}");
    }
}
