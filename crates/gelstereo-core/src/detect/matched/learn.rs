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
/// Blurs that are believed.
const BLURS_PX: core::ops::RangeInclusive<f64> = 0.4..=5.0;

/// Scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct Samples {
    radius: Vec<f64>,
    blur: Vec<f64>,
}

impl Matched {
    /// Blur and radius by the weights for them, again with the weights for what they said.
    pub(super) fn learn(&mut self, image: GrayView<'_>, markers: &Markers) {
        let count = markers.centres_px.len();
        let samples = SAMPLES.min(count);
        let sample = |k: usize| k * count / samples;
        self.samples.radius.reserve(SAMPLES);
        self.samples.blur.reserve(SAMPLES);
        let mut blur_px = self.given_blur_px.unwrap_or(FIRST_BLUR_PX);
        self.radius_off_px = 0.0;
        let apart = (0..samples).filter_map(|k| nearest_px(&markers.centres_px, sample(k)));
        let half_way_px = 0.5 * lower_quartile(&mut self.samples.radius, apart).unwrap_or(f64::INFINITY);
        self.samples.radius.clear();
        self.samples.radius.extend((0..samples).map(|k| f64::from(markers.area_px2[sample(k)])));
        let usual_px2 = median(&mut self.samples.radius).unwrap_or(0.0);
        for round in 0..=ROUNDS {
            let usual_px = self.radius_px(usual_px2 as u32);
            self.blur_px = blur_px;
            let widest_px =
                if half_way_px > 1.25 * usual_px + REACH_PX { f64::INFINITY } else { half_way_px };
            self.tables.choose(Conditions::new(blur_px, widest_px, &self.noise, self.bright), &self.noise);

            if round == ROUNDS {
                break;
            }
            self.samples.radius.clear();
            self.samples.blur.clear();
            for k in (0..samples).map(sample) {
                let radius_px = self.radius_px(markers.area_px2[k]);
                if let Some((wider, blurred)) = self.form(image, markers.centres_px[k], radius_px) {
                    self.samples.radius.push(wider - radius_px);
                    self.samples.blur.push(blurred);
                }
            }
            let Some(wider_px) = median(&mut self.samples.radius) else { break };
            self.radius_off_px += wider_px.clamp(-0.5, 0.5);
            if let (None, Some(found_px)) = (self.given_blur_px, median(&mut self.samples.blur)) {
                let near = 0.6 * blur_px..=1.6 * blur_px;
                blur_px =
                    found_px.clamp(*near.start(), *near.end()).clamp(*BLURS_PX.start(), *BLURS_PX.end());
            }
        }
    }

    /// Radius and blur of the disc at a place.
    fn form(&mut self, image: GrayView<'_>, near_px: DVec2, radius_px: f64) -> Option<(f64, f64)> {
        let step = self.step(image, near_px, radius_px)?;
        let set = self.tables.set(step.set);
        let (place, first, _) = locate(image, set.side, step.at_px + step.moved_px)?;
        self.patch.load(image, first, set.side);
        let of = |kind| {
            let sum = f64::from(self.patch.correlate(self.tables.kernel(set, place, kind)));
            sum * set.form_per_unit / step.contrast
        };
        let (wider, blurred) = (of(Kind::Radius), of(Kind::Blur));
        Some((set.radius_px + wider, self.tables.conditions().blur_px() + blurred))
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

fn lower_quartile(scratch: &mut Vec<f64>, values: impl Iterator<Item = f64>) -> Option<f64> {
    scratch.clear();
    scratch.extend(values);
    let at = scratch.len() / 4;
    (at < scratch.len()).then(|| *scratch.select_nth_unstable_by(at, f64::total_cmp).1)
}
