//! From a component to a sub-pixel centre.

use super::components::Blob;
use crate::image::GrayView;
use crate::math::{DMat3, DVec2, DVec3, round};
use crate::params::Polarity;

/// The paper's centre: mean position of the component's pixels.
#[must_use]
pub fn binary(blob: &Blob) -> DVec2 {
    let area = f64::from(blob.area_px2);
    DVec2::new(blob.sum_x as f64 / area, blob.sum_y as f64 / area)
}

/// Pixels by which the bounding box grows on each side: wide enough that the frame of pixels around it lies on the
/// gel, beyond the blurred edge of the marker.
const MARGIN_PX: u32 = 2;

/// Fractional bits of grey levels here; with 8 + 12 bits, and coordinates below 2^15, sums over 2^24 pixels fit 64.
const LEVEL_BITS: u32 = 12;

/// Mean position weighted by contrast, over the component's bounding box and [`MARGIN_PX`] around it.
///
/// The contrast is measured from a plane through the frame of pixels around the box, so that neither a slope of light
/// nor the marker's neighbours (which bend the background of the threshold) shift the centre. It counts from 1/8 of
/// the marker's mean contrast up to that mean only: noise of the gel and grain of the paint then carry no weight, and
/// what is left is the marker's edge, which holds the information about its position. A narrower band would see
/// less noise, but sharp edges pass it within less than a pixel, and the centre would depend on where in a pixel it lies.
///
/// Falls back to [`binary`] where fewer than two sides of the frame lie within the image.
#[must_use]
pub fn grey(image: GrayView<'_>, mask: &[u8], blob: &Blob, polarity: Polarity) -> DVec2 {
    let window = Window::around(blob, image);
    let Some(surround) = window.surround(image) else {
        return binary(blob);
    };
    let sign = match polarity {
        Polarity::Dark => 1,
        Polarity::Bright => -1,
    };
    let contrast =
        |x: u32, y: u32, level: u8| sign * (surround.at(&window, x, y) - (i64::from(level) << LEVEL_BITS));
    let (mut inside, mut pixels) = (0_i64, 0_i64);
    window.visit(image, |x, y, level| {
        if mask[y as usize * image.width() + x as usize] != 0 {
            inside += contrast(x, y, level);
            pixels += 1;
        }
    });
    let mean = inside / pixels.max(1);
    let (low, high) = (mean / 8, mean);
    let (mut weight, mut moment_u, mut moment_v) = (0_i64, 0_i64, 0_i64);
    window.visit(image, |x, y, level| {
        let w = contrast(x, y, level).clamp(low, high) - low;
        weight += w;
        moment_u += w * window.u(x);
        moment_v += w * window.v(y);
    });
    if low >= high || weight <= 0 {
        return binary(blob);
    }
    let half = 0.5 / weight as f64;
    window.centre() + DVec2::new(moment_u as f64 * half, moment_v as f64 * half)
}

/// A rectangle of pixels, ends included, and which of its sides are not cut by the image's border.
struct Window {
    left: u32,
    top: u32,
    right: u32,
    bottom: u32,
    whole: [bool; 4],
}

/// Grey level of the gel as a plane, with [`LEVEL_BITS`] fractional bits.
struct Plane {
    level: i64,
    per_u: i64,
    per_v: i64,
}

impl Plane {
    fn at(&self, window: &Window, x: u32, y: u32) -> i64 {
        self.level + self.per_u * window.u(x) + self.per_v * window.v(y)
    }
}

impl Window {
    fn around(blob: &Blob, image: GrayView<'_>) -> Self {
        let (last_x, last_y) = (image.width() as u32 - 1, image.height() as u32 - 1);
        let (right, bottom) = (blob.right + MARGIN_PX, blob.bottom + MARGIN_PX);
        Self {
            left: blob.left.saturating_sub(MARGIN_PX),
            top: blob.top.saturating_sub(MARGIN_PX),
            right: right.min(last_x),
            bottom: bottom.min(last_y),
            whole: [blob.left >= MARGIN_PX, blob.top >= MARGIN_PX, right <= last_x, bottom <= last_y],
        }
    }

    /// Twice the distance from the window's middle column: whole numbers for any width.
    fn u(&self, x: u32) -> i64 {
        2 * i64::from(x) - i64::from(self.left + self.right)
    }

    fn v(&self, y: u32) -> i64 {
        2 * i64::from(y) - i64::from(self.top + self.bottom)
    }

    fn centre(&self) -> DVec2 {
        DVec2::new(f64::from(self.left + self.right) * 0.5, f64::from(self.top + self.bottom) * 0.5)
    }

    fn visit(&self, image: GrayView<'_>, mut see: impl FnMut(u32, u32, u8)) {
        for y in self.top..=self.bottom {
            let row = &image.row(y as usize)[self.left as usize..=self.right as usize];
            for (x, &level) in (self.left..).zip(row) {
                see(x, y, level);
            }
        }
    }

    fn on_frame(&self, x: u32, y: u32) -> bool {
        let [left, top, right, bottom] = self.whole;
        (left && x == self.left)
            || (top && y == self.top)
            || (right && x == self.right)
            || (bottom && y == self.bottom)
    }

    /// Least-squares plane through the sides of the frame that lie within the image. Two sides determine it.
    fn surround(&self, image: GrayView<'_>) -> Option<Plane> {
        if self.whole.iter().filter(|&&whole| whole).count() < 2 {
            return None;
        }
        let mut s = [0_i64; 9]; // 1, u, v, uu, uv, vv, g, gu, gv
        self.visit(image, |x, y, level| {
            if self.on_frame(x, y) {
                let (u, v, g) = (self.u(x), self.v(y), i64::from(level));
                for (sum, term) in s.iter_mut().zip([1, u, v, u * u, u * v, v * v, g, g * u, g * v]) {
                    *sum += term;
                }
            }
        });
        let [n, u, v, uu, uv, vv, g, gu, gv] = s.map(|sum| sum as f64);
        let normal = DMat3::from_cols(DVec3::new(n, u, v), DVec3::new(u, uu, uv), DVec3::new(v, uv, vv));
        let fit = normal.inverse() * DVec3::new(g, gu, gv) * f64::from(1_u32 << LEVEL_BITS);
        fit.is_finite().then(|| Plane {
            level: round(fit.x) as i64,
            per_u: round(fit.y) as i64,
            per_v: round(fit.z) as i64,
        })
    }
}
