//! Synthetic dots of which everything is known.
#![allow(dead_code, reason = "each test crate uses its own part of this")]

pub mod poses;
pub mod sequence;

use gelstereo_core::image::GrayView;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, cos, sin};

/// An image of discs on an even ground.
#[derive(Clone, Debug)]
pub struct Dots {
    pub width: usize,
    pub height: usize,
    pub ground: f64,
    /// Grey level inside discs less that of the ground.
    pub contrast: f64,
    /// Change of the ground's level per pixel.
    pub slope: DVec2,
    pub radius_px: f64,
    pub centres_px: Vec<DVec2>,
    /// Standard deviation, grey levels.
    pub noise: f64,
    pub seed: u64,
}

impl Dots {
    pub fn new(width: usize, height: usize, centres_px: Vec<DVec2>) -> Self {
        Self {
            width,
            height,
            ground: 180.0,
            contrast: -120.0,
            slope: DVec2::ZERO,
            radius_px: 4.3,
            centres_px,
            noise: 0.0,
            seed: 1,
        }
    }

    /// As [`Self::render`], without noise and rounding.
    pub fn render_levels(&self) -> Vec<f64> {
        let mut coverage = vec![0.0_f64; self.width * self.height];
        for &centre in &self.centres_px {
            self.add_disc(&mut coverage, centre);
        }
        coverage.iter().map(|share| self.ground + self.contrast * share.min(1.0)).collect()
    }

    /// Area coverage by 16 x 16 samples a pixel: an edge is right to 1/256 of the contrast, a centre to 1e-3
    /// px.
    pub fn render(&self) -> Vec<u8> {
        let mut coverage = vec![0.0_f64; self.width * self.height];
        for &centre in &self.centres_px {
            self.add_disc(&mut coverage, centre);
        }
        let mut noise = Stream::new(self.seed, "pixel noise");
        let middle = DVec2::new(self.width as f64, self.height as f64) * 0.5;
        (0..self.width * self.height)
            .map(|n| {
                let at = DVec2::new((n % self.width) as f64, (n / self.width) as f64);
                let ground = self.ground + self.slope.dot(at - middle);
                let level = ground + self.contrast * coverage[n].min(1.0);
                let noise = if self.noise > 0.0 { self.noise * noise.normal() } else { 0.0 };
                (level + noise + 0.5) as u8
            })
            .collect()
    }

    fn add_disc(&self, coverage: &mut [f64], centre: DVec2) {
        const SAMPLES: usize = 16;
        let reach = self.radius_px + 1.0;
        let range = |c: f64, end: usize| {
            ((c - reach).max(0.0) as usize)..((c + reach + 1.0).clamp(0.0, end as f64) as usize)
        };
        for y in range(centre.y, self.height) {
            for x in range(centre.x, self.width) {
                let inside = (0..SAMPLES * SAMPLES).filter(|s| {
                    let sub = DVec2::new((s % SAMPLES) as f64, (s / SAMPLES) as f64);
                    let at = DVec2::new(x as f64, y as f64) - 0.5 + (sub + 0.5) / SAMPLES as f64;
                    at.distance_squared(centre) <= self.radius_px * self.radius_px
                });
                coverage[y * self.width + x] += inside.count() as f64 / (SAMPLES * SAMPLES) as f64;
            }
        }
    }
}

/// A lattice about `centre`, row by row: steps of `pitch_px` turned clockwise as seen (y down) and then
/// sheared in x by y.
pub fn lattice(
    rows: usize,
    cols: usize,
    pitch_px: f64,
    centre: DVec2,
    turn_deg: f64,
    shear: f64,
) -> Vec<DVec2> {
    let (s, c) = (sin(turn_deg.to_radians()), cos(turn_deg.to_radians()));
    (0..rows * cols)
        .map(|n| {
            let x = (n % cols) as f64 - (cols - 1) as f64 * 0.5;
            let y = (n / cols) as f64 - (rows - 1) as f64 * 0.5;
            centre + DVec2::new(c * x - s * y + shear * (s * x + c * y), s * x + c * y) * pitch_px
        })
        .collect()
}

/// 25 x 25 markers as the default rig's left camera sees them, about the middle of 640 x 480.
pub fn paper_lattice() -> Vec<DVec2> {
    lattice(25, 25, 17.56, DVec2::new(330.3, 240.7), 0.0, 0.0)
}

/// Image of 160 x 120 and positions in it: a marker; gel where one is gone, and beyond the lattice; two
/// markers that touch, one that the border cuts, and three places outside the image.
pub fn one_marker_and_what_is_none() -> (Vec<u8>, [DVec2; 8]) {
    let mut centres = lattice(5, 7, 17.0, DVec2::new(80.2, 60.1), 0.0, 0.0);
    let gone = centres.remove(17);
    centres[0] = centres[1] - DVec2::new(8.0, 0.0);
    let (cut, fine, touching) = (DVec2::new(1.0, 100.0), centres[20], centres[0]);
    centres.push(cut);
    let [beyond, outside] = [DVec2::new(144.0, 60.0), DVec2::new(-40.0, 3.0)];
    let at = [fine, gone, beyond, touching, cut, outside, DVec2::NAN, DVec2::new(f64::INFINITY, 5.0)];
    (Dots { noise: 2.0, ..Dots::new(160, 120, centres) }.render(), at)
}

#[expect(clippy::unwrap_used, reason = "a test that asks for another shape is wrong")]
pub fn view(bytes: &[u8], width: usize) -> GrayView<'_> {
    GrayView::new(bytes, width, bytes.len() / width, width).unwrap()
}

/// Root mean square distance from each centre to the nearest truth, and how many truths were found within a
/// pixel.
pub fn errors(found: &[DVec2], truth: &[DVec2]) -> (f64, usize) {
    let nearest = |t: &DVec2| found.iter().map(|f| f.distance(*t)).fold(f64::INFINITY, f64::min);
    let near: Vec<f64> = truth.iter().map(nearest).filter(|&d| d < 1.0).collect();
    let mean_square = near.iter().map(|d| d * d).sum::<f64>() / near.len().max(1) as f64;
    (mean_square.sqrt(), near.len())
}
