//! What an image's discs have in common, from some of them.

use super::tables::{Conditions, Kind, REACH_PX};
use super::{Matched, locate};
use crate::detect::Markers;
use crate::image::GrayView;
use crate::math::{DVec2, median};
use alloc::vec::Vec;

/// Markers that are looked at, spread evenly over the list.
const SAMPLES: usize = 24;
const ROUNDS: usize = 3;
/// A pixel's own width and a little defocus.
pub(super) const FIRST_BLUR_PX: f64 = 0.8;
/// Contrast over the gel's level to begin with: paint that takes 70 % of the light, gel that does.
pub(super) const DARK_PER_GROUND: f64 = -0.7;
pub(super) const BRIGHT_PER_GROUND: f64 = 2.3;
/// Change of the usual radius that changes no weights.
const SAME_RADIUS_PX: f64 = 0.1;
/// Radius of a disc beyond that of its component, at most.
const MOST_OFF_PX: f64 = 1.5;
/// Blurs that are believed.
const BLURS_PX: core::ops::RangeInclusive<f64> = 0.4..=5.0;

/// Scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct Samples {
    radius: Vec<f64>,
    blur: Vec<f64>,
    per_ground: Vec<f64>,
    contrast: Vec<f64>,
}

/// What one marker says.
struct Form {
    radius_px: f64,
    blur_px: f64,
    /// Contrast over the gel's level.
    per_ground: f64,
    contrast_levels: f64,
}

impl Matched {
    /// Radius, blur and contrast by the weights for them, again with the weights for what they said. Weights once made are
    /// kept as long as they serve: to make others takes some 10 ms.
    pub(super) fn learn(&mut self, image: GrayView<'_>, markers: &Markers) {
        let count = markers.centres_px.len();
        if count == 0 {
            return;
        }
        let samples = SAMPLES.min(count);
        let sample = |k: usize| k * count / samples;
        self.samples.clear();
        let apart = (0..samples).filter_map(|k| nearest_px(&markers.centres_px, sample(k)));
        let half_way_px = 0.5 * quantile(&mut self.samples.radius, apart, 4).unwrap_or(f64::INFINITY);
        let areas = (0..samples).map(|k| f64::from(markers.area_px2[sample(k)]));
        let usual_px2 = quantile(&mut self.samples.radius, areas, 2).unwrap_or(0.0) as u32;
        let mut keeps = true;
        for round in 0..=ROUNDS {
            let usual_px = self.radius_px(usual_px2);
            let half_way_px =
                if half_way_px > 1.25 * usual_px + REACH_PX { f64::INFINITY } else { half_way_px };
            let wanted = Conditions::new(self.blur_px, half_way_px, &self.noise, self.per_ground);
            let chosen = self.tables.chosen();
            // What served the last image, or else what the last round said.
            keeps &= chosen.is_some_and(|chosen| chosen.is_near(wanted));
            let conditions = chosen.filter(|_| keeps).unwrap_or(wanted);
            self.tables.choose(conditions, &self.noise, usual_px);
            if round == ROUNDS || (round > 0 && chosen == Some(conditions)) {
                break;
            }
            self.samples.clear();
            for k in (0..samples).map(sample) {
                let radius_px = self.radius_px(markers.area_px2[k]);
                if let Some(form) = self.form(image, markers.centres_px[k], radius_px) {
                    self.samples.push(&form, radius_px);
                }
            }
            if !self.take_medians(keeps) {
                break;
            }
        }
    }

    /// Takes over what the samples say, a radius that still serves excepted; whether there were any.
    fn take_medians(&mut self, keeps: bool) -> bool {
        let Samples { radius, blur, per_ground, contrast } = &mut self.samples;
        let medians = (median(radius), median(blur), median(per_ground), median(contrast));
        let (Some(wider_px), Some(blur_px), Some(per_ground), Some(contrast_levels)) = medians else {
            return false;
        };
        if !keeps || crate::math::abs(wider_px) > SAME_RADIUS_PX {
            let off_px = self.radius_off_px + wider_px.clamp(-0.5, 0.5);
            self.radius_off_px = off_px.clamp(-MOST_OFF_PX, MOST_OFF_PX);
        }
        (self.per_ground, self.contrast_levels) = (per_ground, contrast_levels);
        if self.given_blur_px.is_none() {
            let near_px = blur_px.clamp(0.6 * self.blur_px, 1.6 * self.blur_px);
            self.blur_px = near_px.clamp(*BLURS_PX.start(), *BLURS_PX.end());
        }
        true
    }

    /// What the disc at a place looks like.
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
    /// Begins anew, with room for all.
    fn clear(&mut self) {
        for list in [&mut self.radius, &mut self.blur, &mut self.per_ground, &mut self.contrast] {
            list.clear();
            list.reserve(SAMPLES);
        }
    }

    fn push(&mut self, form: &Form, began_px: f64) {
        self.radius.push(form.radius_px - began_px);
        self.blur.push(form.blur_px);
        self.per_ground.push(form.per_ground);
        self.contrast.push(form.contrast_levels);
    }
}

/// Distance to the nearest other one.
fn nearest_px(centres_px: &[DVec2], index: usize) -> Option<f64> {
    let at = centres_px[index];
    let (before, after) = (&centres_px[..index], &centres_px[index + 1..]);
    let nearest =
        |centres: &[DVec2]| centres.iter().fold(f64::INFINITY, |d, c| d.min(c.distance_squared(at)));
    let nearest2 = nearest(before).min(nearest(after));
    nearest2.is_finite().then(|| crate::math::sqrt(nearest2))
}

/// The value below which one of so many parts lies.
fn quantile(scratch: &mut Vec<f64>, values: impl Iterator<Item = f64>, parts: usize) -> Option<f64> {
    scratch.clear();
    scratch.extend(values);
    let at = scratch.len() / parts;
    (at < scratch.len()).then(|| *scratch.select_nth_unstable_by(at, f64::total_cmp).1)
}
