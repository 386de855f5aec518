//! Optimal weights for locating a blurred disc.

use super::covariance::{Covariance, PARITIES};
use super::disc::Disc;
use super::support::Support;
use crate::detect::centre::noise::Noise;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor};
use alloc::vec::Vec;

/// Parameters of one marker: centre, contrast, ground, its slopes, radius, two stretches, blur.
const COLUMNS: usize = 10;
const CONTRAST: usize = 2;
const RADIUS: usize = 6;
const STRETCHES: [usize; 2] = [7, 8];
const BLUR: usize = 9;
/// Prior standard deviations of radius, stretches and blur, px. They matter only for a small disc, where
/// these are hardly separable from contrast. First for estimating them, second for estimating the position.
const PRIORS_PX: [f64; 2] = [1.0, 0.15];
/// Noise over contrast assumed for the priors.
const NOISE_SHARE: f64 = 1.0 / 40.0;
/// Largest number of columns and rows of a support.
pub(super) const MAX_SUPPORT_PX: usize = 31;
/// Number of weight sets computed: displacement, contrast, radius and blur.
const WANTED: usize = 5;
/// Displacement at which the response's nonlinearity is measured.
const BEND_AT_PX: f64 = 0.3;

/// Optimal weights for one sub-pixel position of the centre, for a contrast of 1; they are applied to the
/// levels.
#[derive(Clone, Debug, Default)]
pub(super) struct Weights {
    /// Displacement of the centre from that position, px.
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub contrast: Vec<f64>,
    /// Radius and blur minus those of the design, px.
    pub radius: Vec<f64>,
    pub blur: Vec<f64>,
    /// Share of the disc.
    pub share: Vec<f64>,
    /// κ of d = g (1 + κ g²) for the displacement d of a response g, along x and along y.
    pub bends_per_px2: [f64; 2],
}

/// Computes weights, with its scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct Design {
    columns: Vec<[f64; COLUMNS]>,
    /// L⁻¹ J, by parity.
    whitened: [Vec<[f64; COLUMNS]>; 4],
    wanted: Vec<[f64; WANTED]>,
    /// Weights for x at another position, and then of the response.
    slope: Vec<f64>,
    covariance: Covariance,
    pub weights: Weights,
}

impl Design {
    /// Reserves memory for supports of at most `side` pixels per side.
    pub fn reserve(&mut self, side: usize) {
        let Weights { x, y, contrast, radius, blur, share, .. } = &mut self.weights;
        for list in [x, y, contrast, radius, blur, share] {
            list.clear();
            list.reserve(side * side);
        }
        self.columns.clear();
        self.columns.reserve(side * side);
        let quarter = (side / 2 + 1) * (side / 2 + 1);
        for list in &mut self.whitened {
            list.clear();
            list.reserve(quarter);
        }
        self.wanted.clear();
        self.wanted.reserve(quarter);
        self.slope.clear();
        self.slope.reserve(side * side);
        self.covariance.reserve(side);
    }

    /// Starts the designs for one support and one noise.
    pub fn start(&mut self, support: Support, noise: &Noise) {
        self.covariance.factor(support, noise);
    }

    /// The best linear unbiased estimator K = (Jᵀ C⁻¹ J)⁻¹ Jᵀ C⁻¹ (Kay, Estimation Theory, section 6.5),
    /// for the derivatives J of the levels by all parameters and the covariance C of the noise. To first
    /// order, errors of the other parameters do not move the centre. `per_ground` is the contrast over
    /// the gel's level. `None` for a disc that its pixels do not determine.
    ///
    /// C is that of [`Self::start`] with the same support.
    pub fn run(&mut self, disc: &Disc, support: Support, off_px: DVec2, per_ground: f64) -> Option<&Weights> {
        let Self { columns, whitened, covariance, .. } = self;
        derive(columns, disc, support, off_px, per_ground);
        let mut matrix: Symmetric<COLUMNS> = [[0.0; COLUMNS]; COLUMNS];
        for (parity, whitened) in PARITIES.into_iter().zip(whitened) {
            covariance.fold(parity, columns, whitened);
            covariance.forward(parity, whitened);
            for row in whitened {
                for i in 0..COLUMNS {
                    for j in 0..COLUMNS {
                        matrix[i][j] += row[i] * row[j];
                    }
                }
            }
        }
        self.combine(&shares(&matrix)?, support);
        let weights = &mut self.weights;
        weights.share.clear();
        weights.share.extend(support.places().map(|at| disc.at((at - off_px).length()).inside));
        weights.bends_per_px2 = [(DVec2::X, &weights.x), (DVec2::Y, &weights.y)].map(|(along, own)| {
            let (mut moved, mut contrast) = (0.0, 0.0);
            for (at, (own, own_contrast)) in support.places().zip(own.iter().zip(&weights.contrast)) {
                if support.has(at) {
                    let inside = disc.at((at - off_px - along * BEND_AT_PX).length()).inside;
                    moved += own * inside;
                    contrast += own_contrast * inside;
                }
            }
            let response = moved / contrast;
            (BEND_AT_PX / response - 1.0) / (response * response)
        });
        weights.bends_per_px2.iter().all(|bend| bend.is_finite()).then_some(&*weights)
    }

    /// Weights as linear combinations of all columns.
    fn combine(&mut self, shares: &[[f64; COLUMNS]; WANTED], support: Support) {
        let Weights { x, y, contrast, radius, blur, .. } = &mut self.weights;
        let mut lists = [x, y, contrast, radius, blur];
        for list in &mut lists {
            list.clear();
            list.resize(support.side * support.side, 0.0);
        }
        for (parity, whitened) in PARITIES.into_iter().zip(&self.whitened) {
            self.wanted.clear();
            let sum = |row: &[f64; COLUMNS], shares: &[f64; COLUMNS]| -> f64 {
                row.iter().zip(shares).map(|(x, share)| x * share).sum()
            };
            self.wanted.extend(whitened.iter().map(|row| shares.map(|shares| sum(row, &shares))));
            self.covariance.backward(parity, &mut self.wanted);
            self.covariance.unfold(parity, &self.wanted, |place, weights| {
                lists.iter_mut().zip(weights).for_each(|(list, weight)| list[place] += weight);
            });
        }
    }

    /// Variance of a sum with these weights per unit variance of white noise, and of grain of each size.
    pub fn gains(&mut self, along_y: bool, sizes_px: &[f64; 3]) -> [f64; 4] {
        let Self { weights, covariance, .. } = self;
        gains(covariance, if along_y { &weights.y } else { &weights.x }, sizes_px)
    }

    /// Stores the weights for x until [`Self::response_gains`].
    pub fn keep_x(&mut self) {
        self.slope.clear();
        self.slope.extend(&self.weights.x);
    }

    /// As [`Self::gains`], for the response along x between the position of [`Self::keep_x`] and this
    /// one, `apart_px` to its right: the decrease of the displacement per px, minus the relative error of
    /// the contrast.
    pub fn response_gains(&mut self, apart_px: f64, sizes_px: &[f64; 3]) -> [f64; 4] {
        let Self { weights, covariance, slope, .. } = self;
        for (slope, (x, contrast)) in slope.iter_mut().zip(weights.x.iter().zip(&weights.contrast)) {
            *slope = (*slope - x) / apart_px - contrast;
        }
        gains(covariance, slope, sizes_px)
    }
}

/// Variance of a sum with these weights per unit variance of white noise, and of grain of each size.
fn gains(covariance: &mut Covariance, weights: &[f64], sizes_px: &[f64; 3]) -> [f64; 4] {
    let white = weights.iter().map(|weight| weight * weight).sum();
    let [small, medium, large] = sizes_px.map(|size_px| covariance.grain_gain(weights, size_px).max(0.0));
    [white, small, medium, large]
}

/// Rows of (Jᵀ C⁻¹ J)⁻¹ for the wanted parameters, from Jᵀ C⁻¹ J.
fn shares(matrix: &Symmetric<COLUMNS>) -> Option<[[f64; COLUMNS]; WANTED]> {
    let factor = |prior_px: f64| {
        let mut known = *matrix;
        for k in [RADIUS, STRETCHES[0], STRETCHES[1], BLUR] {
            known[k][k] += (NOISE_SHARE / prior_px) * (NOISE_SHARE / prior_px);
        }
        Factor::new(&known)
    };
    let [form, place] = PRIORS_PX.map(factor);
    let (form, place) = (form?, place?);
    let row = |factor: &Factor<COLUMNS>, parameter: usize| {
        factor.solve(&core::array::from_fn(|k| f64::from(u8::from(k == parameter))))
    };
    Some([row(&place, 0), row(&place, 1), row(&place, CONTRAST), row(&form, RADIUS), row(&form, BLUR)])
}

/// Derivatives of the levels by all parameters, pixel by pixel.
fn derive(columns: &mut Vec<[f64; COLUMNS]>, disc: &Disc, support: Support, off_px: DVec2, per_ground: f64) {
    columns.clear();
    columns.extend(support.places().map(|at| {
        if !support.has(at) {
            return [0.0; COLUMNS];
        }
        let from = at - off_px;
        let far_px = from.length();
        let (share, along) = (disc.at(far_px), from / far_px.max(1e-9));
        // Light scales paint as it scales gel.
        let light = 1.0 + per_ground * share.inside;
        // A stretch moves the edge by cos 2t, to first order in its width over the radius, as in the
        // bounds of such fits.
        [
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
        ]
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{abs, exp};

    /// Against the response to a disc at the first of both positions, perturbed one pixel at a time, and
    /// the sum over all pairs of pixels. Neglected terms are of second order in the distance of the
    /// positions over the blur.
    #[test]
    fn response_gains_are_those_of_steps_from_two_places() {
        let (mut disc, mut design) = (Disc::default(), Design::default());
        let (support, near, apart_px) = (Support::new(6.9), DVec2::splat(0.125), 0.05);
        for (grain_levels2, blur_px) in [(0.0, 0.8), (0.25, 0.8), (1.0, 0.9)] {
            let noise = Noise { white_levels2: 1.0, grain_levels2, grain_size_px: 1.3, gel_level: 0.0 };
            disc.draw(4.0, blur_px);
            design.start(support, &noise);
            let here = design.run(&disc, support, near, -0.75).unwrap().clone();
            design.keep_x();
            let next = design.run(&disc, support, near + DVec2::X * apart_px, -0.75).unwrap().clone();
            let levels: Vec<f64> = support.places().map(|at| disc.at((at - near).length()).inside).collect();
            let response = |levels: &[f64]| {
                let sum = |weights: &[f64]| weights.iter().zip(levels).map(|(w, x)| w * x).sum::<f64>();
                (sum(&here.x) / sum(&here.contrast) - sum(&next.x) / sum(&next.contrast)) / apart_px
            };
            let by_pixel: Vec<f64> = (0..levels.len())
                .map(|n| {
                    let by = |more: f64| {
                        let mut levels = levels.clone();
                        levels[n] += more;
                        response(&levels)
                    };
                    (by(1e-4) - by(-1e-4)) / 2e-4
                })
                .collect();
            let pairs = |size_px: f64| {
                let all = || support.places().zip(&by_pixel);
                let alike = |a: DVec2, b: DVec2| exp(-0.25 * a.distance_squared(b) / (size_px * size_px));
                all().flat_map(|(a, x)| all().map(move |(b, y)| x * y * alike(a, b))).sum::<f64>()
            };
            let sizes_px = [0.9, 1.3, 1.8];
            let [small, medium, large] = sizes_px.map(pairs);
            let white = by_pixel.iter().map(|x| x * x).sum::<f64>();
            let tolerance = (apart_px / blur_px) * (apart_px / blur_px);
            let found = design.response_gains(apart_px, &sizes_px);
            for (found, expected) in found.into_iter().zip([white, small, medium, large]) {
                assert!(abs(found / expected - 1.0) < tolerance, "{found} {expected}");
            }
        }
    }
}
