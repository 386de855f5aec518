//! Exact renderer of ink through a blurring lens, on a canvas of fine pixels: slow, but valid for any
//! shape.

use super::cover::cover;
use super::lens::Lens;
use super::overlap::Overlaps;
use super::shape::Shape;
use crate::effects::UnevenLight;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, ceil, exp};

/// Minimum of fine pixels per pixel along each axis. Detail finer than a fine pixel is aliased to low
/// frequencies, which the lens does not remove: with 2 a dot is up to 0.002 px off, with 8 up to 3e-5
/// px.
const TIMES: usize = 8;

/// Minimum of fine pixels per sigma of the lens: its Gaussian is sampled with an error of 2 exp(-2 π²
/// 1.6²).
const PER_SIGMA: f64 = 1.6;

/// Image rows that are drawn at once.
const BAND: usize = 16;

/// Draws blurred ink.
#[derive(Clone, Debug)]
pub(crate) struct Fine {
    times: usize,
    reach: usize,
    /// Weights of the fine pixels along one axis, from `reach` pixels before the pixel to as many behind
    /// it.
    weights: Vec<f32>,
    group: Vec<Shape>,
    band: Vec<f32>,
    /// Whole pixels across, fine ones down.
    narrow: Vec<f32>,
}

impl Fine {
    pub(crate) fn new(lens: Lens) -> Self {
        Self::finer(lens, TIMES)
    }

    /// With at least this many fine pixels per pixel.
    pub(super) fn finer(lens: Lens, times: usize) -> Self {
        let times = times.max(ceil(PER_SIGMA / lens.sigma_px) as usize);
        let reach = lens.reach() + 1; // for comparison with renderers of smaller reach
        let sigma = lens.sigma_px * times as f64;
        // A pixel is the sum of its fine pixels, each blurred by the Gaussian.
        let spread = |k: usize| {
            let own = (reach * times..(reach + 1) * times).map(|m| (k as f64 - m as f64) / sigma);
            own.map(|t| exp(-0.5 * t * t)).sum::<f64>()
        };
        let weights: Vec<f64> = (0..(2 * reach + 1) * times).map(spread).collect();
        let whole: f64 = weights.iter().sum();
        let weights = weights.into_iter().map(|weight| (weight / whole) as f32).collect();
        Self { times, reach, weights, group: Vec::new(), band: Vec::new(), narrow: Vec::new() }
    }

    /// Adds `share` of the blurred ink to every pixel, in the light that falls on it.
    pub(crate) fn draw(
        &mut self,
        (shapes, overlaps): (&[Shape], &Overlaps),
        light: Option<&UnevenLight>,
        share: f32,
        canvas: &mut [f32],
        width: usize,
    ) {
        let size = DVec2::new(width as f64, (canvas.len() / width) as f64);
        for (index, rows) in canvas.chunks_mut(BAND * width).enumerate() {
            let origin = [self.reach as f64, self.reach as f64 - (index * BAND) as f64];
            let (columns, lines) = (width + 2 * self.reach, rows.len() / width + 2 * self.reach);
            let fine_columns = columns * self.times;
            self.band.clear();
            self.band.resize(fine_columns * lines * self.times, 0.0);
            for group in overlaps.groups() {
                self.group.clear();
                self.group.extend(group.iter().map(|&i| shapes[i].magnified(self.times, origin)));
                cover(&self.group, 1.0, &mut self.band, fine_columns);
            }
            if let Some(light) = light {
                self.light(light, size, origin, fine_columns);
            }
            self.narrow(fine_columns, width);
            self.shorten(share, rows, width);
        }
    }

    fn light(&mut self, light: &UnevenLight, size: DVec2, origin: [f64; 2], fine_columns: usize) {
        let by = self.times as f64;
        let place = |fine: usize, origin: f64| (fine as f64 - 0.5 * (by - 1.0)) / by - origin;
        for (y, row) in self.band.chunks_exact_mut(fine_columns).enumerate() {
            for (x, covered) in row.iter_mut().enumerate().filter(|(_, covered)| **covered > 0.0) {
                *covered *= light.gain(DVec2::new(place(x, origin[0]), place(y, origin[1])), size) as f32;
            }
        }
    }

    fn narrow(&mut self, fine_columns: usize, width: usize) {
        let Self { times, weights, band, narrow, .. } = self;
        narrow.clear();
        for row in band.chunks_exact(fine_columns) {
            let windows = (0..width).map(|x| &row[x * *times..][..weights.len()]);
            narrow.extend(windows.map(|seen| weigh(seen.iter(), weights)));
        }
    }

    fn shorten(&self, share: f32, rows: &mut [f32], width: usize) {
        for (y, row) in rows.chunks_exact_mut(width).enumerate() {
            let from = y * self.times * width;
            for (x, pixel) in row.iter_mut().enumerate() {
                *pixel += share * weigh(self.narrow[from + x..].iter().step_by(width), &self.weights);
            }
        }
    }
}

fn weigh<'a>(seen: impl Iterator<Item = &'a f32>, weights: &[f32]) -> f32 {
    seen.zip(weights).map(|(&seen, &weight)| f64::from(seen) * f64::from(weight)).sum::<f64>() as f32
}
