//! Fit of one marker, using what is common to the markers of its image.

use super::contour;
use super::disc::{Levels, Matrix, Outline, Window, groups_within};
use super::edge::Edge;
use super::step::{Fitted, Start, apply, covariance, plausible, step};
use super::template::{Template, TemplateStep};
use crate::detect::centre::covered;
use crate::detect::centre::influence::Variances;
use crate::detect::centre::noise::Noise;
use crate::detect::workload::Workload;
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, abs, round, sqrt};
use crate::params::DetectParams;
use core::f64::consts::FRAC_1_PI;

/// Width of gel around the outline that is used: farther pixels carry no information on the edge and
/// little on the light.
pub(super) const REACH_PX: f64 = 3.5;
/// Least width: the outer half of the edge.
const MIN_REACH_PX: f64 = 1.0;
/// Largest number of steps; two are usual.
const MAX_STEPS: usize = 8;
/// Initial blur: a pixel's own width and a little defocus.
pub(super) const FIRST_BLUR_PX: f64 = 0.8;
/// Residuals above this multiple of the expected noise widen the covariance. Smaller ones are chance and
/// small errors of the profile, which do not affect the centre.
const CHANCE: f64 = 3.0;
/// Squared residuals above this multiple, beside a light's reflection, mean that the reflection was
/// fitted. On the path-traced working images, 3 rejects more fits that are accurate to 0.02 px; 12 and 30
/// work equally well.
const NOT_A_DISC: f64 = 30.0;
/// Rms residual beyond the noise over the contrast, above which the pixels show no single whole disc.
const MAX_MISFIT: f64 = 0.12;
/// Limits of the covariance inflation.
const MIN_INFLATION: f64 = 0.5;
const MAX_INFLATION: f64 = 10.0;
/// After a shorter step of the outline, the model's slopes are reused.
const SAME_SLOPES_PX: f64 = 0.25;
/// A step that moves the outline by less leaves its shape unchanged.
const SAME_SHAPE_PX: f64 = 0.15;
/// Number of steps with the integral along the outline, and the least radius of curvature for it, in blurs.
const QUICK_STEPS: usize = 2;
const STRAIGHT_BLURS: f64 = 2.0;
/// Window radii that differ by less count as equal.
const LIKE_USUAL_PX: f64 = 0.5;
/// Most steps with the template: one from a component's mean, another for each pixel that a prediction is
/// off.
const TEMPLATE_STEPS: usize = 4;
/// A step of the template from farther away was not from its nearest position: half of their spacing in
/// both directions, and a little.
const NEAREST_PLACE_PX: f64 = 0.2;
/// Rms difference per axis between a step of the template and the converged fit: 0.0034 px on simulated
/// images, 0.005 px on the path-traced working images. Settings that ask for less get steps with the marker's
/// own outline.
const LEFT_BY_TEMPLATE_PX: f64 = 0.01;
/// Variance that a step of the template adds, over that due to sampling. On drawn discs of 2.7 to 6 px radius
/// it is 1.5 behind no lens and 1.1 behind a blur of 0.2 px; behind 0.35 px it is 5, of a tenth of the noise.
const SAMPLING_BY_TEMPLATE: f64 = 2.0;
/// Parameters of one marker: centre, ellipse, contrast, ground and its two slopes.
const PARAMETERS: f64 = 9.0;

/// Fits single markers. What the image's markers have in common is learned in `learn`.
#[derive(Clone, Debug)]
pub(super) struct Fitter {
    pub given_blur_px: Option<f64>,
    step_px: f64,
    max_side_px: usize,
    pub edge: Edge,
    pub window: Window,
    pub noise: Noise,
    pub blur_px: f64,
    /// Fitted radius minus that of the start, median over the samples.
    pub radius_off_px: f64,
    /// Contrast of the samples, grey levels.
    pub contrast: f64,
    /// Variance of a coordinate due to sampling.
    pub sampling_px2: f64,
    pub template: Template,
    /// Median spread of the samples' starts, and radius of their windows; 0 before the first image.
    pub usual_start_px2: Symmetric<2>,
    pub usual_window_px: f64,
    /// Variance of a centre over the inverse information, per unit variance of white noise and of grain:
    /// the sandwich J⁻¹ K J⁻¹ over J⁻¹ (Huber 1967), since the weights are those of an ideal edge in the
    /// light of the samples.
    pub sandwich: Variances,
    /// Square roots of the ratios of the normal matrix's diagonal to that of the integral along the
    /// outline; `None` if no sample's outline is straight enough.
    pub over_contour: Option<[f64; 5]>,
}

impl Fitter {
    /// Creates the fitter from the settings.
    pub fn new(params: &DetectParams) -> Self {
        // Twice the reach beyond the longer axis of the largest marker, which is twice the shorter axis.
        let longest_px = sqrt(8.0 * FRAC_1_PI * f64::from(params.areas_px2()[1]));
        let max_side_px = (longest_px + 4.0 * REACH_PX) as usize;
        Self {
            given_blur_px: params.fit.blur_px,
            step_px: params.fit.step_px,
            max_side_px,
            edge: Edge::new(),
            window: Window::default(),
            noise: Noise::default(),
            blur_px: FIRST_BLUR_PX,
            radius_off_px: 0.0,
            contrast: 0.0,
            sampling_px2: 0.0,
            template: Template::new(),
            usual_start_px2: Symmetric::default(),
            usual_window_px: 0.0,
            sandwich: Variances::default(),
            over_contour: None,
        }
    }

    /// Fits one marker with the noise and blur last learned. `None` if the fit does not converge,
    /// converges to a disc unlike the start's, or includes a light's reflection.
    pub fn run(&mut self, image: GrayView<'_>, start: &Start) -> Option<Fitted> {
        self.run_within(image, start, self.window_px(start))
    }

    /// Discards what was learned from the last image.
    pub fn forget(&mut self) {
        self.template.forget();
        (self.usual_start_px2, self.usual_window_px) = (Symmetric::default(), 0.0);
    }

    /// Usual radius of a marker's component, px; 0 before the first image.
    pub fn usual_radius_px(&self) -> f64 {
        self.usual_start(DVec2::ZERO).radius_px()
    }

    /// Adds the usual window of a fit.
    pub fn add_workload(&self, workload: &mut Workload) {
        if self.usual_window_px > 0.0 {
            workload.fit_groups = groups_within(self.usual_window_px);
            workload.sums_pixels = self.over_contour.is_none();
        }
    }

    fn usual_start(&self, centre_px: DVec2) -> Start {
        Start { centre_px, spread_px2: self.usual_start_px2, neighbour_px: f64::INFINITY }
    }

    /// As [`Self::run`], for a marker of the usual size; `None` before the first image.
    pub fn run_usual(&mut self, image: GrayView<'_>, centre_px: DVec2) -> Option<Fitted> {
        if self.usual_window_px == 0.0 {
            return None;
        }
        self.run_within(image, &self.usual_start(centre_px), self.usual_window_px)
    }

    fn run_within(&mut self, image: GrayView<'_>, start: &Start, window_px: f64) -> Option<Fitted> {
        let stepped = self.step_from_template(image, start, window_px);
        if let Some(stepped) = stepped
            && stepped.reshaped_px <= SAME_SHAPE_PX
            && self.step_px >= LEFT_BY_TEMPLATE_PX
            && let Some(fitted) = self.by_template(&stepped)
        {
            return Some(fitted);
        }
        let outline = match stepped {
            Some(stepped) => stepped.outline,
            None => {
                self.load(image, start.centre_px, window_px)?;
                Outline::new(start.centre_px - self.window.origin, &self.grown(start))?
            }
        };
        self.iterate(image, start, outline)
    }

    /// Steps of the template until its nearest position was used. `None` for a marker of another size, or
    /// if they lead elsewhere.
    fn step_from_template(
        &mut self,
        image: GrayView<'_>,
        start: &Start,
        window_px: f64,
    ) -> Option<TemplateStep> {
        let usual_px = self.template.radius_px();
        if !(abs(window_px - usual_px) <= LIKE_USUAL_PX && start.centre_px.is_finite()) {
            return None;
        }
        let mut near = start.centre_px;
        for _ in 0..TEMPLATE_STEPS {
            self.window.load(image, near, usual_px);
            let stepped = self.template.step(&self.window, near - self.window.origin)?;
            near = self.window.origin + stepped.outline.centre;
            if !plausible(start, near - start.centre_px, stepped.outline.spread_px2()) {
                return None;
            }
            if stepped.moved_px <= NEAREST_PLACE_PX {
                return Some(stepped);
            }
        }
        None
    }

    /// The marker after a step of the template, unless more than the step's noise is left.
    fn by_template(&self, stepped: &TemplateStep) -> Option<Fitted> {
        let (levels, residual2) = self.template.residual(&self.window, stepped);
        let surprise = self.surprise(residual2);
        let levels = Levels { contrast: stepped.contrast, ..levels };
        let mut fitted = self.fitted(&stepped.outline, self.template.factor(stepped), &levels, 1.0)?;
        // The template's position differs from the marker's, and so does what the pixels' grid does to it.
        let [[xx, _], [_, yy]] = &mut fitted.covariance_px2;
        let grid_px2 = SAMPLING_BY_TEMPLATE * self.sampling_px2;
        (*xx, *yy) = (*xx + grid_px2, *yy + grid_px2);
        (surprise <= CHANCE).then_some(fitted)
    }

    /// Gauss-Newton steps from an outline in the loaded window.
    fn iterate(&mut self, image: GrayView<'_>, start: &Start, mut outline: Outline) -> Option<Fitted> {
        let offset = start.centre_px - self.window.origin;
        let mut last = None;
        for steps in 1..=MAX_STEPS {
            self.window.draw(&outline, self.blur_px, &self.edge);
            let (levels, follow) = self.window.levels()?;
            // The matrix is reused until the outline has moved much (chord method). It affects the rate
            // of convergence, not the result.
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
                let surprise = self.surprise(pull.residual2);
                let is_under_glare = || covered::is_under_glare(image, start.centre_px, start.radius_px());
                if self.misfit(surprise, levels.contrast) > MAX_MISFIT
                    || (surprise > NOT_A_DISC && is_under_glare())
                {
                    return None;
                }
                let wider = (surprise / CHANCE).max(1.0);
                return self.fitted(&outline, &factor, &levels, wider);
            }
        }
        None
    }

    /// Variance of the residuals over that expected.
    fn surprise(&self, residual2: f64) -> f64 {
        residual2 / (self.window.pixels() as f64 - PARAMETERS) / self.noise.variance_levels2()
    }

    /// Rms residual beyond the noise, over the contrast.
    fn misfit(&self, surprise: f64, contrast: f64) -> f64 {
        sqrt((surprise - CHANCE).max(0.0) * self.noise.variance_levels2()) / abs(contrast)
    }

    /// Result after the last step, with its covariance `wider` times the expected one.
    fn fitted(&self, outline: &Outline, factor: &Factor<5>, levels: &Levels, wider: f64) -> Option<Fitted> {
        Some(Fitted {
            centre_px: self.window.origin + outline.centre,
            covariance_px2: self.of_second_order(covariance(factor, levels, self.inflation(levels) * wider)?),
            spread_px2: outline.spread_px2()?,
            contrast_levels: levels.contrast,
        })
    }

    /// Covariance over the inverse information, in the light of this marker.
    fn inflation(&self, levels: &Levels) -> f64 {
        let Noise { white_levels2, grain_levels2, .. } = self.noise;
        let grain_levels2 = grain_levels2 * self.noise.grain_share(levels.ground);
        let Variances { white, grain } = self.sandwich;
        (white * white_levels2 + grain * grain_levels2).clamp(MIN_INFLATION, MAX_INFLATION)
    }

    /// Adds the second-order noise term and the sampling term to the covariance.
    ///
    /// Noise also bends the level's slope across the edge, so that a stretch of outline displaced by u is
    /// pulled too much or too little. The step's error grows by M⁻¹ Σ B n u, of variance 1 + <u²> <k²> times
    /// that of the step. B are the displacements by each parameter, M = Σ B Bᵀ, and n is the noise of the
    /// second derivative, whose variance is <k²> times that of the first. Third-order terms cancel. By its
    /// trace, the mean <u²> of an outline with five parameters is 5/4 of that of the centre.
    fn of_second_order(&self, covariance_px2: Symmetric<2>) -> Symmetric<2> {
        let displaced_px2 = 1.25 * (covariance_px2[0][0] + covariance_px2[1][1]);
        let more = 1.0 + displaced_px2 * self.edge.curvature_per_px2();
        let [[xx, xy], [_, yy]] = covariance_px2.map(|row| row.map(|entry| entry * more));
        [[xx + self.sampling_px2, xy], [xy, yy + self.sampling_px2]]
    }

    /// Factor of the normal matrix: from the integral along the outline, or pixel by pixel if the outline
    /// bends within a blur or steps with the integral did not converge.
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

    /// Normal matrix by the integral along the outline.
    pub(super) fn along(&self, outline: &Outline, levels: &Levels, follow: &Factor<4>) -> Option<Matrix> {
        contour::matrix(outline, self.edge.across(), levels, follow)
    }

    /// Whether an outline is straight enough for that everywhere.
    pub(super) fn is_straight(&self, outline: &Outline) -> bool {
        outline.sharpest_px().is_some_and(|radius| radius >= self.blur_px * STRAIGHT_BLURS)
    }

    /// The start's ellipse, scaled by the radius correction of this image.
    fn grown(&self, start: &Start) -> Symmetric<2> {
        let scale = (1.0 + self.radius_off_px / start.radius_px()).clamp(0.5, 2.0);
        start.spread_px2.map(|row| row.map(|entry| entry * scale * scale))
    }

    /// Loads the pixels within a radius; returns their number if sufficient.
    pub(super) fn load(&mut self, image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> Option<usize> {
        if !(2.0 * radius_px + 1.0 <= self.max_side_px as f64 && centre_px.is_finite()) {
            return None;
        }
        self.window.reserve(self.max_side_px);
        Some(self.window.load(image, centre_px, radius_px)).filter(|&pixels| pixels >= 20)
    }

    /// Radius of the window of pixels around its centre.
    pub(super) fn window_px(&self, start: &Start) -> f64 {
        let [[xx, xy], [_, yy]] = start.spread_px2;
        let mean = 0.5 * (xx + yy);
        let longest = sqrt(mean + sqrt((mean * mean - (xx * yy - xy * xy)).max(0.0)));
        // A neighbour of the same size begins at its radius, surrounded by its own blur.
        let gap = start.neighbour_px - 2.0 * longest - 1.5 * self.blur_px;
        let reach = (REACH_PX + self.blur_px - FIRST_BLUR_PX).max(REACH_PX).min(gap).max(MIN_REACH_PX);
        // Rounded so that similar markers share one window's positions.
        round(2.0 * (longest + reach)) * 0.5
    }
}
