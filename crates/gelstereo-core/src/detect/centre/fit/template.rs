//! One step from the usual marker's outline, with weights precomputed for the image.
//!
//! The markers of an image are alike. The step from the usual outline, at the nearest of 4 x 4 sub-pixel
//! positions, is linear in the levels except for the division by the contrast. Its weights therefore serve
//! all markers (as the template's slopes do in Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 2004,
//! section 3.2). It costs a tenth of a step with the marker's own outline. For a marker of the usual form it
//! leaves third order in the distance from that position, a few thousandths of a pixel.

use super::disc::{ANSWERS, Answers, Levels, Matrix, Outline, Window};
use super::edge::Edge;
use super::lanes::{Lanes, WIDTH};
use super::step::{apply, reshaped_px};
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
    places: Vec<Place>,
    /// By sub-pixel position, then by cell.
    answers: Vec<Answers>,
    shares: Vec<Lanes>,
}

/// What is known of steps from one sub-pixel position.
#[derive(Clone, Copy, Debug)]
struct Place {
    levels: Factor<4>,
    outline: Factor<5>,
    explained: Matrix,
}

/// A step from the template.
#[derive(Clone, Copy, Debug)]
pub(super) struct TemplateStep {
    place: usize,
    step: [f64; 5],
    /// Outline after the step.
    pub outline: Outline,
    /// Distance of its centre from the template's.
    pub moved_px: f64,
    /// Shift of the outline by its change of form.
    pub reshaped_px: f64,
    pub contrast: f64,
}

impl Template {
    pub fn new() -> Self {
        Self {
            radius_px: 0.0,
            form: [0.0; 3],
            cells: 0,
            places: Vec::new(),
            answers: Vec::new(),
            shares: Vec::new(),
        }
    }

    pub fn forget(&mut self) {
        self.radius_px = 0.0;
    }

    /// Radius of its window, px; 0 without a template.
    pub const fn radius_px(&self) -> f64 {
        self.radius_px
    }

    /// Computes the weights for an outline of this spread in a window of `radius_px`; `per_ground` is the
    /// contrast over the ground's level.
    pub fn learn(&mut self, window: &mut Window, usual: &Usual, blur_px: f64, edge: &Edge) {
        self.forget();
        self.places.clear();
        self.places.reserve(PLACES * PLACES);
        self.answers.clear();
        self.answers.reserve(PLACES * PLACES * MAX_CELLS);
        self.shares.clear();
        self.shares.reserve(PLACES * PLACES * MAX_CELLS);
        let pixels = window.lay(usual.window_px);
        if pixels > MAX_PIXELS {
            return;
        }
        for place in 0..PLACES * PLACES {
            let Some(outline) = Outline::new(place_of(place), &usual.spread_px2) else { return };
            window.draw(&outline, blur_px, edge);
            let Some(levels) = window.follow() else { return };
            window.light(usual.per_ground);
            let Some(factor) = Factor::new(&window.matrix(&levels, blur_px)) else { return };
            window.answers(&factor, &levels, &mut self.answers);
            window.shares(&mut self.shares);
            self.places.push(Place {
                levels,
                outline: factor,
                explained: window.explained(&levels, blur_px),
            });
            self.form = outline.form;
        }
        (self.radius_px, self.cells) = (usual.window_px, pixels.div_ceil(WIDTH));
    }

    /// Step towards the marker near `at`. `None` if the window's extent differs from the template's or
    /// shows no contrast.
    pub fn step(&self, window: &Window, at: DVec2) -> Option<TemplateStep> {
        if self.radius_px == 0.0 || !window.is_whole(self.radius_px) {
            return None;
        }
        let place = nearest_place(at);
        let sums = window.sum_answers(&self.answers[place * self.cells..][..self.cells]);
        let contrast = sums[ANSWERS - 1];
        if !(contrast * contrast > MIN_CONTRAST * MIN_CONTRAST) {
            return None;
        }
        let from = Outline { centre: place_of(place), form: self.form };
        let step = core::array::from_fn(|k| sums[k] / contrast);
        let mut outline = from;
        apply(&mut outline, &step);
        let moved_px = outline.centre.distance(from.centre);
        Some(TemplateStep {
            place,
            step,
            outline,
            moved_px,
            reshaped_px: reshaped_px(&from, &step),
            contrast,
        })
    }

    /// Levels before a step, and what is left of Σ residual² after it.
    pub fn residual(&self, window: &Window, stepped: &TemplateStep) -> (Levels, f64) {
        let TemplateStep { place, step, contrast, .. } = stepped;
        let Place { levels, explained, .. } = &self.places[*place];
        let (levels, residual2) =
            window.levels_with(&self.shares[place * self.cells..][..self.cells], levels);
        let mut by_step = 0.0;
        for i in 0..5 {
            for j in 0..=i {
                let both = if i == j { 1.0 } else { 2.0 };
                by_step += both * step[i] * step[j] * explained[i][j];
            }
        }
        (levels, (residual2 - contrast * contrast * by_step).max(0.0))
    }

    /// Factor of the normal matrix of a step.
    pub fn factor(&self, stepped: &TemplateStep) -> &Factor<5> {
        &self.places[stepped.place].outline
    }
}

/// The usual marker of an image, for which a template is made.
#[derive(Clone, Copy, Debug)]
pub(super) struct Usual {
    /// Of its outline.
    pub spread_px2: Symmetric<2>,
    /// Radius of its window.
    pub window_px: f64,
    /// Contrast over the ground's level.
    pub per_ground: f64,
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
        let usual = Usual { spread_px2, window_px, per_ground: CONTRAST / GROUND };
        template.learn(&mut window, &usual, BLUR_PX, &edge);
        for (x, y, wider_px) in [(0.0, 0.0, 0.0), (0.31, -0.22, 0.0), (-0.5, 0.5, 0.1), (0.1, 0.2, -0.15)] {
            let (guess, centre) = (DVec2::new(12.0, 12.0), DVec2::new(12.0 + x, 12.0 + y));
            let levels = image(centre, radius_px + wider_px, side);
            let view = GrayView::new(&levels, side, side, side).unwrap();
            // The guess is a tenth of a pixel off.
            let near = guess + DVec2::new(x, y) * 0.8 + DVec2::new(0.08, -0.06);
            window.load(view, near, window_px);
            let outline = template.step(&window, near - window.origin).unwrap().outline;
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
        let usual = Usual { spread_px2, window_px: 6.0, per_ground: CONTRAST / GROUND };
        template.learn(&mut window, &usual, BLUR_PX, &edge);
        let levels = image(DVec2::splat(5.0), 3.0, 24);
        let view = GrayView::new(&levels, 24, 24, 24).unwrap();
        window.load(view, DVec2::splat(5.0), 6.0);
        assert!(template.step(&window, DVec2::ZERO).is_none());
        window.load(view, DVec2::splat(6.0), 6.0);
        assert!(template.step(&window, DVec2::ZERO).is_some());
    }
}
