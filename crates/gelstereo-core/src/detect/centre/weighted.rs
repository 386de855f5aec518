//! The intensity-weighted centroid of a component.

use super::{CentreRung, Components};
use crate::detect::markers::Markers;
use crate::detect::mask::components::{Blob, Run};
use crate::image::GrayView;
use crate::math::{DMat3, DVec2, DVec3, round};
use crate::params::{DetectParams, Polarity};
use alloc::vec::Vec;

/// Margin by which the component grows on all sides, pixels. The outermost pixels then lie on the gel,
/// beyond the marker's blurred edge.
const MARGIN_PX: i64 = 2;

/// Fractional bits of grey levels here. Coordinates below 2^15 and 2^24 pixels keep every sum within 63 bits.
const LEVEL_BITS: u32 = 12;

/// Mean position weighted by contrast, over the component and `MARGIN_PX` around it.
///
/// The contrast is relative to a plane through the outermost of these pixels. Neither a slope of light nor
/// neighbouring markers (which distort the threshold's background) then shift the centre. Weights grow from
/// 1/8 of the marker's mean contrast up to that mean, so that gel noise and paint grain have no weight. What
/// remains is the edge, which holds the position information. A narrower band would be less noisy, but sharp
/// edges would cross it within less than a pixel, and the centre would depend on the sub-pixel position.
#[derive(Clone, Debug)]
pub(in crate::detect) struct WeightedCentroid {
    polarity: Polarity,
    variance_px2: f64,
    /// First and last column of the grown component, row by row from `MARGIN_PX` above its top.
    spans: Vec<(i64, i64)>,
}

impl WeightedCentroid {
    /// Creates the rung from its settings.
    pub fn new(params: &DetectParams) -> Self {
        let variance_px2 = params.centre_sigma_px * params.centre_sigma_px;
        Self { polarity: params.polarity, variance_px2, spans: Vec::new() }
    }

    /// Reserves memory for the tallest possible component in an image of this height.
    pub fn reserve(&mut self, height: usize) {
        self.spans.clear();
        self.spans.reserve(height + 2 * MARGIN_PX as usize);
    }

    /// Centre of a component with these runs. Falls back to its mean if too little of its surroundings
    /// lies within the image for a plane fit.
    pub fn run<'a>(
        &mut self,
        image: GrayView<'_>,
        blob: &Blob,
        runs: impl Iterator<Item = &'a Run> + Clone,
    ) -> DVec2 {
        let polarity = self.polarity;
        self.reserve(image.height());
        self.grow(blob, runs.clone());
        let window = Window::new(image, blob, &self.spans);
        let Some(background) = window.background() else {
            return blob.mean_px();
        };
        let inside = window.contrast_of(&background, blob, runs, polarity);
        let high = inside / i64::from(blob.area_px2);
        let low = high / 8;
        if low >= high {
            return blob.mean_px();
        }
        let moments = window.moments(&background, low, high, polarity);
        let Some((weight, moment_u, moment_v)) = moments.filter(|&(weight, ..)| weight > 0) else {
            return blob.mean_px();
        };
        let half = 0.5 / weight as f64;
        window.middle() + DVec2::new(moment_u as f64 * half, moment_v as f64 * half)
    }

    fn grow<'a>(&mut self, blob: &Blob, runs: impl Iterator<Item = &'a Run>) {
        self.spans.resize(blob.size().1 as usize + 2 * MARGIN_PX as usize, (i64::MAX, i64::MIN));
        for run in runs {
            let first = (run.y - blob.top) as usize;
            for span in &mut self.spans[first..=first + 2 * MARGIN_PX as usize] {
                span.0 = span.0.min(i64::from(run.start) - MARGIN_PX);
                span.1 = span.1.max(i64::from(run.end) - 1 + MARGIN_PX);
            }
        }
    }
}

impl CentreRung for WeightedCentroid {
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers) {
        for blob in found.markers() {
            let centre_px = self.run(found.image, blob, found.runs(blob));
            out.push(centre_px, self.variance_px2, blob.area_px2);
        }
    }

    fn window_variance_px2(&self, _: u8) -> f64 {
        self.variance_px2
    }
}

/// Pixels of the grown component within the image. Coordinates u, v are twice the distances from the
/// centre of its bounding box: integers for any width.
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
        Self { image, spans, top: i64::from(blob.top) - MARGIN_PX, ends: blob.ends() }
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

    /// Rows of the window: row index, first and last column within the image, and the pixels from the
    /// first to the last.
    fn rows(&self) -> impl Iterator<Item = (i64, i64, i64, &'a [u8])> {
        let (width, height) = (self.image.width() as i64, self.image.height() as i64);
        let image = self.image;
        let rows = (self.top..).zip(self.spans).filter(move |(y, _)| (0..height).contains(y));
        rows.map(move |(y, &(first_x, last_x))| {
            let (first, last) = (first_x.max(0), last_x.min(width - 1));
            (y, first, last, &image.row(y as usize)[first as usize..=last as usize])
        })
    }

    /// Sum of the contrasts of a component's own pixels.
    fn contrast_of<'r>(
        &self,
        background: &Plane,
        blob: &Blob,
        runs: impl Iterator<Item = &'r Run>,
        polarity: Polarity,
    ) -> i64 {
        let mut levels = 0;
        for run in runs {
            let row = &self.image.row(run.y as usize)[run.start as usize..run.end as usize];
            levels += row.iter().map(|&level| i64::from(level)).sum::<i64>();
        }
        let area = i64::from(blob.area_px2);
        let (u, v) = (2 * blob.sum_x as i64 - area * self.ends.0, 2 * blob.sum_y as i64 - area * self.ends.1);
        let plane = background.level * area + background.per_u * u + background.per_v * v;
        sign(polarity) * (plane - (levels << LEVEL_BITS))
    }

    /// Sum of all weights, and of the weights times u and times v; `None` if values could overflow.
    fn moments(
        &self,
        background: &Plane,
        low: i64,
        high: i64,
        polarity: Polarity,
    ) -> Option<(i64, i64, i64)> {
        let left = self.spans.iter().map(|span| span.0).min()?.max(0);
        let right = self.spans.iter().map(|span| span.1).max()?.min(self.image.width() as i64 - 1);
        let bottom = self.top + self.spans.len() as i64 - 1;
        // A plane is largest in a corner. Half of the range is left for the image's levels.
        let corner = |x: i64, y: i64| background.at(self.u(x), self.v(y)).abs() < i64::from(i32::MAX / 2);
        let bounded = [left, right].iter().all(|&x| corner(x, self.top) && corner(x, bottom));
        let (low, high) = (i32::try_from(low).ok()?, i32::try_from(high).ok()?);
        // With column weights below 2^32, all moments stay below 2^63.
        let tall = i64::from(high - low) * self.spans.len() as i64 > i64::from(u32::MAX);
        if !bounded || tall {
            return None;
        }
        let sign = sign(polarity);
        let (per_x, level) = ((2 * sign * background.per_u) as i32, (sign as i32) << LEVEL_BITS);
        let (mut weight, mut moment_u, mut moment_v) = (0, 0, 0);
        for (y, first, _, levels) in self.rows() {
            let mut plane = (sign * background.at(self.u(first), self.v(y))) as i32;
            let weighted = summed(levels, |grey| {
                let contrast = plane.wrapping_sub(level.wrapping_mul(i32::from(grey)));
                plane = plane.wrapping_add(per_x);
                i64::from(contrast.max(low).min(high)) - i64::from(low)
            });
            weight += weighted.0;
            moment_u += weighted.0 * self.u(first) + 2 * weighted.1;
            moment_v += weighted.0 * self.v(y);
        }
        Some((weight, moment_u, moment_v))
    }

    /// Least-squares plane through the outermost pixels.
    fn background(&self) -> Option<Plane> {
        let bottom = self.top + self.spans.len() as i64 - 1;
        let mut s = [0_i64; 9]; // 1, u, v, uu, uv, vv, g, gu, gv
        for (y, first, last, levels) in self.rows() {
            let span = self.spans[(y - self.top) as usize];
            let (u_first, v) = (self.u(first), self.v(y));
            let [n, u, uu, g, gu] = if y == self.top || y == bottom {
                let (n, middle) = (last + 1 - first, first + last - self.ends.0);
                let (g, along) = summed(levels, i64::from);
                // Over u = middle - (n - 1), middle - (n - 3), ..., middle + (n - 1).
                let uu = n * middle * middle + n * (n * n - 1) / 3;
                [n, n * middle, uu, g, g * u_first + 2 * along]
            } else {
                // The span's ends, if they lie within the image.
                let end = |x: i64, lies: bool| {
                    let (n, u, g) = (i64::from(lies), self.u(x), i64::from(levels[(x - first) as usize]));
                    [n, n * u, n * u * u, n * g, n * g * u]
                };
                let (one, other) = (end(first, first == span.0), end(last, last == span.1 && last > first));
                core::array::from_fn(|i| one[i] + other[i])
            };
            for (sum, term) in s.iter_mut().zip([n, u, v * n, uu, v * u, v * v * n, g, gu, v * g]) {
                *sum += term;
            }
        }
        let [n, u, v, uu, uv, vv, g, gu, gv] = s.map(|sum| sum as f64);
        let normal = DMat3::from_cols(DVec3::new(n, u, v), DVec3::new(u, uu, uv), DVec3::new(v, uv, vv));
        // Pixels on one line do not determine the plane's tilt.
        if normal.determinant() <= 1e-9 * n * uu * vv {
            return None;
        }
        let fit = normal.inverse() * DVec3::new(g, gu, gv) * f64::from(1_u32 << LEVEL_BITS);
        Some(Plane { level: round(fit.x) as i64, per_u: round(fit.y) as i64, per_v: round(fit.z) as i64 })
    }
}

/// Sum of the values of a row's pixels, and of the values times columns from the first one on.
#[inline]
fn summed(levels: &[u8], mut value: impl FnMut(u8) -> i64) -> (i64, i64) {
    let (mut sum, mut sums) = (0, 0);
    for &level in levels {
        sum += value(level);
        sums += sum;
    }
    // The first value is in all of the sums, the last one in one.
    (sum, levels.len() as i64 * sum - sums)
}

/// Sign of the contrast relative to dark markers on a bright gel.
const fn sign(polarity: Polarity) -> i64 {
    match polarity {
        Polarity::Dark => 1,
        Polarity::Bright => -1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::mask::components::Components as MaskComponents;
    use proptest::prelude::*;

    /// Centre of a dark square of 5 pixels with a grey rim, whose first column is the given one, on gel with
    /// a slope.
    fn centre_of(first: usize, [per_x, per_y]: [i32; 2]) -> DVec2 {
        let (width, height) = (32, 16);
        let (mut image, mut mask) = (alloc::vec![0; width * height], alloc::vec![0; width * height]);
        for y in 0..height {
            for x in 0..width {
                // In steps from the square, so that the light is the same wherever it is.
                let (u, v) = (x as i32 - first as i32, y as i32 - 5);
                let gel = 150 + per_x * u + per_y * v;
                let within =
                    |margin: i32| (-margin..5 + margin).contains(&u) && (-margin..5 + margin).contains(&v);
                let depth = if within(0) {
                    80
                } else if within(1) {
                    40
                } else {
                    0
                };
                image[y * width + x] = (gel - depth) as u8;
                mask[y * width + x] = if within(0) { 255 } else { 0 };
            }
        }
        let mut components = MaskComponents::default();
        let blob = components.run(GrayView::new(&mask, width, height, width).unwrap())[0];
        let view = GrayView::new(&image, width, height, width).unwrap();
        let mut rung = WeightedCentroid::new(&DetectParams::default());
        rung.run(view, &blob, components.runs(&blob)) - DVec2::new(first as f64, 5.0)
    }

    proptest! {
        /// The rim of a dot one pixel from the border is no gel: the centre is that of a dot amid the image.
        #[test]
        fn a_dot_beside_the_border_has_its_own_centre(per_x in -2..=2, per_y in -2..=2) {
            let [beside, amid] = [1, 12].map(|first| centre_of(first, [per_x, per_y]));
            prop_assert!(beside.distance(amid) < 1e-3, "{beside} {amid}");
        }
    }
}
