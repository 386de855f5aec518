//! What the markers of an image have in common: noise, blur, and what the covariance must allow for.

use super::influence::{MOST_PIXELS, Variances};
use super::lanes::WIDTH;
use super::noise::ENOUGH_ROWS;
use super::{DiscFit, FIRST_BLUR_PX, Matrix, Outline, Start, apply, covariance, plausible, step};
use crate::detect::fit::contour;
use crate::detect::sampling;
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, ceil, median, sqrt};
use core::f64::consts::PI;

/// Markers from which an image's blur is estimated, spread evenly over the list, and rounds.
const SAMPLES: usize = 15;
const ROUNDS: usize = 4;
/// So many where the noise is strong.
const MORE_SAMPLES: usize = 4 * SAMPLES;
/// Standard error of the blur, over the blur, from which on there are more: variances go with the blur's power 0.8 in
/// white noise to 2.3 in grain, so that they are right to 3 %, the 95 % band of two thousand markers.
const LARGEST_BLUR_ERROR: f64 = 0.013;
/// Blurs that are believed.
const BLURS_PX: core::ops::RangeInclusive<f64> = 0.35..=5.0;
/// Samples over which the covariance is calibrated: one alone is a few percent off.
const INFLUENCES: f64 = 5.0;
/// Blurs, and least and most pixels, between a marker's pixels and the gel of which the noise is measured: at 3.5
/// blurs from its outline 0.02 % of a marker's contrast is left.
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
        self.take_samples(starts, SAMPLES);
        self.answers.clear();
        self.answers.reserve(MOST_PIXELS.div_ceil(WIDTH));
        // Least squares will do for what is common to all.
        let radius_px = self.median_of(|sample| Some(sample.start.radius_px()));
        self.usual_px = radius_px;
        self.edge.weigh_alike(self.blur_px);
        if self.learn_blur(image) > LARGEST_BLUR_ERROR * self.blur_px && starts.len() > MORE_SAMPLES {
            self.take_samples(starts, MORE_SAMPLES);
            self.learn_blur(image);
        }
        self.radius_off_px = self.median_of(|sample| {
            let spread_px2 = sample.outline.spread_px2()?;
            Some(Start { spread_px2, ..sample.start }.radius_px() - sample.start.radius_px())
        });
        let usual_px2 = self.usual_spread_px2();
        self.contrast = self.median_of(|sample| Some(sample.contrast));
        let gel_level = self.median_of(|sample| Some(sample.ground));
        let clearance_px = ceil(CLEAR_BLURS * self.blur_px - 0.5).clamp(CLEAR_PX.0, CLEAR_PX.1) as usize;
        let every = (image.height() / ENOUGH_ROWS).max(1);
        self.centres.clear();
        self.centres.reserve(starts.len());
        self.centres.extend(starts.iter().map(|start| start.centre_px));
        let gel = (mask, self.centres.as_slice());
        self.noise = self.meter.run(image, gel, every, clearance_px).unwrap_or_default().at(gel_level);
        if self.given_blur_px.is_none() {
            self.blur_px = self.unexplained_blur_px(radius_px + self.radius_off_px);
        }
        self.sampling_px2 = sampling::error_px2(self.blur_px, radius_px + self.radius_off_px);
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

    /// The blur with what outlines took of it that follow the noise.
    ///
    /// Outlines a little off make an edge wider in the mean, by their mean square displacement <u²> = 5 σ² b /
    /// (sqrt(π) r C²) (five parameters of a circle's outline, by least squares). But these were fitted to the same
    /// noise, and in second order leave b² - <u²>: the blur's derivative is b times the second one across the edge, so
    /// that the score of b has the mean -<u²> / (2 b) times its information (the bias of a parameter that many others
    /// hide, Neyman and Scott 1948). σ² is the spectrum of the noise at the edge's mean square frequency 1 / (2 b²).
    fn unexplained_blur_px(&self, radius_px: f64) -> f64 {
        let (blur2, contrast2) = (self.blur_px * self.blur_px, self.contrast * self.contrast);
        let noise_levels2 = self.noise.spectrum(0.5 / blur2);
        let displaced_px2 =
            5.0 * noise_levels2 * self.blur_px / (sqrt(PI) * radius_px.max(1.0) * contrast2.max(1.0));
        sqrt(blur2 + displaced_px2.min(blur2)).clamp(*BLURS_PX.start(), *BLURS_PX.end())
    }

    /// Of the samples' outlines.
    fn usual_spread_px2(&mut self) -> Option<Symmetric<2>> {
        let mut entry =
            |i: usize, j: usize| self.median_of(|sample| Some(sample.outline.spread_px2()?[i][j]));
        let (xx, xy, yy) = (entry(0, 0), entry(1, 0), entry(1, 1));
        (xx * yy > xy * xy).then_some([[xx, xy], [xy, yy]])
    }

    fn take_samples(&mut self, starts: &[Start], most: usize) {
        self.samples.clear();
        self.samples.reserve(MORE_SAMPLES);
        let count = starts.len().min(most);
        for k in 0..count {
            let start = starts[k * starts.len() / count];
            let Some(outline) = Outline::new(DVec2::ZERO, &start.spread_px2) else { continue };
            let window_px = self.window_px(&start);
            self.samples.push(Sample { start, outline, contrast: 0.0, ground: 0.0, window_px, alive: true });
        }
    }

    /// Learns the blur by rounds; its standard error, px, 0 for one that is given.
    fn learn_blur(&mut self, image: GrayView<'_>) -> f64 {
        let mut error_px = 0.0;
        for _ in 0..ROUNDS {
            self.scratch.clear();
            self.scratch.reserve(MORE_SAMPLES);
            for k in 0..self.samples.len() {
                if let Some(wider_px) = self.sample_step(image, k) {
                    self.scratch.push(wider_px);
                }
            }
            if self.given_blur_px.is_none()
                && let Some(wider) = Middle::of(&mut self.scratch)
            {
                let step_px = wider.mean.clamp(-0.5 * self.blur_px, self.blur_px);
                self.blur_px = (self.blur_px + step_px).clamp(*BLURS_PX.start(), *BLURS_PX.end());
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

/// What most of some values agree on.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) struct Middle {
    /// Mean of all but the least and the largest fifth: a fifth of the samples may be no disc, and in normal noise its
    /// variance is 1.15 of the mean's; a median's is 1.57, which the weights then lack as precision and the covariance
    /// as truth.
    pub mean: f64,
    /// Its standard deviation, by those of the values with either fifth drawn in to its inner end (Tukey and
    /// McLaughlin 1963).
    pub error: f64,
}

impl Middle {
    /// Sorts the values; `None` without any.
    pub fn of(values: &mut [f64]) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let (len, cut) = (values.len(), values.len() / 5);
        let middle = &values[cut..len - cut];
        let (first, last, kept) = (*middle.first()?, *middle.last()?, middle.len() as f64);
        let mean = middle.iter().sum::<f64>() / kept;
        let off2 = |value: f64| (value - mean) * (value - mean);
        let squares =
            middle.iter().map(|&value| off2(value)).sum::<f64>() + cut as f64 * (off2(first) + off2(last));
        let freedom = len.saturating_sub(1).max(1) as f64;
        Some(Self { mean, error: sqrt(squares * len as f64 / freedom) / kept })
    }
}

/// Square roots of the normal matrix's diagonal over that of the integral, where the latter is believed.
fn over_contour(matrix: &Matrix, quick: &Matrix) -> Option<[f64; 5]> {
    let over: [f64; 5] = core::array::from_fn(|i| matrix[i][i] / quick[i][i]);
    over.iter().all(|over| OVER_CONTOUR.contains(over)).then(|| over.map(sqrt))
}

#[cfg(test)]
mod tests {
    use super::Middle;
    use crate::math::random::Stream;
    use crate::math::{abs, sqrt};
    use alloc::vec::Vec;
    use proptest::prelude::*;

    proptest! {
        /// Up to a fifth of the values may be anything: the mean stays within the others, and is their plain mean
        /// where the rest are split between both ends.
        #[test]
        fn a_fifth_of_the_samples_may_be_no_disc(
            good in prop::collection::vec(-1.0..1.0_f64, 1..40), wrong in prop::collection::vec(-1e9..1e9_f64, 0..10),
        ) {
            let count = (good.len() / 4).min(wrong.len());
            let mut values: Vec<f64> = good.iter().chain(&wrong[..count]).copied().collect();
            let found = Middle::of(&mut values).unwrap();
            prop_assert!((-1.0..=1.0).contains(&found.mean) && (0.0..=2.0).contains(&found.error), "{found:?}");
            let mut split: Vec<f64> = good.clone();
            for _ in 0..count {
                split.extend([-1e9, 1e9]);
            }
            let cut = split.len() / 5;
            if cut == count {
                let mean = good.iter().sum::<f64>() / good.len() as f64;
                // Round-off of sums of forty.
                prop_assert!(abs(Middle::of(&mut split).unwrap().mean - mean) < 1e-14 * 40.0);
            }
        }
    }

    /// Over sets of normal samples the means scatter as they say, and less than medians. A deviation of n sets is
    /// known to 1 / sqrt(2 n), here 1.1 %, four of which are allowed; the error's own mean over few samples is some 3
    /// % less than its rms.
    #[test]
    fn the_mean_is_as_good_as_it_says_and_better_than_a_median() {
        const SETS: usize = 4000;
        for count in [15, 24, 60] {
            let mut stream = Stream::new(count, "blurs");
            let (mut means, mut medians, mut said) = (0.0, 0.0, 0.0);
            for _ in 0..SETS {
                let mut values: Vec<f64> = (0..count).map(|_| stream.normal()).collect();
                let Middle { mean, error } = Middle::of(&mut values).unwrap();
                let median = 0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2]);
                (means, medians, said) =
                    (means + mean * mean, medians + median * median, said + error * error);
            }
            assert!(abs(sqrt(said / means) - 1.0) < 4.0 * 0.011 + 0.03, "{count}: {}", sqrt(said / means));
            // 1.57 / 1.15 = 1.37 for many samples, a twentieth less for fifteen; each variance is known to 2.2 %.
            assert!(medians > 1.2 * means, "{count}: {}", medians / means);
        }
        assert!(Middle::of(&mut []).is_none());
    }
}
