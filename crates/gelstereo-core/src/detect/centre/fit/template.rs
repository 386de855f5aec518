//! Start of a fit: one step from the usual marker's outline, with weights precomputed for the image.
//!
//! The markers of an image are alike. The first step from the usual outline, at the nearest of 4 x 4
//! sub-pixel positions, is linear in the levels except for the division by the contrast. Its weights
//! therefore serve all markers (as the template's slopes do in Baker and Matthews, "Lucas-Kanade 20 years
//! on", IJCV 2004, section 3.2). It costs a tenth of a step with the marker's own outline, and leaves
//! that step a few hundredths of a pixel.

use super::disc::{ANSWERS, Answers, Outline, Window};
use super::edge::Edge;
use super::lanes::WIDTH;
use super::step::apply;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, floor};
use alloc::vec::Vec;

/// Sub-pixel positions per axis.
const PLACES: usize = 4;
/// Larger windows, pixels, have no template: few markers need them.
const MAX_PIXELS: usize = 512;
const MAX_CELLS: usize = MAX_PIXELS / WIDTH;
/// Least contrast, grey levels.
const MIN_CONTRAST: f64 = 1.0;

/// The usual marker of an image.
#[derive(Clone, Debug)]
pub(super) struct Template {
    /// Radius of its window; 0 for none.
    radius_px: f64,
    /// Form of its outline.
    form: [f64; 3],
    cells: usize,
    /// By sub-pixel position, then by cell.
    answers: Vec<Answers>,
}

impl Template {
    pub fn new() -> Self {
        Self { radius_px: 0.0, form: [0.0; 3], cells: 0, answers: Vec::new() }
    }

    pub fn forget(&mut self) {
        self.radius_px = 0.0;
    }

    /// Radius of its window, px.
    pub const fn radius_px(&self) -> f64 {
        self.radius_px
    }

    /// Computes the weights for an outline of this spread; `per_ground` is the contrast over the ground's
    /// level.
    pub fn learn(
        &mut self,
        window: &mut Window,
        (spread_px2, radius_px): (&Symmetric<2>, f64),
        per_ground: f64,
        (blur_px, edge): (f64, &Edge),
    ) {
        self.forget();
        self.answers.clear();
        self.answers.reserve(PLACES * PLACES * MAX_CELLS);
        let pixels = window.lay(radius_px);
        if pixels > MAX_PIXELS {
            return;
        }
        for place in 0..PLACES * PLACES {
            let Some(outline) = Outline::new(place_of(place), spread_px2) else { return };
            window.draw(&outline, blur_px, edge);
            let Some(follow) = window.follow() else { return };
            window.light(per_ground);
            let Some(factor) = Factor::new(&window.matrix(&follow, blur_px)) else { return };
            window.answers(&factor, &follow, &mut self.answers);
            self.form = outline.form;
        }
        (self.radius_px, self.cells) = (radius_px, pixels.div_ceil(WIDTH));
    }

    /// Outline after its first step, starting near `at`. `None` if the window's extent differs from the
    /// template's.
    pub fn start(&self, window: &Window, at: DVec2) -> Option<Outline> {
        if !window.is_whole(self.radius_px) {
            return None;
        }
        let place = nearest_place(at);
        let sums = window.sum_answers(&self.answers[place * self.cells..][..self.cells]);
        let contrast = sums[ANSWERS - 1];
        if !(contrast * contrast > MIN_CONTRAST * MIN_CONTRAST) {
            return None;
        }
        let mut outline = Outline { centre: place_of(place), form: self.form };
        let step = core::array::from_fn(|k| sums[k] / contrast);
        apply(&mut outline, &step);
        Some(outline)
    }
}

/// Offset of a sub-pixel position from the pixel's middle.
fn place_of(place: usize) -> DVec2 {
    let middle = |k: usize| (k as f64 + 0.5) / PLACES as f64 - 0.5;
    DVec2::new(middle(place % PLACES), middle(place / PLACES))
}

fn nearest_place(at: DVec2) -> usize {
    let nearest = |at: f64| floor((at + 0.5) * PLACES as f64).clamp(0.0, (PLACES - 1) as f64) as usize;
    nearest(at.y) * PLACES + nearest(at.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::GrayView;
    use crate::math::{erf, hypot, round_even};

    const BLUR_PX: f64 = 0.9;
    const GROUND: f64 = 170.0;
    const CONTRAST: f64 = -120.0;

    /// A blurred disc's edge in light with a slope, in whole levels.
    fn image(centre: DVec2, radius_px: f64, side: usize) -> Vec<u8> {
        let level = |x: usize, y: usize| {
            let (x, y) = (x as f64, y as f64);
            let off = (hypot(x - centre.x, y - centre.y) - radius_px) / BLUR_PX;
            let share = 0.5 - 0.5 * erf(off * core::f64::consts::FRAC_1_SQRT_2);
            let light = GROUND + 0.3 * (x - centre.x) - 0.2 * (y - centre.y);
            round_even(light * (1.0 + CONTRAST / GROUND * share)) as u8
        };
        (0..side * side).map(|n| level(n % side, n / side)).collect()
    }

    /// Tolerances: the remainder of a step is of third order for the centre, (0.3 / 0.9)² / 8 of 0.3 px,
    /// and of second order for the radius, 0.3² / 4.2 / 2; rounding adds 0.29 / 120 px.
    #[test]
    fn one_step_finds_discs_that_are_nearly_the_usual_one() {
        let (radius_px, window_px, side) = (4.2, 8.0, 24);
        let mut edge = Edge::new();
        edge.weigh_alike(BLUR_PX);
        let (mut template, mut window) = (Template::new(), Window::default());
        let spread_px2 = [[radius_px * radius_px, 0.0], [0.0, radius_px * radius_px]];
        template.learn(&mut window, (&spread_px2, window_px), CONTRAST / GROUND, (BLUR_PX, &edge));
        for (x, y, wider_px) in [(0.0, 0.0, 0.0), (0.31, -0.22, 0.0), (-0.5, 0.5, 0.1), (0.1, 0.2, -0.15)] {
            let (guess, centre) = (DVec2::new(12.0, 12.0), DVec2::new(12.0 + x, 12.0 + y));
            let levels = image(centre, radius_px + wider_px, side);
            let view = GrayView::new(&levels, side, side, side).unwrap();
            // The guess is a tenth of a pixel off.
            let near = guess + DVec2::new(x, y) * 0.8 + DVec2::new(0.08, -0.06);
            window.load(view, near, window_px);
            let outline = template.start(&window, near - window.origin).unwrap();
            let [[xx, _], [_, yy]] = outline.spread_px2().unwrap();
            let found = window.origin + outline.centre;
            assert!(found.distance(centre) < 0.012, "{x} {y}: {found:?}");
            let off_px = (0.5 * (xx + yy)).sqrt() - (radius_px + wider_px);
            assert!(off_px.abs() < 0.03, "{x} {y} {wider_px}: {off_px}");
        }
    }

    #[test]
    fn windows_that_the_image_cuts_have_no_start() {
        let (mut edge, mut template, mut window) = (Edge::new(), Template::new(), Window::default());
        edge.weigh_alike(BLUR_PX);
        let spread_px2 = [[9.0, 0.0], [0.0, 9.0]];
        template.learn(&mut window, (&spread_px2, 6.0), CONTRAST / GROUND, (BLUR_PX, &edge));
        let levels = image(DVec2::splat(5.0), 3.0, 24);
        let view = GrayView::new(&levels, 24, 24, 24).unwrap();
        window.load(view, DVec2::splat(5.0), 6.0);
        assert!(template.start(&window, DVec2::ZERO).is_none());
        window.load(view, DVec2::splat(6.0), 6.0);
        assert!(template.start(&window, DVec2::ZERO).is_some());
    }
}
