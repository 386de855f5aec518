//! Which weights tell best where a blurred disc is.

use super::cholesky::Cholesky;
use super::disc::Disc;
use crate::detect::fit::{Factor, Noise};
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, exp};
use alloc::vec::Vec;

/// Parameters of one marker: centre, contrast, ground, its slopes, radius, two stretches, blur.
const COLUMNS: usize = 10;
const CONTRAST: usize = 2;
const RADIUS: usize = 6;
const STRETCHES: [usize; 2] = [7, 8];
const BLUR: usize = 9;
/// What is known of radius, stretches and blur before, px: it matters only where a small disc hardly tells them from its
/// contrast. First where they are asked for.
const PRIORS_PX: [f64; 2] = [1.0, 0.15];
/// Noise over contrast that goes with it.
const NOISE_SHARE: f64 = 1.0 / 40.0;
/// White noise that is assumed over that at the lowest frequency: in grain alone the weights would swing ever more between
/// neighbouring pixels.
const LEAST_SHARE: f64 = 0.03;
/// Columns that are summed at a time.
const LANES: usize = 8;
/// Most columns and rows of a support.
pub(super) const MOST_SIDE_PX: usize = 31;
/// Displacement at which the response's bend is measured.
const BEND_AT_PX: f64 = 0.3;

/// A square of pixels around the one nearest to the centre; those within a circle count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Support {
    pub side: usize,
    pub radius_px: f64,
}

impl Support {
    /// Pixels up to `radius_px` from the centre, wherever in the middle pixel that lies.
    pub fn new(radius_px: f64) -> Self {
        Self { side: 2 * (radius_px as usize) + 1, radius_px }
    }

    pub const fn half(self) -> usize {
        self.side / 2
    }

    /// Places of all pixels, row by row, relative to the middle one.
    pub fn places(self) -> impl Iterator<Item = DVec2> {
        let half = self.half() as f64;
        (0..self.side * self.side)
            .map(move |n| DVec2::new((n % self.side) as f64 - half, (n / self.side) as f64 - half))
    }

    pub fn has(self, place: DVec2) -> bool {
        place.length_squared() <= self.radius_px * self.radius_px
    }
}

/// The best weights for one place of the centre within a pixel, for a contrast of 1: sums of them times the levels.
#[derive(Clone, Debug, Default)]
pub(super) struct Weights {
    /// Displacement of the centre from that place, px.
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub contrast: Vec<f64>,
    /// Radius and blur beyond those of the design, px.
    pub radius: Vec<f64>,
    pub blur: Vec<f64>,
    /// Share of the disc.
    pub share: Vec<f64>,
    /// κ of d = g (1 + κ g²) for the displacement d of a response g.
    pub bend_per_px2: f64,
}

/// Finds weights, with its scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct Design {
    columns: [Vec<f64>; COLUMNS],
    whitened: [Vec<f64>; COLUMNS],
    covariance: Covariance,
    cholesky: Cholesky,
    scratch: Scratch,
    pub weights: Weights,
}

impl Design {
    /// Makes room for supports of at most so many pixels on a side.
    pub fn reserve(&mut self, side: usize) {
        let Weights { x, y, contrast, radius, blur, share, .. } = &mut self.weights;
        let Scratch { image, rows } = &mut self.scratch;
        let own = [x, y, contrast, radius, blur, share, image, rows];
        let all = own.into_iter().chain(&mut self.columns).chain(&mut self.whitened);
        for list in all.chain([&mut self.covariance.mask, &mut self.covariance.alike]) {
            list.clear();
            list.reserve(side * side.next_multiple_of(LANES));
        }
        self.cholesky.reserve(side * side);
    }

    /// Starts the designs for one support and one noise.
    pub fn start(&mut self, support: Support, noise: &Noise) {
        self.covariance.limited(support, noise);
        let (inside, covariance) = (support.places().map(|at| support.has(at)), &self.covariance);
        self.cholesky.factor(support.side, inside, |columns, rows| covariance.between(columns, rows));
    }

    /// The best linear unbiased estimator K = (Jᵀ C⁻¹ J)⁻¹ Jᵀ C⁻¹ (Kay, Estimation Theory, section 6.5) for the
    /// derivatives J of the levels by all parameters and the covariance C of the noise, so that no error of the other
    /// parameters moves the centre to first order. `per_ground` is the contrast over the gel's level. `None` for a disc that its pixels do not determine.
    ///
    /// C is that of [`Self::start`] with the same support.
    pub fn run(&mut self, disc: &Disc, support: Support, off_px: DVec2, per_ground: f64) -> Option<&Weights> {
        let Self { columns, whitened, cholesky, weights, .. } = self;
        derive(columns, disc, support, off_px, per_ground);
        for (column, whitened) in columns.iter().zip(whitened.iter_mut()) {
            cholesky.solve(column, whitened);
        }
        let mut matrix: Symmetric<COLUMNS> = [[0.0; COLUMNS]; COLUMNS];
        for i in 0..COLUMNS {
            for j in 0..COLUMNS {
                matrix[i][j] = 0.5 * (dot(&whitened[i], &columns[j]) + dot(&whitened[j], &columns[i]));
            }
        }
        let factor = |prior_px: f64| {
            let mut known = matrix;
            for k in [RADIUS, STRETCHES[0], STRETCHES[1], BLUR] {
                known[k][k] += (NOISE_SHARE / prior_px) * (NOISE_SHARE / prior_px);
            }
            Factor::new(&known)
        };
        let [form, place] = PRIORS_PX.map(factor);
        let combine = |factor: &Factor<COLUMNS>, parameter: usize, sum: &mut Vec<f64>| {
            let row = factor.solve(&core::array::from_fn(|k| f64::from(u8::from(k == parameter))));
            sum.clear();
            sum.resize(support.side * support.side, 0.0);
            for (&share, column) in row.iter().zip(whitened.iter()) {
                sum.iter_mut().zip(column).for_each(|(sum, &w)| *sum += share * w);
            }
        };
        let (form, place) = (form?, place?);
        combine(&place, 0, &mut weights.x);
        combine(&place, 1, &mut weights.y);
        combine(&place, CONTRAST, &mut weights.contrast);
        combine(&form, RADIUS, &mut weights.radius);
        combine(&form, BLUR, &mut weights.blur);
        weights.share.clear();
        weights.share.extend(support.places().map(|at| disc.at((at - off_px).length()).inside));
        let moved = |at: DVec2| disc.at((at - off_px - DVec2::new(BEND_AT_PX, 0.0)).length()).inside;
        let sum =
            |weights: &[f64]| -> f64 { support.places().zip(weights).map(|(at, w)| w * moved(at)).sum() };
        let response = sum(&weights.x) / sum(&weights.contrast);
        weights.bend_per_px2 = (BEND_AT_PX / response - 1.0) / (response * response);
        weights.bend_per_px2.is_finite().then_some(&*weights)
    }

    /// Variance of a sum with these weights per variance of white noise, and per variance of grain of each size.
    pub fn gains(&mut self, support: Support, sizes_px: &[f64; 3]) -> [f64; 4] {
        let white = dot(&self.weights.x, &self.weights.x);
        let mut grain = sizes_px.map(|grain_size_px| {
            let noise = Noise { white_levels2: 0.0, grain_levels2: 1.0, grain_size_px, gel_level: 0.0 };
            self.covariance.exactly(support, &noise);
            let Scratch { image, rows } = &mut self.scratch;
            self.covariance.times(&self.weights.x, image, rows);
            dot(&self.weights.x, image)
        });
        grain.iter_mut().for_each(|gain| *gain = gain.max(0.0));
        [white, grain[0], grain[1], grain[2]]
    }
}

fn derive(columns: &mut [Vec<f64>; COLUMNS], disc: &Disc, support: Support, off_px: DVec2, per_ground: f64) {
    columns.iter_mut().for_each(Vec::clear);
    for at in support.places() {
        let mut terms = [0.0; COLUMNS];
        if support.has(at) {
            let (from, share) = (at - off_px, disc.at((at - off_px).length()));
            let along = from / from.length().max(1e-9);
            // Light scales paint as it scales gel.
            let light = 1.0 + per_ground * share.inside;
            // A stretch moves the edge by cos 2t, as bounds of such fits have it: to first order in its width over the radius.
            terms = [
                -share.by_distance * along.x,
                -share.by_distance * along.y,
                share.inside,
                1.0,
                light * from.x,
                light * from.y,
                share.by_radius,
                share.by_radius * (along.x * along.x - along.y * along.y),
                share.by_radius * 2.0 * along.x * along.y,
                share.by_blur,
            ];
        }
        columns.iter_mut().zip(terms).for_each(|(column, term)| column.push(term));
    }
}

/// Covariance of the pixels of a support, by its product with a vector: w v + g M (G ⊗ G) M v with the mask M and the
/// grain's G(d) = exp(-d² / (4 l²)).
#[derive(Clone, Debug, Default)]
struct Covariance {
    side: usize,
    white: f64,
    grain: f64,
    /// G from the farthest pixel on one side to that on the other, and zeros for the last lanes.
    alike: Vec<f64>,
    mask: Vec<f64>,
}

/// Scratch of a product with the covariance.
#[derive(Clone, Debug, Default)]
struct Scratch {
    image: Vec<f64>,
    rows: Vec<f64>,
}

impl Covariance {
    /// With enough white noise for well-behaved weights, per variance of a pixel.
    fn limited(&mut self, support: Support, noise: &Noise) {
        self.exactly(support, noise);
        let white = self.white.max(LEAST_SHARE * noise.spectrum(0.0));
        let all = white + self.grain;
        (self.white, self.grain) = (white / all, self.grain / all);
    }

    fn exactly(&mut self, support: Support, noise: &Noise) {
        let l2 = noise.grain_size_px * noise.grain_size_px;
        (self.side, self.white, self.grain) = (support.side, noise.white_levels2, noise.grain_levels2);
        self.alike.clear();
        let last = support.side - 1;
        self.alike.extend((0..=2 * last).map(|k| k.abs_diff(last)).map(|d| exp(-0.25 * (d * d) as f64 / l2)));
        self.alike.resize(2 * last + 1 + LANES, 0.0);
        self.mask.clear();
        self.mask.extend(support.places().map(|at| f64::from(u8::from(support.has(at)))));
    }

    fn times(&self, v: &[f64], out: &mut Vec<f64>, rows: &mut Vec<f64>) {
        let (side, stride) = (self.side, self.side.next_multiple_of(LANES));
        out.clear();
        out.resize(v.len(), 0.0);
        if self.grain > 0.0 {
            rows.clear();
            rows.resize(side * stride, 0.0);
            for (v, row) in v.chunks_exact(side).zip(rows.chunks_exact_mut(stride)) {
                for (block, row) in row.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                    let alike = self.alike[block * LANES..].windows(LANES).take(side).rev();
                    *row = weighted(v.iter().zip(alike));
                }
            }
            for (y, out) in out.chunks_exact_mut(side).enumerate() {
                for (block, out) in out.chunks_mut(LANES).enumerate() {
                    let rows = rows.chunks_exact(stride).map(|row| &row[block * LANES..]);
                    let sum = weighted(self.alike[side - 1 - y..].iter().zip(rows));
                    out.copy_from_slice(&sum[..out.len()]);
                }
            }
        }
        for ((out, &v), &mask) in out.iter_mut().zip(v).zip(&self.mask) {
            *out = self.white * v + self.grain * mask * *out;
        }
    }

    /// Between two pixels of the support so many columns and rows apart.
    fn between(&self, columns: usize, rows: usize) -> f64 {
        let last = self.side - 1;
        let own = if columns == 0 && rows == 0 { self.white } else { 0.0 };
        own + self.grain * self.alike[last + columns] * self.alike[last + rows]
    }
}

/// Sum of the first numbers of lists, each list times its share.
#[inline]
fn weighted<'a>(lists: impl Iterator<Item = (&'a f64, &'a [f64])>) -> [f64; LANES] {
    let mut sum = [0.0; LANES];
    for (share, list) in lists {
        let Some(list) = list.first_chunk::<LANES>() else { break };
        sum.iter_mut().zip(list).for_each(|(sum, x)| *sum += share * x);
    }
    sum
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The product with the covariance, which is taken along rows and columns, undoes the solution.
    #[test]
    fn what_is_solved_for_comes_back_by_the_product() {
        let [mut solution, mut back, mut rows] = [const { Vec::new() }; 3];
        let mut design = Design::default();
        for (radius_px, grain_levels2) in [(2.5, 0.0), (4.0, 0.5), (7.3, 4.0), (11.9, 8.0)] {
            let support = Support::new(radius_px);
            let noise = Noise { white_levels2: 1.0, grain_levels2, grain_size_px: 1.3, gel_level: 0.0 };
            design.start(support, &noise);
            let inside = support.places().map(|at| support.has(at));
            let v: Vec<f64> =
                (0..).zip(inside).map(|(n, on)| if on { f64::from(n % 7) - 2.5 } else { 0.0 }).collect();
            design.cholesky.solve(&v, &mut solution);
            design.covariance.times(&solution, &mut back, &mut rows);
            // White noise of 3 % of the spectrum at least: a condition below 40, so that 500 sums of round-off stay below 1e-11.
            let off = v.iter().zip(&back).map(|(v, b)| (v - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-11, "{radius_px} px: {off}");
        }
    }
}
