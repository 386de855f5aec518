//! Estimates what an image's discs have in common, from some of them.

use super::filter::{MAX_MISFIT, MatchedFilter, Refined, Response, component_px, locate};
use super::tables::{Conditions, Kind, PLACES, REACH_PX};
use crate::detect::centre::middle::Middle;
use crate::detect::centre::sampling;
use crate::detect::markers::Markers;
use crate::image::GrayView;
use crate::math::{DVec2, median};
use alloc::vec::Vec;

/// Sample markers, spread evenly over the list.
const SAMPLES: usize = 24;
const ROUNDS: usize = 3;
/// Columns and rows of a grid over the image; the markers nearest to its nodes give the response along
/// both axes. Its noise is that of the centre times the slopes' wave number, about 1 per pixel: a tenth
/// if a centre is known to a tenth of a pixel, which 24 values reduce to 2 %.
const RESPONDING: [usize; 2] = [4, 3];
/// Range of accepted responses: weights work up to one and a half blur steps off their design.
const RESPONSES: core::ops::RangeInclusive<f64> = 0.6..=1.6;
/// Changes of the usual radius below this leave the weights unchanged.
const SAME_RADIUS_PX: f64 = 0.1;
/// The same for the slope of disc radius over component radius; component radii differ by up to about
/// a third of a pixel.
const SAME_PER_PX: f64 = 0.3;
/// Largest disc radius minus that of its component.
const MAX_OFF_PX: f64 = 1.5;
/// Spread of component radii below which they do not determine the slope.
const ALIKE_PX: f64 = 0.03;
/// Range of accepted blurs.
const BLURS_PX: core::ops::RangeInclusive<f64> = 0.4..=5.0;

/// Scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct Samples {
    radius: Vec<f64>,
    /// Radii of components and of their discs.
    radii: Vec<[f64; 2]>,
    blur: Vec<f64>,
    per_ground: Vec<f64>,
    contrast: Vec<f64>,
    response: Vec<f64>,
}

/// Parameters estimated from one marker.
struct Form {
    radius_px: f64,
    blur_px: f64,
    /// Contrast over the gel's level.
    per_ground: f64,
    contrast_levels: f64,
}

impl MatchedFilter {
    /// Estimates radius, blur and contrast, and repeats with the weights for these estimates. Weights are
    /// kept while they are suitable: computing new ones takes some 10 ms.
    pub(super) fn learn(&mut self, samples: &mut Samples, image: GrayView<'_>, markers: &Markers) {
        (self.response, self.sampling_px2) = (Response::default(), 0.0);
        let count = markers.centres_px.len();
        if count == 0 {
            return;
        }
        let count_samples = SAMPLES.min(count);
        let sample = |k: usize| k * count / count_samples;
        samples.clear();
        let apart = (0..count_samples).filter_map(|k| nearest_px(&markers.centres_px, sample(k)));
        let half_way_px = 0.5 * quantile(&mut samples.radius, apart, 4).unwrap_or(f64::INFINITY);
        let areas = (0..count_samples).map(|k| f64::from(markers.area_px2[sample(k)]));
        let usual_px2 = quantile(&mut samples.radius, areas, 2).unwrap_or(0.0) as u32;
        let mut keeps = true;
        for round in 0..=ROUNDS {
            let usual_px = self.radius_px(usual_px2);
            let half_way_px =
                if half_way_px > 1.25 * usual_px + REACH_PX { f64::INFINITY } else { half_way_px };
            let wanted = Conditions::new(self.blur_px, half_way_px, &self.noise, self.per_ground);
            let chosen = self.tables.chosen();
            // Keep the last image's weights if suitable, otherwise use the last round's estimate.
            keeps &= chosen.is_some_and(|chosen| chosen.is_near(wanted));
            let conditions = chosen.filter(|_| keeps).unwrap_or(wanted);
            self.tables.choose(conditions, &self.noise, usual_px);
            if round == ROUNDS || (round > 0 && chosen == Some(conditions)) {
                break;
            }
            samples.clear();
            for k in (0..count_samples).map(sample) {
                let radius_px = self.radius_px(markers.area_px2[k]);
                if let Some(form) = self.form(image, markers.centres_px[k], radius_px) {
                    samples.push(&form, component_px(markers.area_px2[k]), radius_px);
                }
            }
            if !self.take_medians(samples, keeps, component_px(usual_px2)) {
                break;
            }
        }
        self.learn_response(samples, image, markers);
    }

    /// Response of the chosen weights to some of the markers, and their sharpness. The selection does not
    /// depend on the order of the list.
    fn learn_response(&mut self, samples: &mut Samples, image: GrayView<'_>, markers: &Markers) {
        samples.clear();
        let [columns, rows] = RESPONDING;
        let part = |k: usize, parts: usize, size: usize| (k as f64 + 0.5) / parts as f64 * size as f64;
        let mut by_noise = 0.0;
        for n in 0..columns * rows {
            let at = DVec2::new(
                part(n % columns, columns, image.width()),
                part(n / columns, rows, image.height()),
            );
            let Some(k) = nearest(&markers.centres_px, at) else { return };
            let radius_px = self.radius_px(markers.area_px2[k]);
            if let Some(form) = self.form(image, markers.centres_px[k], radius_px) {
                samples.blur.push(form.blur_px);
                samples.radius.push(form.radius_px);
            }
            if let Some((along, noise)) = self.responses(image, markers.centres_px[k], radius_px)
                && along.iter().all(|s| RESPONSES.contains(s))
            {
                samples.response.extend(along);
                by_noise += along.len() as f64 * noise;
            }
        }
        if let (Some(blur_px), Some(radius_px)) = (median(&mut samples.blur), median(&mut samples.radius)) {
            self.sampling_px2 = sampling::error_px2(blur_px, radius_px);
        }
        let responses = &samples.response;
        let count = responses.len() as f64;
        if count < 2.0 {
            return;
        }
        let mean = |of: &dyn Fn(f64) -> f64| responses.iter().map(|&s| of(s)).sum::<f64>() / count;
        let usual = mean(&|s| s);
        let variance = mean(&|s| (s - usual) * (s - usual)) * count / (count - 1.0);
        let scatter = (variance - by_noise / count).max(0.0);
        self.response = Response { mean: usual, per_square: mean(&|s| 1.0 / (s * s)), scatter };
    }

    /// Response of steps along either axis, between the nearest position and the next one towards the
    /// disc, and its noise variance. `None` for markers unsuitable for steps.
    fn responses(&mut self, image: GrayView<'_>, near_px: DVec2, radius_px: f64) -> Option<([f64; 2], f64)> {
        let start = self.step(image, near_px, radius_px)?;
        let here = self.step(image, start.at_px + start.moved_px, radius_px)?;
        let Refined { misfit, covariance_px2: [[xx, _], [_, yy]], .. } = self.judge(&here);
        if misfit > MAX_MISFIT {
            return None;
        }
        let mut along = |axis: DVec2| {
            let apart_px = if here.moved_px.dot(axis) < 0.0 { -1.0 } else { 1.0 } / PLACES as f64;
            let next = self.step(image, here.at_px + axis * apart_px, radius_px)?;
            Some((here.moved_px - next.moved_px).dot(axis) / apart_px)
        };
        let along = [along(DVec2::X)?, along(DVec2::Y)?];
        let per_px2 = self.tables.set(here.set).response_per_px2(&self.noise);
        Some((along, 0.5 * (xx + yy) * per_px2))
    }

    /// Adopts the samples' estimates, except radii that are still suitable; returns whether there were
    /// any samples.
    fn take_medians(&mut self, samples: &mut Samples, keeps: bool, usual_px: f64) -> bool {
        let Samples { radius, blur, per_ground, contrast, .. } = samples;
        let blur_px = Middle::of(blur).map(|blur| blur.mean);
        let medians = (median(radius), blur_px, median(per_ground), median(contrast));
        let (Some(wider_px), Some(blur_px), Some(per_ground), Some(contrast_levels)) = medians else {
            return false;
        };
        if !keeps || crate::math::abs(wider_px) > SAME_RADIUS_PX {
            let off_px = self.radius_off_px + wider_px.clamp(-0.5, 0.5);
            self.radius_off_px = off_px.clamp(-MAX_OFF_PX, MAX_OFF_PX);
        }
        let radius_per_px = samples.radius_per_px();
        if !keeps || crate::math::abs(radius_per_px - self.radius_per_px) > SAME_PER_PX {
            (self.radius_per_px, self.usual_px) = (radius_per_px, usual_px);
        } else if crate::math::abs(usual_px - self.usual_px) > SAME_RADIUS_PX {
            self.usual_px = usual_px;
        }
        (self.per_ground, self.contrast_levels) = (per_ground, contrast_levels);
        if self.given_blur_px.is_none() {
            let near_px = blur_px.clamp(0.6 * self.blur_px, 1.6 * self.blur_px);
            self.blur_px = near_px.clamp(*BLURS_PX.start(), *BLURS_PX.end());
        }
        true
    }

    /// Parameters of the disc near a position.
    fn form(&mut self, image: GrayView<'_>, near_px: DVec2, radius_px: f64) -> Option<Form> {
        let step = self.step(image, near_px, radius_px)?;
        let set = *self.tables.set(step.set);
        let (place, first, _) = locate(image, set.side, step.at_px + step.moved_px)?;
        self.patch.load(image, first, set.side);
        let sum = |kind| f64::from(self.patch.correlate(self.tables.kernel(&set, place, kind)));
        let scale = set.form_per_unit / step.contrast;
        let (wider_px, blurred_px) = (scale * sum(Kind::Radius), scale * sum(Kind::Blur));
        let (ground, _) = self.rest(&step);
        Some(Form {
            radius_px: set.radius_px + wider_px,
            blur_px: self.tables.conditions().blur_px() + blurred_px,
            per_ground: step.contrast / ground.max(1.0),
            contrast_levels: step.contrast,
        })
    }
}

impl Samples {
    /// Clears the lists and reserves memory for all samples.
    fn clear(&mut self) {
        let Self { radius, radii, blur, per_ground, contrast, response } = self;
        for list in [radius, blur, per_ground, contrast, response] {
            list.clear();
            list.reserve(SAMPLES);
        }
        radii.clear();
        radii.reserve(SAMPLES);
    }

    /// Change of disc radius per pixel of component radius: a regression line without outliers farther
    /// off than any disc, regularised towards 1 if components are alike.
    fn radius_per_px(&self) -> f64 {
        let count = self.radii.len().max(1) as f64;
        let [component_px, disc_px] = [0, 1].map(|n| self.radii.iter().map(|r| r[n]).sum::<f64>() / count);
        let known = count * ALIKE_PX * ALIKE_PX;
        let (mut product, mut square) = (known, known);
        for [component, disc] in &self.radii {
            let (larger, disc) = (component - component_px, disc - disc_px);
            if crate::math::abs(disc) <= MAX_OFF_PX {
                product += larger * disc;
                square += larger * larger;
            }
        }
        (product / square).clamp(0.0, 1.0)
    }

    fn push(&mut self, form: &Form, component_px: f64, began_px: f64) {
        self.radius.push(form.radius_px - began_px);
        self.radii.push([component_px, form.radius_px]);
        self.blur.push(form.blur_px);
        self.per_ground.push(form.per_ground);
        self.contrast.push(form.contrast_levels);
    }
}

/// Index of the centre nearest to a position.
fn nearest(centres_px: &[DVec2], at: DVec2) -> Option<usize> {
    let distances = centres_px.iter().map(|centre| centre.distance_squared(at));
    distances.enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(k, _)| k)
}

/// Distance to the nearest other centre.
fn nearest_px(centres_px: &[DVec2], index: usize) -> Option<f64> {
    let at = centres_px[index];
    let (before, after) = (&centres_px[..index], &centres_px[index + 1..]);
    let nearest =
        |centres: &[DVec2]| centres.iter().fold(f64::INFINITY, |d, c| d.min(c.distance_squared(at)));
    let nearest2 = nearest(before).min(nearest(after));
    nearest2.is_finite().then(|| crate::math::sqrt(nearest2))
}

/// The value below which one of `parts` equal parts lies.
fn quantile(scratch: &mut Vec<f64>, values: impl Iterator<Item = f64>, parts: usize) -> Option<f64> {
    scratch.clear();
    scratch.extend(values);
    let at = scratch.len() / parts;
    (at < scratch.len()).then(|| *scratch.select_nth_unstable_by(at, f64::total_cmp).1)
}
