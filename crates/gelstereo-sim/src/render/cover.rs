//! Pixel coverage by ink with sharp edges.
//!
//! A row of pixels is cut by horizontal lines, along which coverage is exact. The coverage by a line
//! from a to b is a ramp over the pixel that contains a, minus one over the pixel that contains b. Each
//! ramp is the running sum of two numbers. A line therefore takes four additions whatever its length,
//! and one sum along the row serves all of its lines. Numbers are integers in units of 2^-16 of a pixel,
//! so nothing remains beside the ink.

use super::shape::{Shape, each_interval};
use gelstereo_core::math::{ceil, floor};

/// Horizontal lines per row of pixels.
const LINES: usize = 8;

/// Parts of a pixel along a line.
const PARTS: i32 = 1 << 16;

/// Adding this to a number below 2^35 leaves parts of a pixel, rounded, in the lowest bits: 1.5 · 2^52 /
/// 2^16.
const WHOLE_PARTS: f64 = 103_079_215_104.0;

/// Maximum of columns that are computed at once; wider regions are drawn in strips.
const MAX_COLUMNS: usize = 62;

/// Adds, times `share`, the share of every pixel that lies within any of the regions.
pub(crate) fn cover(shapes: &[Shape], share: f64, canvas: &mut [f32], width: usize) {
    let height = canvas.len() / width;
    if !shapes.iter().any(|shape| shape.seen(0.0, [width, height])) {
        return;
    }
    let bounds = |shape: &Shape| (shape.low, shape.high);
    let Some((low, high)) = shapes.iter().map(bounds).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else {
        return;
    };
    // Half a pixel more because `as` rounds towards zero and clamps.
    let pixels = |low: f64, high: f64, size: usize| {
        let last = (ceil(high - 0.5).max(0.0) as usize).min(size - 1);
        (floor(low + 0.5).max(0.0) as usize, last + 1)
    };
    let (first, last) = pixels(low.y, high.y, height);
    let (left, right) = pixels(low.x, high.x, width);
    for left in (left..right).step_by(MAX_COLUMNS) {
        let columns = left..right.min(left + MAX_COLUMNS);
        let (border, end) = (left as f64 - 0.5, columns.end as f64 - 0.5);
        let clipped = low.x < border || high.x > end;
        let mut strip = Strip { left: border, columns: columns.len() as f64, clipped, sums: [0; 65] };
        for y in first..last {
            let (top, bottom) = (low.y.max(y as f64 - 0.5), high.y.min(y as f64 + 0.5));
            let thickness = (bottom - top).max(0.0) / LINES as f64;
            let heights = core::array::from_fn(|line| top + (line as f64 + 0.5) * thickness);
            strip.cut(shapes, heights);
            strip.add((share * thickness) as f32, &mut canvas[y * width..][columns.clone()]);
        }
    }
}

/// Consecutive pixels of a row.
struct Strip {
    /// Left border of the first one.
    left: f64,
    columns: f64,
    /// Whether ink extends beyond them.
    clipped: bool,
    /// Change of coverage from the pixel before, in parts of a line; zero between two rows.
    sums: [i32; 65],
}

impl Strip {
    fn cut(&mut self, shapes: &[Shape], heights: [f64; LINES]) {
        match shapes {
            [shape] => self.lay(shape.cuts(heights)),
            _ => {
                for y in heights {
                    each_interval(shapes, y, |ends| self.lay([[ends.0], [ends.1]]));
                }
            }
        }
    }

    /// Adds the lines' coverage of the pixels.
    #[inline]
    fn lay<const COUNT: usize>(&mut self, [from, to]: [[f64; COUNT]; 2]) {
        self.ramps::<COUNT, 1>(from);
        self.ramps::<COUNT, -1>(to);
    }

    /// Adds everything to the right of these places, `TIMES` times.
    #[inline]
    fn ramps<const COUNT: usize, const TIMES: i32>(&mut self, places: [f64; COUNT]) {
        let mut parts = [0; COUNT];
        for (parts, x) in parts.iter_mut().zip(places) {
            let x = x - self.left;
            let x = if self.clipped { x.max(0.0).min(self.columns) } else { x };
            *parts = (x + WHOLE_PARTS).to_bits();
        }
        for parts in parts {
            // At most 63 by the strip's width; the mask avoids a bounds check.
            let (column, before) = ((parts >> 16) as usize & 63, parts as i32 & (PARTS - 1));
            self.sums[column] += TIMES * (PARTS - before);
            self.sums[column + 1] += TIMES * before;
        }
    }

    /// Adds the coverage by lines of this thickness to the row, and resets the sums.
    fn add(&mut self, thickness: f32, row: &mut [f32]) {
        let part = thickness / PARTS as f32;
        let mut covered = 0;
        for (pixel, more) in row.iter_mut().zip(&mut self.sums) {
            covered += core::mem::take(more);
            *pixel += part * covered as f32;
        }
        // A line's end may lie on the border of the last pixel.
        self.sums[row.len()] = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Ellipse;
    use alloc::vec::Vec;
    use gelstereo_core::math::{DVec2, cos, sin};
    use proptest::prelude::*;

    const SIDES: [usize; 2] = [150, 40];

    /// Coverage of one pixel by brute force: the same lines, cut at its borders.
    fn share(shapes: &[Shape], [x, y]: [usize; 2], rows: (f64, f64)) -> f64 {
        let (x, y) = (x as f64, y as f64);
        let (top, bottom) = (rows.0.max(y - 0.5), rows.1.min(y + 0.5));
        let step = (bottom - top).max(0.0) / LINES as f64;
        let mut sum = 0.0;
        for line in 0..LINES {
            each_interval(shapes, top + (line as f64 + 0.5) * step, |(from, to)| {
                sum += step * (to.min(x + 0.5) - from.max(x - 0.5)).max(0.0);
            });
        }
        sum
    }

    fn shape(&(x, y, radius, turn): &(f64, f64, f64, f64)) -> Option<Shape> {
        let (s, c) = (sin(turn), cos(turn));
        let half_px = [DVec2::new(c, s) * radius, DVec2::new(-s, c) * (0.7 * radius)];
        Shape::ellipse(&Ellipse { centre_px: DVec2::new(x, y), half_px })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        /// One or several regions, wider than a strip and cut by the image's border. Ends are rounded to
        /// 2^-17 of a pixel on either side, and sums to 24 bits.
        #[test]
        fn coverage_is_that_of_lines_cut_at_every_pixel(
            places in prop::collection::vec((-20.0..170.0, -10.0..50.0, 0.3..90.0, 0.0..3.2), 1..4),
        ) {
            let shapes: Vec<Shape> = places.iter().filter_map(shape).collect();
            let mut canvas = alloc::vec![0.0_f32; SIDES[0] * SIDES[1]];
            cover(&shapes, 1.0, &mut canvas, SIDES[0]);
            let rows = shapes.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |rows, shape| {
                (shape.low.y.min(rows.0), shape.high.y.max(rows.1))
            });
            for (i, &found) in canvas.iter().enumerate() {
                let expected = share(&shapes, [i % SIDES[0], i / SIDES[0]], rows);
                prop_assert!((f64::from(found) - expected).abs() < 2e-5, "{found} for {expected} at {i}");
                prop_assert!(expected > 0.0 || found == 0.0, "{found} beside the ink");
            }
        }
    }
}
