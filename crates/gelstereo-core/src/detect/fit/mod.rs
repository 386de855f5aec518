//! Centres by a model of the whole marker: a blurred disc, tilted into an ellipse, on ground whose light slopes.
//!
//! Nine parameters per marker (centre, ellipse, contrast, ground, its two slopes), and for the whole image the blur, the
//! noise and the grain. Gauss-Newton steps move the outline until the residuals, weighted for the image's noise along the
//! edge, balance; the first step is a linear filter that is the same for all markers. In white noise that is least squares; in
//! grain, which makes neighbouring pixels alike, least squares would be half as precise again as the bound (Kay,
//! Estimation Theory, section 4.5: whitened residuals).

mod bessel;
mod contour;
mod disc;
mod edge;
mod influence;
mod lanes;
mod learn;
mod noise;
mod template;

pub(super) use influence::Influence;
pub(super) use learn::Middle;
pub use noise::Noise;
pub(super) use noise::{CLEARANCE_PX, ENOUGH_ROWS, NoiseMeter};

use super::Markers;
use super::components::Most;
use super::covered;
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, round, sqrt};
use crate::params::DetectParams;
use crate::spatial::Grid;
use alloc::vec::Vec;
use core::f64::consts::FRAC_1_PI;
use disc::{Answers, Levels, Matrix, Outline, Window};
use edge::Edge;
use influence::Variances;
use learn::Sample;
use template::Template;

/// Gel around the outline that takes part: farther pixels say nothing of the edge and little of the light.
const REACH_PX: f64 = 3.5;
/// The least of it: the edge's outer half.
const LEAST_REACH_PX: f64 = 1.0;
/// Least search radius for neighbours.
const LEAST_FAR_PX: f64 = 2.0 + REACH_PX + 4.0 * FIRST_BLUR_PX;
/// Steps at most; two are the rule.
const MOST_STEPS: usize = 8;
/// Where the search begins: a pixel's own width and a little defocus.
const FIRST_BLUR_PX: f64 = 0.8;
/// Residuals larger than this times what the noise explains widen the covariance: below, it is chance and the profile's
/// small faults, which cost the centre nothing.
const CHANCE: f64 = 3.0;
/// Squared residuals so much larger beside a light's reflection are of the reflection, and so is the fit. On the path-traced
/// images for work 3 doubts more that are right to 0.02 px; 12 and 30 do as well.
const NOT_A_DISC: f64 = 30.0;
/// Shares of the covariance that are believed.
const LEAST_INFLATION: f64 = 0.5;
const MOST_INFLATION: f64 = 10.0;
/// A step of the outline that is shorter leaves the model's slopes as they are.
const SAME_SLOPES_PX: f64 = 0.25;
/// A step that moves the outline by less leaves its shape as it is.
const SAME_SHAPE_PX: f64 = 0.15;
/// Steps by the integral along the outline, and the least radius of curvature that the outline may have for it, in blurs.
const QUICK_STEPS: usize = 2;
const STRAIGHT_BLURS: f64 = 2.0;
/// Radii of windows that differ by less are alike.
const LIKE_USUAL_PX: f64 = 0.5;
/// Longest step.
const MOST_PX: f64 = 0.6;
/// Standard deviation of a grey centroid over the bound, where the fit did not settle.
const UNFITTED: f64 = 4.0;

/// Where a fit begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Approximate centre, pixels.
    pub centre_px: DVec2,
    /// Matrix whose eigenvalues are the squares of the semi-axes, px²: r² on the diagonal for a circle.
    pub spread_px2: Symmetric<2>,
    /// Distance to the nearest other marker's centre, pixels, or infinity.
    pub neighbour_px: f64,
}

impl Start {
    /// Radius of the circle of the same area, pixels.
    #[must_use]
    pub fn radius_px(&self) -> f64 {
        let [[xx, xy], [_, yy]] = self.spread_px2;
        sqrt(sqrt((xx * yy - xy * xy).max(0.0)))
    }
}

/// A fitted marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// Centre of the ellipse, pixels.
    pub centre_px: DVec2,
    /// Its covariance, px².
    pub covariance_px2: Symmetric<2>,
    /// Matrix whose eigenvalues are the squares of the semi-axes, px².
    pub spread_px2: Symmetric<2>,
    /// Level of the dot less that of the gel, grey levels.
    pub contrast_levels: f64,
    /// Steps taken.
    pub steps: usize,
}

/// The fit and its scratch.
#[derive(Clone, Debug)]
pub struct DiscFit {
    given_blur_px: Option<f64>,
    step_px: f64,
    most_side_px: usize,
    edge: Edge,
    meter: NoiseMeter,
    window: Window,
    noise: Noise,
    blur_px: f64,
    /// Radius of the samples' starts, median.
    usual_px: f64,
    /// Fitted radius less that of the start, median over the samples.
    radius_off_px: f64,
    /// Contrast of the samples, grey levels.
    contrast: f64,
    influence: Influence,
    /// Variance of a coordinate by sampling.
    sampling_px2: f64,
    answers: Vec<Answers>,
    template: Template,
    /// Variance of a centre over the inverse information, for a variance of 1 of white noise and of grain: the sandwich
    /// J⁻¹ K J⁻¹ over J⁻¹ (Huber 1967), for the weights are those of a straight edge without end in the light of the
    /// samples.
    sandwich: Variances,
    /// Square roots of the normal matrix's diagonal over that of the integral along the outline; `None` when no sample's
    /// outline is straight enough for it.
    over_contour: Option<[f64; 5]>,
    starts: Vec<Start>,
    /// Indices of those of the last image that did not fit.
    unfitted: Vec<u32>,
    grid: Grid,
    centres: Vec<DVec2>,
    samples: Vec<Sample>,
    scratch: Vec<f64>,
}

impl DiscFit {
    /// With these settings.
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        // Twice the reach beyond the longer axis of the largest marker, twice as long as the other.
        let longest_px = sqrt(8.0 * FRAC_1_PI * f64::from(params.max_area_px2));
        let most_side_px = (longest_px + 4.0 * REACH_PX) as usize;
        Self {
            given_blur_px: params.fit.blur_px,
            step_px: params.fit.step_px,
            most_side_px,
            edge: Edge::new(),
            meter: NoiseMeter::default(),
            window: Window::default(),
            noise: Noise::default(),
            blur_px: FIRST_BLUR_PX,
            usual_px: 0.0,
            radius_off_px: 0.0,
            contrast: 0.0,
            influence: Influence::new(),
            sampling_px2: 0.0,
            answers: Vec::new(),
            template: Template::new(),
            sandwich: Variances::default(),
            over_contour: None,
            starts: Vec::new(),
            unfitted: Vec::new(),
            grid: Grid::default(),
            centres: Vec::new(),
            samples: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// Noise of the last image that was learned.
    #[must_use]
    pub const fn noise(&self) -> Noise {
        self.noise
    }

    /// Standard deviation of its blur, pixels.
    #[must_use]
    pub const fn blur_px(&self) -> f64 {
        self.blur_px
    }

    /// Fits one marker with the noise and blur last learned. `None` when the fit does not settle, or not on a disc like
    /// the start's, and where a light's reflection is part of what it fitted.
    #[must_use]
    pub fn run(&mut self, image: GrayView<'_>, start: &Start) -> Option<Fitted> {
        let (pixels, mut outline) = self.begin(image, start)?;
        let offset = start.centre_px - self.window.origin;
        let mut last = None;
        for steps in 1..=MOST_STEPS {
            self.window.draw(&outline, self.blur_px, &self.edge);
            let (levels, follow) = self.window.levels()?;
            // A matrix serves until the outline has moved much (chord method): it decides how fast the steps end, not
            // where.
            let factor = match last.filter(|&(_, moved)| moved <= SAME_SLOPES_PX && steps != QUICK_STEPS + 1)
            {
                Some((factor, _)) => factor,
                None => self.factor(&outline, &levels, &follow, steps)?,
            };
            let pull = self.window.pull(&levels);
            let step = step(&factor, &pull.right, &levels)?;
            let moved_px = apply(&mut outline, &step);
            last = Some((factor, moved_px));
            if !plausible(start, outline.centre - offset, outline.spread_px2()) {
                return None;
            }
            let centre_moved_px = sqrt(step[0] * step[0] + step[1] * step[1]);
            if centre_moved_px <= self.step_px && moved_px <= SAME_SHAPE_PX.max(self.step_px) {
                let surprise = pull.residual2 / (pixels as f64 - 9.0) / self.noise.variance_levels2();
                if surprise > NOT_A_DISC && covered::is_under_glare(image, start.centre_px, start.radius_px())
                {
                    return None;
                }
                let inflation = self.inflation(&levels) * (surprise / CHANCE).max(1.0);
                return Some(Fitted {
                    centre_px: self.window.origin + outline.centre,
                    covariance_px2: self.of_second_order(covariance(&factor, &levels, inflation)?),
                    spread_px2: outline.spread_px2()?,
                    contrast_levels: levels.contrast,
                    steps,
                });
            }
        }
        None
    }

    /// Loads the marker's pixels; their number, and the outline before the first step.
    fn begin(&mut self, image: GrayView<'_>, start: &Start) -> Option<(usize, Outline)> {
        let usual_px = self.template.radius_px();
        if crate::math::abs(self.window_px(start) - usual_px) <= LIKE_USUAL_PX && start.centre_px.is_finite()
        {
            let pixels = self.window.load(image, start.centre_px, usual_px);
            let offset = start.centre_px - self.window.origin;
            if let Some(outline) = self.template.start(&self.window, offset)
                && plausible(start, outline.centre - offset, outline.spread_px2())
            {
                return Some((pixels, outline));
            }
        }
        let pixels = self.load(image, start)?;
        Some((pixels, Outline::new(start.centre_px - self.window.origin, &self.grown(start))?))
    }

    /// Covariance over the inverse information, in the light of this marker.
    fn inflation(&self, levels: &Levels) -> f64 {
        let Noise { white_levels2, grain_levels2, .. } = self.noise;
        let grain_levels2 = grain_levels2 * self.noise.grain_share(levels.ground);
        let Variances { white, grain } = self.sandwich;
        (white * white_levels2 + grain * grain_levels2).clamp(LEAST_INFLATION, MOST_INFLATION)
    }

    /// The covariance with what the noise adds to it in second order, and with what sampling adds.
    ///
    /// Noise also bends the level's slope across the edge, so that a stretch of outline that is displaced by u is pulled by
    /// too much or too little: the step's error grows by M⁻¹ Σ B n u, of variance 1 + <u²> <k²> times that of the step (B
    /// the displacements by each parameter, M = Σ B Bᵀ, n the noise of the second derivative, whose variance is <k²> times
    /// that of the first). Terms of third order cancel. The mean <u²> of an outline with five parameters, by its trace, is 5/4 of
    /// that of the centre.
    fn of_second_order(&self, covariance_px2: Symmetric<2>) -> Symmetric<2> {
        let displaced_px2 = 1.25 * (covariance_px2[0][0] + covariance_px2[1][1]);
        let more = 1.0 + displaced_px2 * self.edge.curvature_per_px2();
        let [[xx, xy], [_, yy]] = covariance_px2.map(|row| row.map(|entry| entry * more));
        [[xx + self.sampling_px2, xy], [xy, yy + self.sampling_px2]]
    }

    /// Factor of the normal matrix: by the integral along the outline, or pixel by pixel where the outline bends within a
    /// blur, or where steps by the former did not settle.
    fn factor(
        &self,
        outline: &Outline,
        levels: &Levels,
        follow: &Factor<4>,
        steps: usize,
    ) -> Option<Factor<5>> {
        let over = self.over_contour.filter(|_| steps <= QUICK_STEPS && self.is_straight(outline));
        let quick =
            over.and_then(|over| Factor::new(&contour::scaled(&self.along(outline, levels, follow)?, &over)));
        quick.or_else(|| Factor::new(&self.window.matrix(follow, self.blur_px)))
    }

    /// The integral along the outline.
    fn along(&self, outline: &Outline, levels: &Levels, follow: &Factor<4>) -> Option<Matrix> {
        contour::matrix(outline, self.edge.across(), levels, follow)
    }

    /// Whether an outline is straight enough for that everywhere.
    fn is_straight(&self, outline: &Outline) -> bool {
        outline.sharpest_px().is_some_and(|radius| radius >= self.blur_px * STRAIGHT_BLURS)
    }

    /// Least variance of a coordinate, px², for the marker that did not fit.
    fn unfitted_variance_px2(&self, start: &Start) -> f64 {
        // (sigma / C)² 2 b / (sqrt(pi) r) for white noise.
        let per_contrast2 = self.noise.variance_levels2() / (self.contrast * self.contrast).max(1.0);
        UNFITTED * UNFITTED * per_contrast2 * 1.13 * self.blur_px / start.radius_px().max(1.0)
    }

    /// The start's ellipse with the radius that this image's fits came to.
    fn grown(&self, start: &Start) -> Symmetric<2> {
        let scale = (1.0 + self.radius_off_px / start.radius_px()).clamp(0.5, 2.0);
        start.spread_px2.map(|row| row.map(|entry| entry * scale * scale))
    }

    /// Loads the pixels that belong to this marker alone; their number, if it suffices.
    fn load(&mut self, image: GrayView<'_>, start: &Start) -> Option<usize> {
        let radius_px = self.window_px(start);
        if !(2.0 * radius_px + 1.0 <= self.most_side_px as f64 && start.centre_px.is_finite()) {
            return None;
        }
        self.window.reserve(self.most_side_px);
        Some(self.window.load(image, start.centre_px, radius_px)).filter(|&pixels| pixels >= 20)
    }

    /// How far they reach from its centre.
    fn window_px(&self, start: &Start) -> f64 {
        let [[xx, xy], [_, yy]] = start.spread_px2;
        let mean = 0.5 * (xx + yy);
        let longest = sqrt(mean + sqrt((mean * mean - (xx * yy - xy * xy)).max(0.0)));
        // A neighbour of the same size begins at its radius, with its own blur around.
        let gap = start.neighbour_px - 2.0 * longest - 1.5 * self.blur_px;
        let reach = (REACH_PX + self.blur_px - FIRST_BLUR_PX).max(REACH_PX).min(gap).max(LEAST_REACH_PX);
        // Markers alike share one window's places.
        round(2.0 * (longest + reach)) * 0.5
    }

    /// Forgets the markers of the last image; `most` is how many there can be.
    pub fn clear(&mut self, most: usize) {
        self.starts.clear();
        self.starts.reserve(most);
        self.unfitted.clear();
        self.unfitted.reserve(most);
    }

    /// Takes note of a marker whose approximate centre and spread ([`Blob::spread_px2`](super::components::Blob::spread_px2))
    /// are known.
    pub fn add(&mut self, centre_px: DVec2, spread_px2: Symmetric<2>) {
        self.starts.push(Start { centre_px, spread_px2, neighbour_px: f64::INFINITY });
    }

    /// Fits the markers noted, which `markers` lists in the same order, and replaces centre and covariance where that
    /// succeeds. `others_px` are the centres of all components of the image's `mask`, for neighbours keep their pixels.
    pub fn finish(
        &mut self,
        image: GrayView<'_>,
        mask: &[u8],
        others_px: impl Iterator<Item = DVec2>,
        markers: &mut Markers,
    ) {
        self.find_neighbours(image, others_px);
        let starts = core::mem::take(&mut self.starts);
        self.learn(image, mask, &starts);
        for (k, start) in starts.iter().enumerate() {
            match self.run(image, start) {
                Some(fitted) => {
                    markers.centres_px[k] = fitted.centre_px;
                    markers.covariance_px2[k] = fitted.covariance_px2;
                }
                None => {
                    self.unfitted.push(k as u32);
                    let least = self.unfitted_variance_px2(start);
                    let covered = covered::unfitted_px2(image, markers, k);
                    let [[xx, _], [_, yy]] = &mut markers.covariance_px2[k];
                    (*xx, *yy) = (xx.max(least) + covered, yy.max(least) + covered);
                }
            }
        }
        self.starts = starts;
        markers.unfitted = self.unfitted.len();
    }

    /// Indices of those that keep their places, in order.
    pub fn unfitted(&self) -> impl Iterator<Item = usize> {
        self.unfitted.iter().map(|&k| k as usize)
    }

    fn find_neighbours(&mut self, image: GrayView<'_>, others_px: impl Iterator<Item = DVec2>) {
        let widest = self.starts.iter().map(Start::radius_px).fold(1.0, f64::max);
        // Beyond this a neighbour takes no pixel away.
        let far_px = 2.0 * widest + REACH_PX + 4.0 * FIRST_BLUR_PX;
        self.centres.clear();
        let most = Most::of(image.width(), image.height()).kept;
        self.centres.reserve(most);
        self.centres.extend(others_px);
        self.grid.reserve(most, (image.width(), image.height()), LEAST_FAR_PX);
        self.grid.build(&self.centres, far_px);
        for start in &mut self.starts {
            let at = start.centre_px;
            let own_px = 0.5 * start.radius_px();
            let other =
                self.grid.nearest(&self.centres, at, far_px, |n| self.centres[n].distance(at) > own_px);
            start.neighbour_px = other.map_or(f64::INFINITY, |n| self.centres[n].distance(at));
        }
    }
}

/// Solves for the outline's step.
fn step(factor: &Factor<5>, right: &[f64; 5], levels: &Levels) -> Option<[f64; 5]> {
    let step = factor.solve(right).map(|s| s / levels.contrast);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

/// Takes the step, or as much of it as keeps the model's slopes good for something; how far the outline moves, px.
fn apply(outline: &mut Outline, step: &[f64; 5]) -> f64 {
    let [x, y, form @ ..] = *step;
    let [xx, xy, yy] = outline.form;
    // r moves by r/2 for each part of A that is added to it, and r² is 2 / trace A for a circle.
    let [changed_xx, changed_xy, changed_yy] = form;
    let changed = sqrt(changed_xx * changed_xx + 2.0 * changed_xy * changed_xy + changed_yy * changed_yy);
    let part = changed / sqrt(xx * xx + 2.0 * xy * xy + yy * yy);
    let moved_px = sqrt(x * x + y * y) + 0.5 * part * sqrt(2.0 / (xx + yy));
    let share = (MOST_PX / moved_px).min(1.0);
    outline.centre += DVec2::new(x, y) * share;
    for (entry, change) in outline.form.iter_mut().zip(form) {
        *entry += change * share;
    }
    moved_px * share
}

/// Whether the outline is still about where and as large as it began.
fn plausible(start: &Start, moved: DVec2, spread_px2: Option<Symmetric<2>>) -> bool {
    let Some([[xx, xy], [_, yy]]) = spread_px2 else { return false };
    let (area, trace) = (sqrt(xx * yy - xy * xy), xx + yy);
    let began = start.radius_px();
    // Half as wide to twice as wide; the longer axis at most four times the shorter.
    moved.length() <= 0.5 * began.max(2.0)
        && (0.25..=4.0).contains(&(area / (began * began)))
        && trace <= 4.25 * area
}

/// Inverse information of the centre: the outline's other parameters are unknown too.
fn covariance(factor: &Factor<5>, levels: &Levels, inflation: f64) -> Option<Symmetric<2>> {
    let scale = inflation / (levels.contrast * levels.contrast);
    let column = |k: usize| factor.solve(&core::array::from_fn(|i| f64::from(u8::from(i == k))));
    let (x, y) = (column(0), column(1));
    let xy = 0.5 * (x[1] + y[0]) * scale;
    let covariance = [[x[0] * scale, xy], [xy, y[1] * scale]];
    (covariance[0][0] > 0.0 && covariance[1][1] > 0.0).then_some(covariance)
}
