//! Estimates what the markers of an image have in common: noise, blur and corrections of the covariance.

use super::contour;
use super::disc::{Answers, Matrix, Outline};
use super::fitter::{FIRST_BLUR_PX, Fitter};
use super::lanes::WIDTH;
use super::step::{Start, apply, covariance, plausible, step};
use super::template::Usual;
use crate::detect::centre::influence::{Influence, MAX_PIXELS, Variances};
use crate::detect::centre::middle::Middle;
use crate::detect::centre::noise::{ENOUGH_ROWS, MarkerPixels, NoiseMeter, NoiseRows};
use crate::detect::centre::sampling;
use crate::detect::workload::Workload;
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, ceil, median, sqrt};
use alloc::vec::Vec;
use core::f64::consts::PI;

/// Markers from which an image's blur is estimated, spread evenly over the list, and rounds.
const SAMPLES: usize = 15;
const ROUNDS: usize = 4;
/// Number of samples if the noise is strong.
const MORE_SAMPLES: usize = 4 * SAMPLES;
/// Relative standard error of the blur above which more samples are used. Variances scale with the blur
/// to the power 0.8 in white noise to 2.3 in grain, so they are then accurate to 3 %, the 95 % band of
/// two thousand markers.
const LARGEST_BLUR_ERROR: f64 = 0.013;
/// Range of accepted blurs.
const BLURS_PX: core::ops::RangeInclusive<f64> = 0.35..=5.0;
/// Samples for calibrating the covariance; a single one is a few percent off.
const INFLUENCES: f64 = 5.0;
/// Distance from a marker's pixels of the gel used for the noise, in blurs, and its limits in pixels. At
/// 3.5 blurs from the outline 0.02 % of a marker's contrast is left.
const CLEAR_BLURS: f64 = 3.5;
const CLEAR_PX: (f64, f64) = (2.0, 4.0);
/// Ratios of the normal matrix to the integral along the outline for which the latter is accepted.
const OVER_CONTOUR: core::ops::RangeInclusive<f64> = 0.7..=1.4;

/// Marker from which the blur is learned.
#[derive(Clone, Copy, Debug)]
struct Sample {
    start: Start,
    outline: Outline,
    contrast: f64,
    ground: f64,
    /// Radius of its window.
    window_px: f64,
    alive: bool,
}

/// Sample markers of an image, and scratch.
#[derive(Clone, Debug)]
pub(super) struct Learner {
    samples: Vec<Sample>,
    scratch: Vec<f64>,
    centres_px: Vec<DVec2>,
    meter: NoiseMeter,
    influence: Influence,
    answers: Vec<Answers>,
}

impl Learner {
    pub fn new() -> Self {
        Self {
            samples: Vec::new(),
            scratch: Vec::new(),
            centres_px: Vec::new(),
            meter: NoiseMeter::default(),
            influence: Influence::new(),
            answers: Vec::new(),
        }
    }

    /// Reserves memory for images of at most `max` markers.
    pub fn reserve(&mut self, max: usize) {
        self.centres_px.clear();
        self.centres_px.reserve(max);
    }

    /// Adds the rows in which the last image's noise was looked for.
    pub fn add_workload(&self, workload: &mut Workload) {
        self.meter.add_workload(workload);
    }

    /// Learns noise and blur of an image from its gel and some of its markers.
    pub fn learn(
        &mut self,
        fit: &mut Fitter,
        image: GrayView<'_>,
        markers: MarkerPixels<'_>,
        starts: &[Start],
    ) {
        fit.blur_px = fit.given_blur_px.unwrap_or(FIRST_BLUR_PX);
        fit.radius_off_px = 0.0;
        self.take_samples(fit, starts, SAMPLES);
        self.answers.clear();
        self.answers.reserve(MAX_PIXELS.div_ceil(WIDTH));
        // Least-squares weights suffice for the common parameters.
        let radius_px = self.median_of(|sample| Some(sample.start.radius_px()));
        fit.edge.weigh_alike(fit.blur_px);
        if self.learn_blur(fit, image) > LARGEST_BLUR_ERROR * fit.blur_px && starts.len() > MORE_SAMPLES {
            self.take_samples(fit, starts, MORE_SAMPLES);
            self.learn_blur(fit, image);
        }
        fit.radius_off_px = self.median_of(|sample| {
            let spread_px2 = sample.outline.spread_px2()?;
            Some(Start { spread_px2, ..sample.start }.radius_px() - sample.start.radius_px())
        });
        let usual_px2 = self.usual_px2(|sample| sample.outline.spread_px2());
        fit.usual_start_px2 = self.usual_px2(|sample| Some(sample.start.spread_px2)).unwrap_or_default();
        fit.contrast = self.median_of(|sample| Some(sample.contrast));
        let gel_level = self.median_of(|sample| Some(sample.ground));
        let clearance_px = ceil(CLEAR_BLURS * fit.blur_px - 0.5).clamp(CLEAR_PX.0, CLEAR_PX.1) as usize;
        self.centres_px.clear();
        self.centres_px.extend(starts.iter().map(|start| start.centre_px));
        let noise =
            self.meter.run(image, markers, &self.centres_px, NoiseRows { rows: ENOUGH_ROWS, clearance_px });
        fit.noise = noise.unwrap_or_default().at(gel_level);
        if fit.given_blur_px.is_none() {
            fit.blur_px = unexplained_blur_px(fit, radius_px + fit.radius_off_px);
        }
        fit.sampling_px2 = sampling::error_px2(fit.blur_px, radius_px + fit.radius_off_px);
        fit.edge.weigh(fit.blur_px, radius_px + fit.radius_off_px, &fit.noise);
        self.measure_sandwich(fit, image);
        let window_px = self.median_of(|sample| Some(sample.window_px));
        fit.usual_window_px = window_px;
        fit.template.forget();
        if let Some(spread_px2) = usual_px2 {
            let usual = Usual { spread_px2, window_px, per_ground: fit.contrast / gel_level.max(1.0) };
            let Fitter { template, window, edge, blur_px, .. } = fit;
            template.learn(window, &usual, *blur_px, edge);
        }
    }

    /// Median of the samples' spreads.
    fn usual_px2(&mut self, spread_px2: impl Fn(&Sample) -> Option<Symmetric<2>>) -> Option<Symmetric<2>> {
        let mut entry = |i: usize, j: usize| self.median_of(|sample| Some(spread_px2(sample)?[i][j]));
        let (xx, xy, yy) = (entry(0, 0), entry(1, 0), entry(1, 1));
        (xx * yy > xy * xy).then_some([[xx, xy], [xy, yy]])
    }

    fn take_samples(&mut self, fit: &Fitter, starts: &[Start], max: usize) {
        self.samples.clear();
        self.samples.reserve(MORE_SAMPLES);
        let count = starts.len().min(max);
        for k in 0..count {
            let start = starts[k * starts.len() / count];
            let Some(outline) = Outline::new(DVec2::ZERO, &start.spread_px2) else { continue };
            let window_px = fit.window_px(&start);
            self.samples.push(Sample { start, outline, contrast: 0.0, ground: 0.0, window_px, alive: true });
        }
    }

    /// Learns the blur iteratively; returns its standard error, px, 0 if the blur is configured.
    fn learn_blur(&mut self, fit: &mut Fitter, image: GrayView<'_>) -> f64 {
        let mut error_px = 0.0;
        for _ in 0..ROUNDS {
            self.scratch.clear();
            self.scratch.reserve(MORE_SAMPLES);
            for k in 0..self.samples.len() {
                if let Some(wider_px) = self.sample_step(fit, image, k) {
                    self.scratch.push(wider_px);
                }
            }
            if fit.given_blur_px.is_none()
                && let Some(wider) = Middle::of(&mut self.scratch)
            {
                let step_px = wider.mean.clamp(-0.5 * fit.blur_px, fit.blur_px);
                fit.blur_px = (fit.blur_px + step_px).clamp(*BLURS_PX.start(), *BLURS_PX.end());
                error_px = wider.error;
            }
        }
        error_px
    }

    /// Median over the samples; 0 without any.
    fn median_of(&mut self, value: impl Fn(&Sample) -> Option<f64>) -> f64 {
        self.scratch.clear();
        self.scratch.extend(self.samples.iter().filter(|sample| sample.alive).filter_map(value));
        median(&mut self.scratch).unwrap_or(0.0)
    }

    /// Moves one sample's outline and returns the blur increment that would fit it better.
    fn sample_step(&mut self, fit: &mut Fitter, image: GrayView<'_>, k: usize) -> Option<f64> {
        let Sample { start, mut outline, alive, .. } = self.samples[k];
        if !alive {
            return None;
        }
        self.samples[k].alive = false;
        fit.load(image, start.centre_px, fit.window_px(&start))?;
        outline.centre += start.centre_px - fit.window.origin;
        fit.window.draw(&outline, fit.blur_px, &fit.edge);
        let (levels, follow) = fit.window.levels()?;
        let wider_px = fit.window.blur_step(fit.blur_px)?;
        let factor = Factor::new(&fit.window.matrix(&follow, fit.blur_px))?;
        apply(&mut outline, &step(&factor, &fit.window.pull(&levels).right, &levels)?);
        outline.centre -= start.centre_px - fit.window.origin;
        self.samples[k].outline = outline;
        (self.samples[k].contrast, self.samples[k].ground) = (levels.contrast, levels.ground);
        self.samples[k].alive = plausible(&start, outline.centre, outline.spread_px2());
        self.samples[k].alive.then_some(wider_px)
    }

    /// Measures the variances of some samples' centres relative to the inverse information, as used by
    /// the fit.
    fn measure_sandwich(&mut self, fit: &mut Fitter, image: GrayView<'_>) {
        let mut sums = Variances::default();
        let (mut count, mut straight, mut ratios) = (0.0, 0.0, [0.0; 5]);
        for k in 0..self.samples.len() {
            if count < INFLUENCES
                && let Some((Variances { white, grain }, ratio)) = self.sandwich_of(fit, image, k)
            {
                sums.white += white;
                sums.grain += grain;
                if let Some(ratio) = ratio {
                    ratios.iter_mut().zip(ratio).for_each(|(sum, ratio)| *sum += ratio);
                    straight += 1.0;
                }
                count += 1.0;
            }
        }
        fit.over_contour = (straight > 0.0).then(|| ratios.map(|sum| sqrt(sum / straight)));
        fit.sandwich = if count > 0.0 {
            Variances { white: sums.white / count, grain: sums.grain / count }
        } else {
            let all = 1.0 / fit.noise.variance_levels2();
            Variances { white: all, grain: all }
        };
    }

    /// The sample's contribution to both, and the ratio of the normal matrix's diagonal to that of the
    /// integral.
    fn sandwich_of(
        &mut self,
        fit: &mut Fitter,
        image: GrayView<'_>,
        k: usize,
    ) -> Option<(Variances, Option<[f64; 5]>)> {
        let Sample { start, mut outline, alive, .. } = self.samples[k];
        if !alive {
            return None;
        }
        fit.load(image, start.centre_px, fit.window_px(&start)).filter(|&pixels| pixels <= MAX_PIXELS)?;
        outline.centre += start.centre_px - fit.window.origin;
        fit.window.draw(&outline, fit.blur_px, &fit.edge);
        let (levels, follow) = fit.window.levels()?;
        let matrix = fit.window.matrix(&follow, fit.blur_px);
        let quick = fit.is_straight(&outline).then(|| fit.along(&outline, &levels, &follow)).flatten();
        let over = quick.and_then(|quick| over_contour(&matrix, &quick));
        let factor = Factor::new(&matrix)?;
        // Factor that the fit will use for such a marker.
        let said = match (&quick, &over) {
            (Some(quick), Some(over)) => Factor::new(&contour::scaled(quick, over))?,
            _ => factor,
        };
        let [[xx, _], [_, yy]] = covariance(&said, &levels, 1.0)?;
        let Self { influence, answers, .. } = self;
        influence.clear();
        answers.clear();
        fit.window.answers(&factor, &follow, answers);
        let per_contrast = 1.0 / levels.contrast;
        fit.window.each_answer(answers, |place, answer| influence.set(place, answer * per_contrast));
        let Variances { white, grain } = influence.variances_px2(fit.noise.grain_size_px)?;
        let ratios = Variances { white: white / (xx + yy), grain: grain / (xx + yy) };
        (ratios.white.is_finite() && ratios.grain.is_finite())
            .then_some((ratios, over.map(|over| over.map(|over| over * over))))
    }
}

/// Blur corrected for the part absorbed by outlines that follow the noise.
///
/// Outlines that are slightly off widen an edge on average, by their mean square displacement
/// <u²> = 5 σ² b / (sqrt(π) r C²) (five parameters of a circle's outline, by least squares). These were
/// fitted to the same noise, which to second order leaves b² - <u²>. The blur's derivative is b times the
/// second derivative across the edge, so the score of b has the mean -<u²> / (2 b) times its information
/// (bias from many nuisance parameters, Neyman and Scott 1948). σ² is the noise spectrum at the edge's
/// mean square frequency 1 / (2 b²).
fn unexplained_blur_px(fit: &Fitter, radius_px: f64) -> f64 {
    let (blur2, contrast2) = (fit.blur_px * fit.blur_px, fit.contrast * fit.contrast);
    let noise_levels2 = fit.noise.spectrum(0.5 / blur2);
    let displaced_px2 =
        5.0 * noise_levels2 * fit.blur_px / (sqrt(PI) * radius_px.max(1.0) * contrast2.max(1.0));
    sqrt(blur2 + displaced_px2.min(blur2)).clamp(*BLURS_PX.start(), *BLURS_PX.end())
}

/// Square roots of the ratios of the normal matrix's diagonal to that of the integral, if the latter is
/// accepted.
fn over_contour(matrix: &Matrix, quick: &Matrix) -> Option<[f64; 5]> {
    let over: [f64; 5] = core::array::from_fn(|i| matrix[i][i] / quick[i][i]);
    over.iter().all(|over| OVER_CONTOUR.contains(over)).then(|| over.map(sqrt))
}
