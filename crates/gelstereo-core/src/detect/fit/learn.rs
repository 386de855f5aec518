//! What the markers of an image have in common: noise, blur, and what the covariance must allow for.

use super::influence::{MOST_PIXELS, Variances};
use super::lanes::WIDTH;
use super::noise::ENOUGH_ROWS;
use super::{DiscFit, FIRST_BLUR_PX, Matrix, Outline, Start, apply, covariance, plausible, step};
use crate::detect::fit::{Factor, contour};
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, ceil, median, sqrt};

/// Markers from which an image's blur is estimated, spread evenly over the list, and rounds.
const SAMPLES: usize = 15;
const ROUNDS: usize = 4;
/// Blurs that are believed.
const BLURS_PX: core::ops::RangeInclusive<f64> = 0.35..=5.0;
/// Samples over which the covariance is calibrated: one alone is a few percent off.
const INFLUENCES: f64 = 5.0;
/// Blurs, and least and most pixels, between a marker's pixels and the gel of which the noise is measured: at 3.5 blurs from
/// its outline 0.02 % of a marker's contrast is left.
const CLEAR_BLURS: f64 = 3.5;
const CLEAR_PX: (f64, f64) = (2.0, 4.0);
/// Ratios of the normal matrix to the integral along the outline for which the latter is believed.
const OVER_CONTOUR: core::ops::RangeInclusive<f64> = 0.7..=1.4;

/// A marker of which the blur is learned.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    start: Start,
    outline: Outline,
    contrast: f64,
    ground: f64,
    /// Radius of its window.
    window_px: f64,
    alive: bool,
}

impl DiscFit {
    /// Learns noise and blur of an image from its gel (`mask` is 0 there) and some of its markers.
    pub fn learn(&mut self, image: GrayView<'_>, mask: &[u8], starts: &[Start]) {
        self.blur_px = self.given_blur_px.unwrap_or(FIRST_BLUR_PX);
        self.radius_off_px = 0.0;
        self.take_samples(starts);
        self.answers.clear();
        self.answers.reserve(MOST_PIXELS.div_ceil(WIDTH));
        // Least squares will do for what is common to all.
        let radius_px = self.median_of(|sample| Some(sample.start.radius_px()));
        self.edge.weigh_alike(self.blur_px);
        self.learn_blur(image);
        self.radius_off_px = self.median_of(|sample| {
            let spread_px2 = sample.outline.spread_px2()?;
            Some(Start { spread_px2, ..sample.start }.radius_px() - sample.start.radius_px())
        });
        let usual_px2 = self.usual_spread_px2();
        self.contrast = self.median_of(|sample| Some(sample.contrast));
        let gel_level = self.median_of(|sample| Some(sample.ground));
        let clearance_px = ceil(CLEAR_BLURS * self.blur_px - 0.5).clamp(CLEAR_PX.0, CLEAR_PX.1) as usize;
        let every = (image.height() / ENOUGH_ROWS).max(1);
        self.noise = self.meter.run(image, mask, every, clearance_px).unwrap_or_default().at(gel_level);
        self.edge.weigh(self.blur_px, radius_px + self.radius_off_px, &self.noise);
        self.measure_sandwich(image);
        let window_px = self.median_of(|sample| Some(sample.window_px));
        self.template.forget();
        if let Some(spread_px2) = usual_px2 {
            let Self { template, window, edge, .. } = self;
            let per_ground = self.contrast / gel_level.max(1.0);
            template.learn(window, (&spread_px2, window_px), per_ground, (self.blur_px, edge));
        }
    }

    /// Of the samples' outlines.
    fn usual_spread_px2(&mut self) -> Option<Symmetric<2>> {
        let mut entry =
            |i: usize, j: usize| self.median_of(|sample| Some(sample.outline.spread_px2()?[i][j]));
        let (xx, xy, yy) = (entry(0, 0), entry(1, 0), entry(1, 1));
        (xx * yy > xy * xy).then_some([[xx, xy], [xy, yy]])
    }

    fn take_samples(&mut self, starts: &[Start]) {
        self.samples.clear();
        self.samples.reserve(SAMPLES);
        let count = starts.len().min(SAMPLES);
        for k in 0..count {
            let start = starts[k * starts.len() / count];
            let Some(outline) = Outline::new(DVec2::ZERO, &start.spread_px2) else { continue };
            let window_px = self.window_px(&start);
            self.samples.push(Sample { start, outline, contrast: 0.0, ground: 0.0, window_px, alive: true });
        }
    }

    fn learn_blur(&mut self, image: GrayView<'_>) {
        for _ in 0..ROUNDS {
            self.scratch.clear();
            self.scratch.reserve(SAMPLES);
            for k in 0..self.samples.len() {
                if let Some(wider_px) = self.sample_step(image, k) {
                    self.scratch.push(wider_px);
                }
            }
            if self.given_blur_px.is_none() {
                let wider_px = middle_mean(&mut self.scratch).unwrap_or(0.0);
                let step_px = wider_px.clamp(-0.5 * self.blur_px, self.blur_px);
                self.blur_px = (self.blur_px + step_px).clamp(*BLURS_PX.start(), *BLURS_PX.end());
            }
        }
    }

    /// Median over the samples; 0 without any.
    fn median_of(&mut self, value: impl Fn(&Sample) -> Option<f64>) -> f64 {
        self.scratch.clear();
        self.scratch.extend(self.samples.iter().filter(|sample| sample.alive).filter_map(value));
        median(&mut self.scratch).unwrap_or(0.0)
    }

    /// Moves one sample's outline and says by how much more blur would fit it better.
    fn sample_step(&mut self, image: GrayView<'_>, k: usize) -> Option<f64> {
        let Sample { start, mut outline, alive, .. } = self.samples[k];
        if !alive {
            return None;
        }
        self.samples[k].alive = false;
        self.load(image, &start)?;
        outline.centre += start.centre_px - self.window.origin;
        self.window.draw(&outline, self.blur_px, &self.edge);
        let (levels, follow) = self.window.levels()?;
        let wider_px = self.window.blur_step(self.blur_px)?;
        let factor = Factor::new(&self.window.matrix(&follow, self.blur_px))?;
        apply(&mut outline, &step(&factor, &self.window.pull(&levels).right, &levels)?);
        outline.centre -= start.centre_px - self.window.origin;
        self.samples[k].outline = outline;
        (self.samples[k].contrast, self.samples[k].ground) = (levels.contrast, levels.ground);
        self.samples[k].alive = plausible(&start, outline.centre, outline.spread_px2());
        self.samples[k].alive.then_some(wider_px)
    }

    /// Measures variances of some samples' centres over what the inverse information says, taken as the fit takes it.
    fn measure_sandwich(&mut self, image: GrayView<'_>) {
        let mut sums = Variances::default();
        let (mut count, mut straight, mut ratios) = (0.0, 0.0, [0.0; 5]);
        for k in 0..self.samples.len() {
            if count < INFLUENCES
                && let Some((Variances { white, grain }, ratio)) = self.sandwich_of(image, k)
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
        self.over_contour = (straight > 0.0).then(|| ratios.map(|sum| sqrt(sum / straight)));
        self.sandwich = if count > 0.0 {
            Variances { white: sums.white / count, grain: sums.grain / count }
        } else {
            let all = 1.0 / self.noise.variance_levels2();
            Variances { white: all, grain: all }
        };
    }

    /// The sample's part of both, and the normal matrix's diagonal over that of the integral.
    fn sandwich_of(&mut self, image: GrayView<'_>, k: usize) -> Option<(Variances, Option<[f64; 5]>)> {
        let Sample { start, mut outline, alive, .. } = self.samples[k];
        if !alive {
            return None;
        }
        self.load(image, &start).filter(|&pixels| pixels <= MOST_PIXELS)?;
        outline.centre += start.centre_px - self.window.origin;
        self.window.draw(&outline, self.blur_px, &self.edge);
        let (levels, follow) = self.window.levels()?;
        let matrix = self.window.matrix(&follow, self.blur_px);
        let quick = self.is_straight(&outline).then(|| self.along(&outline, &levels, &follow)).flatten();
        let over = quick.and_then(|quick| over_contour(&matrix, &quick));
        let factor = Factor::new(&matrix)?;
        // What the fit will say of such a marker.
        let said = match (&quick, &over) {
            (Some(quick), Some(over)) => Factor::new(&contour::scaled(quick, over))?,
            _ => factor,
        };
        let [[xx, _], [_, yy]] = covariance(&said, &levels, 1.0)?;
        let Self { window, influence, answers, .. } = self;
        influence.clear();
        answers.clear();
        window.answers(&factor, &follow, answers);
        let per_contrast = 1.0 / levels.contrast;
        window.each_answer(answers, |place, answer| influence.set(place, answer * per_contrast));
        let Variances { white, grain } = influence.variances_px2(self.noise.grain_size_px)?;
        let ratios = Variances { white: white / (xx + yy), grain: grain / (xx + yy) };
        (ratios.white.is_finite() && ratios.grain.is_finite())
            .then_some((ratios, over.map(|over| over.map(|over| over * over))))
    }
}

/// Mean of all but the least and the largest fifth: three of [`SAMPLES`] may be no disc, and noise that is normal adds a tenth to
/// the least variance; to a median's, more than half, which the weights then lack as precision and the covariance as truth.
fn middle_mean(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let cut = values.len() / 5;
    let middle = &values[cut..values.len() - cut];
    (!middle.is_empty()).then(|| middle.iter().sum::<f64>() / middle.len() as f64)
}

/// Square roots of the normal matrix's diagonal over that of the integral, where the latter is believed.
fn over_contour(matrix: &Matrix, quick: &Matrix) -> Option<[f64; 5]> {
    let over: [f64; 5] = core::array::from_fn(|i| matrix[i][i] / quick[i][i]);
    over.iter().all(|over| OVER_CONTOUR.contains(over)).then(|| over.map(sqrt))
}
