//! Ink through a blurring lens, without a fine canvas.
//!
//! A pixel weights points by k(x) k(y) about its centre (see [`Lens`]). Its value for a region is ∫ k(v)
//! [K(right(v)) - K(left(v))] dv, where K is the integral of k and the region is cut from left to right
//! at height v. Along a line the integral is exact, and lines are summed. For an ellipse, the sum over
//! the lines v = h sin t, t in equal steps, is the trapezoid rule on a smooth periodic function (its
//! outline once around). It converges faster than any power. With steps of 1.3 sigma along the outline
//! the error is 2e-5 of the contrast: the transform of the lens's Gaussian at that step, 2 exp(-2 π² /
//! 1.3²).

use super::Ellipse;
use super::lens::Lens;
use super::profile::{BLOCK, Block, Profile};
use super::shape::{Shape, each_interval};
use alloc::boxed::Box;
use alloc::vec::Vec;
use core::f64::consts::PI;
use gelstereo_core::math::{DVec2, ceil, cos, sin};

/// Lines of an ellipse, in addition to two, per sigma of its longest half diameter. A step along the
/// outline is at most π / 2.2 sigma.
const LINES_PER_SIGMA: f64 = 2.2;

/// Ellipses that need more lines are cut like any other region, within the image only.
const MAX_LINES: usize = 256;

/// Lines per pixel (or per half a sigma of the lens if that is longer) over a region that is no ellipse.
/// They are spaced as for an ellipse between any two heights where a part of the region begins or ends.
const DENSE_LINES: f64 = 32.0;

/// Maximum of columns in a window; wider ones are drawn in parts.
const MAX_COLUMNS: usize = 32;

/// Lines that are summed at once: enough for a dot; more are drawn in parts.
const MAX_AT_ONCE: usize = 24;

/// Draws blurred ink.
#[derive(Clone, Debug)]
pub(crate) struct Soft {
    lens: Lens,
    edges: Profile,
    points: Profile,
    /// (sine, cosine) of half a step, by number of lines.
    half_steps: Vec<(f64, f64)>,
    /// Reach of a pixel, in whole pixels.
    reach: usize,
    sheaf: Box<Sheaf>,
    /// Heights between which a region's outline is smooth.
    breaks: Vec<f64>,
}

/// Lines across a window, from its top downwards.
#[derive(Clone, Debug)]
struct Sheaf {
    lines: usize,
    heights: [f64; MAX_AT_ONCE],
    thickness: [f32; MAX_AT_ONCE],
    /// Each line's contribution to the columns, in as many blocks as the window has.
    shares: Vec<Block>,
    /// Each line's weights for the rows around it.
    weights: Vec<f32>,
    /// Row of each line's first weight, counted from the window's top.
    first_rows: [i32; MAX_AT_ONCE],
}

/// A part of the image: the pixels within reach of a region.
#[derive(Clone, Copy, Debug)]
struct Window {
    left: usize,
    top: usize,
    columns: usize,
    rows: usize,
}

impl Soft {
    /// For images with at most this many overlapping regions.
    pub(crate) fn new(lens: Lens, regions: usize) -> Self {
        let half_step = |lines: usize| {
            let angle = 0.5 * PI / lines.max(1) as f64;
            (sin(angle), cos(angle))
        };
        let reach = lens.reach();
        let points = Profile::new(reach, |x| lens.point(x));
        Self {
            lens,
            // Covers any column of a window, from any place within reach of one of its columns.
            edges: Profile::new(reach + MAX_COLUMNS, |x| lens.edge(x)),
            reach,
            half_steps: (0..=MAX_LINES).map(half_step).collect(),
            sheaf: Box::new(Sheaf::new(points.taps())),
            points,
            breaks: Vec::with_capacity(2 * regions),
        }
    }

    /// Adds `share` of every pixel's view of an ellipse.
    pub(crate) fn ellipse(&mut self, ellipse: &Ellipse, share: f64, canvas: &mut [f32], width: usize) {
        let Some(shape) = Shape::ellipse(ellipse) else { return };
        let lines = 2.0 + LINES_PER_SIGMA * ellipse.longest_px() / self.lens.sigma_px;
        if !(lines < MAX_LINES as f64) {
            return self.union(&[shape], share, canvas, width);
        }
        self.draw(&[shape], [shape.low, shape.high], (ceil(lines) as usize, share), canvas, width);
    }

    /// Adds `share` of every pixel's view of overlapping regions, counting each point once.
    pub(crate) fn union(&mut self, shapes: &[Shape], share: f64, canvas: &mut [f32], width: usize) {
        // Lines out of reach of every row are omitted.
        let reach = self.lens.reach_px();
        let end = (canvas.len() / width) as f64 - 1.0 + reach;
        let mut breaks = core::mem::take(&mut self.breaks);
        breaks.clear();
        breaks.extend(shapes.iter().flat_map(|shape| [shape.low.y, shape.high.y]));
        breaks.iter_mut().for_each(|y| *y = y.clamp(-reach, end));
        breaks.sort_unstable_by(f64::total_cmp);
        let left = shapes.iter().fold(f64::INFINITY, |left, shape| left.min(shape.low.x));
        let right = shapes.iter().fold(f64::NEG_INFINITY, |right, shape| right.max(shape.high.x));
        let per_px = DENSE_LINES.min(2.0 * DENSE_LINES / self.lens.sigma_px);
        for ends in breaks.windows(2).filter(|ends| ends[1] > ends[0]) {
            let corners = [DVec2::new(left, ends[0]), DVec2::new(right, ends[1])];
            let lines = (ceil((ends[1] - ends[0]) * per_px) as usize).max(4);
            self.draw(shapes, corners, (lines, share), canvas, width);
        }
        self.breaks = breaks;
    }

    /// Draws `share` of the region between two corners, cut by this many lines.
    fn draw(
        &mut self,
        shapes: &[Shape],
        corners: [DVec2; 2],
        lines: (usize, f64),
        canvas: &mut [f32],
        width: usize,
    ) {
        let Some(whole) = self.window(corners, canvas.len(), width) else { return };
        let (end, heights) = (whole.left + whole.columns, corners.map(|corner| corner.y));
        for left in (whole.left..end).step_by(MAX_COLUMNS) {
            let window = Window { left, columns: MAX_COLUMNS.min(end - left), ..whole };
            let image = (&mut *canvas, width);
            match window.columns.div_ceil(BLOCK) {
                1..=4 => self.cut::<4>(window, shapes, heights, lines, image),
                5 => self.cut::<5>(window, shapes, heights, lines, image),
                6 => self.cut::<6>(window, shapes, heights, lines, image),
                _ => self.cut::<8>(window, shapes, heights, lines, image),
            }
        }
    }

    /// Pixels within reach of the rectangle between these corners.
    fn window(&self, [low, high]: [DVec2; 2], pixels: usize, width: usize) -> Option<Window> {
        let reach = self.lens.reach_px();
        let end = DVec2::new((width - 1) as f64, (pixels / width - 1) as f64);
        let first = (low - reach).ceil().max(DVec2::ZERO);
        let last = (high + reach).floor().min(end);
        first.cmple(last).all().then(|| Window {
            left: first.x as usize,
            top: first.y as usize,
            columns: (last.x - first.x) as usize + 1,
            rows: (last.y - first.y) as usize + 1,
        })
    }

    /// Draws a window. Lines are denser towards both heights: y = middle + half sin t.
    fn cut<const BLOCKS: usize>(
        &mut self,
        mut window: Window,
        shapes: &[Shape],
        [from, to]: [f64; 2],
        (lines, share): (usize, f64),
        (canvas, width): (&mut [f32], usize),
    ) {
        // Whole blocks, within the image.
        window.columns = (width - window.left).min(BLOCKS * BLOCK);
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let angle = 0.5 * PI / lines as f64;
        let (s, c) = self.half_steps.get(lines).copied().unwrap_or_else(|| (sin(angle), cos(angle)));
        // From -π/2 plus half a step, rotated by whole steps.
        let (turn_sin, turn_cos) = (2.0 * s * c, c * c - s * s);
        let (mut sin_t, mut cos_t) = (-c, s);
        let thickest = 2.0 * angle * half * share;
        for first in (0..lines).step_by(MAX_AT_ONCE) {
            self.sheaf.lines = MAX_AT_ONCE.min(lines - first);
            let places = self.sheaf.heights.iter_mut().zip(&mut self.sheaf.thickness);
            for (y, thickness) in places.take(lines - first) {
                (*y, *thickness) = (middle + half * sin_t, (thickest * cos_t) as f32);
                (sin_t, cos_t) = (sin_t * turn_cos + cos_t * turn_sin, cos_t * turn_cos - sin_t * turn_sin);
            }
            self.sheaf.share::<BLOCKS>(&self.edges, Span::of(window, self.reach), shapes);
            self.sheaf.weigh(&self.points, window.top);
            self.sheaf.add::<BLOCKS>((self.points.taps(), self.lens.reach_px()), window, canvas, width);
        }
    }
}

/// Columns of a window: the place of the first one, and, relative to it, the first and last places
/// within reach.
#[derive(Clone, Copy, Debug)]
struct Span {
    left: f64,
    first: f64,
    last: f64,
}

impl Span {
    fn of(window: Window, reach: usize) -> Self {
        let (reach, columns) = (reach as f64, window.columns as f64);
        Self { left: window.left as f64, first: -reach, last: columns - 1.0 + reach }
    }

    /// Offset from the first column, clamped to the places within reach.
    #[inline]
    fn within(self, x: f64) -> f64 {
        // (`f64::clamp` keeps NaN, which does not occur here, and is slower.)
        let x = x - self.left;
        let x = if x > self.first { x } else { self.first };
        if x < self.last { x } else { self.last }
    }

    /// An interval's contribution to every column.
    #[inline(always)]
    fn between<const BLOCKS: usize>(self, edges: &Profile, (from, to): (f64, f64)) -> [Block; BLOCKS] {
        let (from, first) = edges.about(self.within(from));
        let (to, last) = edges.about(self.within(to));
        // The columns begin at 0.
        let (mut line, to) = (from.blocks::<BLOCKS>(-first as usize), to.blocks::<BLOCKS>(-last as usize));
        for (shares, to) in line.iter_mut().zip(&to) {
            shares.iter_mut().zip(to).for_each(|(share, to)| *share -= to);
        }
        line
    }
}

impl Sheaf {
    fn new(taps: usize) -> Self {
        Self {
            lines: 0,
            heights: [0.0; MAX_AT_ONCE],
            thickness: [0.0; MAX_AT_ONCE],
            shares: alloc::vec![Block::default(); MAX_AT_ONCE * MAX_COLUMNS.div_ceil(BLOCK)],
            weights: alloc::vec![0.0; MAX_AT_ONCE * taps],
            first_rows: [0; MAX_AT_ONCE],
        }
    }

    /// Computes the lines' contributions to the columns.
    fn share<const BLOCKS: usize>(&mut self, edges: &Profile, span: Span, shapes: &[Shape]) {
        let lines = self.shares.as_chunks_mut::<BLOCKS>().0.iter_mut().zip(&self.heights[..self.lines]);
        if let [shape] = shapes {
            return lines.for_each(|(line, &y)| *line = span.between(edges, shape.cut(y))); // no sum needed
        }
        for (line, &y) in lines {
            *line = [Block::default(); BLOCKS];
            each_interval(shapes, y, |ends| {
                let interval = span.between::<BLOCKS>(edges, ends);
                let sums = line.as_flattened_mut().iter_mut().zip(interval.as_flattened());
                sums.for_each(|(sum, share)| *sum += share);
            });
        }
    }

    /// Computes the lines' weights for the rows.
    fn weigh(&mut self, points: &Profile, top: usize) {
        let lines = self.heights[..self.lines].iter().zip(&self.thickness).zip(&mut self.first_rows);
        let top = top as f64;
        for (((&y, &thickness), first_row), weights) in
            lines.zip(self.weights.chunks_exact_mut(points.taps()))
        {
            let (about, first) = points.about(y - top);
            *first_row = first;
            about.weigh(thickness, weights);
        }
    }

    /// Adds to every row of the window the lines within its reach.
    fn add<const BLOCKS: usize>(
        &mut self,
        (taps, reach_px): (usize, f64),
        window: Window,
        canvas: &mut [f32],
        width: usize,
    ) {
        let lines = &self.shares.as_chunks::<BLOCKS>().0[..self.lines];
        let heights = &self.heights[..self.lines];
        let first_weights = &mut self.first_rows[..self.lines];
        first_weights.iter_mut().zip(0_i32..).for_each(|(row, line)| *row = line * taps as i32 - *row);
        let (mut seen, mut begun) = (0, 0);
        let rows = canvas[window.top * width..].chunks_exact_mut(width).take(window.rows);
        for (row, y) in rows.zip(0_i32..) {
            // From top to bottom, lines enter and leave the reach in their order.
            let above = (window.top as i32 + y) as f64 - reach_px;
            let below = above + 2.0 * reach_px;
            begun += heights[begun..].iter().take_while(|&&height| height <= below).count();
            seen += heights[seen..begun].iter().take_while(|&&height| height < above).count();
            let mut sums = [Block::default(); BLOCKS];
            for (line, &first_weight) in lines[seen..begun].iter().zip(&first_weights[seen..begun]) {
                let weight = self.weights[(first_weight + y) as usize];
                for (sums, shares) in sums.iter_mut().zip(line) {
                    sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum += weight * share);
                }
            }
            let row = &mut row[window.left..][..window.columns];
            match row.as_chunks_mut::<BLOCK>().0.first_chunk_mut::<BLOCKS>() {
                Some(row) => {
                    for (pixels, sums) in row.iter_mut().zip(&sums) {
                        pixels.iter_mut().zip(sums).for_each(|(pixel, sum)| *pixel += sum);
                    }
                }
                None => row.iter_mut().zip(sums.as_flattened()).for_each(|(pixel, sum)| *pixel += sum),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::UnevenLight;
    use crate::render::displacement;
    use crate::render::fine::Fine;
    use crate::render::overlap::Overlaps;
    use proptest::prelude::*;

    const SIDE: usize = 48;

    /// Relative to the contrast: error of the lines, and error of 16 fine pixels per pixel in the
    /// reference.
    const LINES: f64 = 4e-5;
    const FINE: f64 = 4e-5;

    /// Share of the lens that is cut off, at both ends of both axes.
    fn cut_off(lens: Lens) -> f64 {
        4.0 * lens.edge(-lens.reach_px())
    }

    fn tolerance(lens: Lens) -> f64 {
        LINES + cut_off(lens) + FINE
    }

    fn ellipse(x: f64, y: f64, radius: f64, stretch: f64, turn: f64) -> Ellipse {
        let (s, c) = (sin(turn), cos(turn));
        let half_px = [DVec2::new(c, s) * (radius * stretch), DVec2::new(-s, c) * (radius / stretch)];
        Ellipse { centre_px: DVec2::new(x, y), half_px }
    }

    fn shapes(ellipses: &[Ellipse]) -> Vec<Shape> {
        ellipses.iter().filter_map(Shape::ellipse).collect()
    }

    fn largest_difference(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
    }

    fn soft(ellipse: &Ellipse, lens: Lens) -> Vec<f32> {
        let mut canvas = alloc::vec![0.0; SIDE * SIDE];
        Soft::new(lens, 9).ellipse(ellipse, 1.0, &mut canvas, SIDE);
        canvas
    }

    fn union(shapes: &[Shape], lens: Lens) -> Vec<f32> {
        let mut canvas = alloc::vec![0.0; SIDE * SIDE];
        Soft::new(lens, 9).union(shapes, 1.0, &mut canvas, SIDE);
        canvas
    }

    fn fine(shapes: &[Shape], lens: Lens, light: Option<&UnevenLight>) -> Vec<f32> {
        let mut canvas = alloc::vec![0.0; SIDE * SIDE];
        let mut overlaps = Overlaps::default();
        overlaps.find(shapes);
        Fine::finer(lens, 16).draw((shapes, &overlaps), light, 1.0, &mut canvas, SIDE);
        canvas
    }

    fn centroid(canvas: &[f32]) -> DVec2 {
        let (mut area, mut moment) = (0.0, DVec2::ZERO);
        for (i, &share) in canvas.iter().enumerate() {
            area += f64::from(share);
            moment += DVec2::new((i % SIDE) as f64, (i / SIDE) as f64) * f64::from(share);
        }
        moment / area
    }

    /// Regression: a window that was moved back into the image counted columns twice.
    #[test]
    fn a_dot_as_wide_as_the_canvas_has_each_column_once() {
        let (ellipse, lens) = (ellipse(18.0, 18.0, 7.58, 0.8, 2.449), Lens { sigma_px: 2.48 });
        let off = largest_difference(&soft(&ellipse, lens), &fine(&shapes(&[ellipse]), lens, None));
        assert!(off < tolerance(lens), "{off}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn an_ellipse_is_what_fine_pixels_say(
            x in 18.0..30.0, y in 18.0..30.0, radius in 1.0..8.0, stretch in 0.8..1.25, turn in 0.0..3.2,
            sigma_px in 0.7..2.5,
        ) {
            let (ellipse, lens) = (ellipse(x, y, radius, stretch, turn), Lens { sigma_px });
            let found = soft(&ellipse, lens);
            let off = largest_difference(&found, &fine(&shapes(&[ellipse]), lens, None));
            prop_assert!(off < tolerance(lens), "{off}");
            // Shares sum to the area, up to the error of the lines within four sigma of the outline.
            // Their centroid is the ellipse's centre. The lines' error, 4e-5 within four sigma on both
            // sides of the outline, moves it by at most 4 / pi times 4e-5 and 8 sigma: the case of
            // opposite signs on the two halves of the outline. A lens cut off on one side only, 1e-5 of
            // it at 4.3 sigma, adds 6e-5 sigma.
            let area: f64 = found.iter().map(|&share| f64::from(share)).sum();
            let share = area / (PI * ellipse.radius_px() * ellipse.radius_px());
            let blurred = (1.0 + 4.0 * sigma_px / ellipse.radius_px()).powi(2);
            prop_assert!((share - 1.0).abs() < LINES * blurred + cut_off(lens), "{share}");
            let off = (centroid(&found) - ellipse.centre_px).length();
            prop_assert!(off < 4.7e-4 * sigma_px, "{off} px");
        }

        /// Anywhere around the image's border, however much of the ellipse is visible.
        #[test]
        fn a_border_cuts_and_changes_nothing_else(
            x in -10.0..58.0, y in -10.0..58.0, radius in 1.0..12.0, sigma_px in 0.6..2.0,
        ) {
            let (ellipse, lens) = (ellipse(x, y, radius, 1.1, 0.3), Lens { sigma_px });
            let off = largest_difference(&soft(&ellipse, lens), &fine(&shapes(&[ellipse]), lens, None));
            prop_assert!(off < tolerance(lens), "{off}");
        }

        #[test]
        fn ink_that_overlaps_counts_once(
            x in 18.0..30.0, y in 18.0..30.0, apart in 0.0..14.0, turn in 0.0..6.3, radius in 2.0..6.0,
            sigma_px in 0.8..2.0,
        ) {
            let lens = Lens { sigma_px };
            let (a, b) = (
                ellipse(x, y, radius, 1.1, 0.3),
                ellipse(x + apart * cos(turn), y + apart * sin(turn), 4.0, 1.0, 0.0),
            );
            let bar = [
                a.centre_px - a.half_px[1],
                a.centre_px + a.half_px[1],
                b.centre_px + b.half_px[1],
                b.centre_px - b.half_px[1],
            ];
            let mut all = shapes(&[a, b]);
            all.extend(Shape::bar(bar.map(|corner| a.centre_px.lerp(corner, 0.7))));
            // The region's corners are kinks that lines between two heights do not resolve.
            let off = largest_difference(&union(&all, lens), &fine(&all, lens, None));
            prop_assert!(off < 10.0 * tolerance(lens), "{off}");
            let off = largest_difference(&union(&all[..1], lens), &soft(&a, lens));
            prop_assert!(off < tolerance(lens), "{off}");
        }

        /// The light is as uneven over this image as a scene may have it: several times a camera's.
        #[test]
        fn light_before_the_lens_is_light_behind_it_on_ink_nearer_to_the_dark(
            x in 14.0..34.0, y in 14.0..34.0, across in -0.1..0.1, down in -0.1..0.1,
            corner_loss in 0.0..0.05,
        ) {
            let light = UnevenLight { gain: 1.0, across, down, corner_loss };
            let lens = Lens { sigma_px: 0.8 };
            let dot = ellipse(x, y, 4.3, 1.1, 0.3);
            let size = [SIDE; 2];
            let centre_px = dot.centre_px + displacement(&light, lens, dot.centre_px, size);
            let lit = |(i, share): (usize, &f32)| {
                let at = DVec2::new((i % SIDE) as f64, (i / SIDE) as f64);
                share * light.gain(at, DVec2::splat(SIDE as f64)) as f32
            };
            let found = soft(&Ellipse { centre_px, ..dot }, lens);
            let found: Vec<f32> = found.iter().enumerate().map(lit).collect();
            let expected = fine(&shapes(&[dot]), lens, Some(&light));
            let off = largest_difference(&found, &expected);
            prop_assert!(off < 2.0 * tolerance(lens), "{off}");
            let off = (centroid(&found) - centroid(&expected)).length();
            prop_assert!(off < 1e-4, "{off} px");
        }
    }

    #[test]
    fn dots_that_are_huge_or_nowhere_are_drawn_in_no_time() {
        let lens = Lens { sigma_px: 0.8 };
        let whole = soft(&ellipse(20.0, 24.0, 1e9, 1.0, 0.0), lens);
        assert!(whole.iter().all(|&share| (share - 1.0).abs() < 1e-3));
        for (x, radius) in [(f64::NAN, 4.0), (1e300, 4.0), (20.0, 0.0), (-1e6, 4.0), (20.0, f64::INFINITY)] {
            assert!(soft(&ellipse(x, 24.0, radius, 1.0, 0.0), lens).iter().all(|&share| share == 0.0));
        }
    }
}
