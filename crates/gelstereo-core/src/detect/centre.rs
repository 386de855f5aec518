//! From a component to a sub-pixel centre.

use super::components::{Blob, Run};
use crate::image::GrayView;
use crate::math::{DMat3, DVec2, DVec3, round};
use crate::params::Polarity;
use alloc::vec::Vec;

/// The paper's centre: mean position of the component's pixels.
#[must_use]
pub fn binary(blob: &Blob) -> DVec2 {
    let area = f64::from(blob.area_px2);
    DVec2::new(blob.sum_x as f64 / area, blob.sum_y as f64 / area)
}

/// Pixels by which the component grows on all sides: wide enough that the outermost ones lie on the gel, beyond the
/// marker's blurred edge.
const MARGIN_PX: i64 = 2;

/// Fractional bits of grey levels here. Coordinates below 2^15 and 2^24 pixels keep every sum within 63 bits.
const LEVEL_BITS: u32 = 12;

/// Mean position weighted by contrast, over the component and `MARGIN_PX` around it.
///
/// The contrast is measured from a plane through the outermost of these pixels, so that neither a slope of light nor the
/// marker's neighbours (which bend the background of the threshold) shift the centre. It counts from 1/8 of the
/// marker's mean contrast up to that mean only: noise of the gel and grain of the paint then carry no weight, and
/// what is left is the marker's edge, which holds the information about its position. A narrower band would see less
/// noise, but sharp edges pass it within less than a pixel, and the centre would depend on where in a pixel it lies.
#[derive(Clone, Debug, Default)]
pub struct GreyCentre {
    /// First and last column of the grown component, row by row from `MARGIN_PX` above its top.
    spans: Vec<(i64, i64)>,
}

impl GreyCentre {
    /// The centre of a component with these runs. Falls back to [`binary`] where too little of the surround lies
    /// within the image to lay a plane through it.
    #[must_use]
    pub fn run<'a>(
        &mut self,
        image: GrayView<'_>,
        blob: &Blob,
        runs: impl Iterator<Item = &'a Run> + Clone,
        polarity: Polarity,
    ) -> DVec2 {
        self.spans.clear();
        self.spans.reserve(image.height() + 2 * MARGIN_PX as usize); // the tallest there can be
        self.grow(blob, runs.clone());
        let window = Window::new(image, blob, &self.spans);
        let Some(surround) = window.surround() else {
            return binary(blob);
        };
        let sign = match polarity {
            Polarity::Dark => 1,
            Polarity::Bright => -1,
        };
        let contrast = |x: i64, y: i64, level: u8| {
            sign * (surround.at(window.u(x), window.v(y)) - (i64::from(level) << LEVEL_BITS))
        };
        let mut inside = 0_i64;
        for run in runs {
            let levels = &image.row(run.y as usize)[run.start as usize..run.end as usize];
            inside += levels
                .iter()
                .zip(i64::from(run.start)..)
                .map(|(&g, x)| contrast(x, run.y.into(), g))
                .sum::<i64>();
        }
        let high = inside / i64::from(blob.area_px2);
        let low = high / 8;
        if low >= high {
            return binary(blob);
        }
        let (mut weight, mut moment_u, mut moment_v) = (0_i64, 0_i64, 0_i64);
        window.visit(|x, y, level, _| {
            let w = contrast(x, y, level).clamp(low, high) - low;
            weight += w;
            moment_u += w * window.u(x);
            moment_v += w * window.v(y);
        });
        if weight == 0 {
            return binary(blob);
        }
        let half = 0.5 / weight as f64;
        window.middle() + DVec2::new(moment_u as f64 * half, moment_v as f64 * half)
    }

    fn grow<'a>(&mut self, blob: &Blob, runs: impl Iterator<Item = &'a Run>) {
        self.spans
            .resize((blob.bottom - blob.top + 1) as usize + 2 * MARGIN_PX as usize, (i64::MAX, i64::MIN));
        for run in runs {
            let first = (run.y - blob.top) as usize;
            for span in &mut self.spans[first..=first + 2 * MARGIN_PX as usize] {
                span.0 = span.0.min(i64::from(run.start) - MARGIN_PX);
                span.1 = span.1.max(i64::from(run.end) - 1 + MARGIN_PX);
            }
        }
    }
}

/// The pixels of the grown component that lie within the image. Coordinates u, v are twice the distances from the middle of its
/// bounding box: whole numbers for any width.
struct Window<'a> {
    image: GrayView<'a>,
    spans: &'a [(i64, i64)],
    top: i64,
    /// Sums of the first and last column, and of the first and last row.
    ends: (i64, i64),
}

/// Grey level of the gel as a plane, with `LEVEL_BITS` fractional bits.
struct Plane {
    level: i64,
    per_u: i64,
    per_v: i64,
}

impl Plane {
    const fn at(&self, u: i64, v: i64) -> i64 {
        self.level + self.per_u * u + self.per_v * v
    }
}

impl<'a> Window<'a> {
    fn new(image: GrayView<'a>, blob: &Blob, spans: &'a [(i64, i64)]) -> Self {
        let ends = (i64::from(blob.left + blob.right), i64::from(blob.top + blob.bottom));
        Self { image, spans, top: i64::from(blob.top) - MARGIN_PX, ends }
    }

    const fn u(&self, x: i64) -> i64 {
        2 * x - self.ends.0
    }

    const fn v(&self, y: i64) -> i64 {
        2 * y - self.ends.1
    }

    fn middle(&self) -> DVec2 {
        DVec2::new(self.ends.0 as f64 * 0.5, self.ends.1 as f64 * 0.5)
    }

    /// Column, row, level of every pixel, and whether it is an outermost one.
    fn visit(&self, mut see: impl FnMut(i64, i64, u8, bool)) {
        let (width, height) = (self.image.width() as i64, self.image.height() as i64);
        let last = self.top + self.spans.len() as i64 - 1;
        for (y, &(first_x, last_x)) in (self.top..).zip(self.spans) {
            if !(0..height).contains(&y) {
                continue;
            }
            let row = self.image.row(y as usize);
            for x in first_x.max(0)..=last_x.min(width - 1) {
                let outermost = x == first_x || x == last_x || y == self.top || y == last;
                see(x, y, row[x as usize], outermost);
            }
        }
    }

    /// Least-squares plane through the outermost pixels.
    fn surround(&self) -> Option<Plane> {
        let mut s = [0_i64; 9]; // 1, u, v, uu, uv, vv, g, gu, gv
        self.visit(|x, y, level, outermost| {
            if outermost {
                let (u, v, g) = (self.u(x), self.v(y), i64::from(level));
                for (sum, term) in s.iter_mut().zip([1, u, v, u * u, u * v, v * v, g, g * u, g * v]) {
                    *sum += term;
                }
            }
        });
        let [n, u, v, uu, uv, vv, g, gu, gv] = s.map(|sum| sum as f64);
        let normal = DMat3::from_cols(DVec3::new(n, u, v), DVec3::new(u, uu, uv), DVec3::new(v, uv, vv));
        // Pixels on one line leave the plane's tilt open.
        if normal.determinant() <= 1e-9 * n * uu * vv {
            return None;
        }
        let fit = normal.inverse() * DVec3::new(g, gu, gv) * f64::from(1_u32 << LEVEL_BITS);
        Some(Plane { level: round(fit.x) as i64, per_u: round(fit.y) as i64, per_v: round(fit.z) as i64 })
    }
}
