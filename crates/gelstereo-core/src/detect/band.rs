//! How well the centres of [`Centre::Band`](crate::params::Centre::Band) are known.
//!
//! Such a centre answers to the pixels of the marker's edge, and of the window's corners, by known weights: its variance is that
//! of their sum in the image's noise and grain. White noise counts by the square of the marker's own contrast; grain is of the
//! paint, and fades with the light as the contrast does, so that its part is the same for all markers.

use super::fit::{CLEARANCE_PX, Influence, Noise};
use super::glance::{Eye, Eyes, Kind};
use super::{Detector, Markers, rows_between, searched};
use crate::image::GrayView;
use crate::math::{DVec2, sqrt};

/// Rows between those from which noise is measured, over that for weights of a matched step: weights do not follow it.
const SPARSER: usize = 2;
/// Markers from whose edges the weights are taken, spread evenly.
const SAMPLES: usize = 3;
/// Variance of rounding weights to whole grey levels, as the image's levels are.
const ROUNDING_LEVELS2: f64 = 1.0 / 12.0;
/// What noise s does to a weight that grows over a band b, against s / b as within the band, is 1 - CLAMPED s / b: a weight is kept
/// to the band's ends. Over an edge, whose levels are spread evenly, weights of two levels that differ by d have the mean square
/// difference (d / b)² (1 - d / (3 b)), and the mean |d|³ of two levels' noise is 8 s³ / sqrt(pi); so this is 4 / (3 sqrt(pi)).
const CLAMPED: f64 = 2.0 / 3.0 * core::f64::consts::FRAC_2_SQRT_PI;
/// It holds while two levels' noise seldom differs by more than the band.
const MOST_NOISE_OVER_BAND: f64 = 0.5;
/// Standard deviation of a coordinate without any noise: dots of 4 to 5 px on a pixel grid, behind 0.8 px of defocus, in light
/// that falls off by a quarter over the image (simulated).
const MODEL_PX: f64 = 0.009;

/// What was last learned of an image.
#[derive(Clone, Debug)]
pub(super) struct BandNoise {
    influence: Influence,
    learned: Option<Learned>,
}

#[derive(Clone, Copy, Debug)]
struct Learned {
    /// Variance of a coordinate from white noise for a contrast of 1 between the band's ends, and from grain, px².
    white: f64,
    grain: f64,
}

impl BandNoise {
    pub fn new() -> Self {
        Self { influence: Influence::new(), learned: None }
    }

    pub fn forget(&mut self) {
        self.learned = None;
    }

    /// Learns from some of these markers in an image of this noise.
    pub fn learn<const L: usize>(
        &mut self,
        image: GrayView<'_>,
        eye: &Eye<L>,
        noise: &Noise,
        centres_px: &[DVec2],
    ) {
        let (mut sum, mut count) = (Learned { white: 0.0, grain: 0.0 }, 0.0);
        let samples = SAMPLES.min(centres_px.len());
        for at_px in (0..samples).map(|k| centres_px[(2 * k + 1) * centres_px.len() / (2 * samples)]) {
            let influence = &mut self.influence;
            influence.clear();
            let found = eye.influence(image, at_px, |place, answer| influence.set(place, answer));
            let variances = influence.variances_px2(noise.grain_size_px);
            if let (Some((band, gel_level)), Some(variances)) = (found, variances) {
                let band2 = f64::from(band) * f64::from(band);
                // Of both coordinates together.
                let white_levels2 = noise.white_levels2 + ROUNDING_LEVELS2;
                let clamped = 1.0 - CLAMPED * sqrt(white_levels2 / band2).min(MOST_NOISE_OVER_BAND);
                sum.white += 0.5 * variances.white * band2 * white_levels2 * clamped;
                sum.grain += 0.5 * variances.grain * noise.grain_levels2 * noise.grain_share(gel_level);
                count += 1.0;
            }
        }
        self.learned = (count > 0.0).then(|| Learned { white: sum.white / count, grain: sum.grain / count });
    }

    /// Variance of a coordinate of a marker with this contrast between the band's ends; `None` while nothing was learned.
    pub fn variance_px2(&self, band: u8) -> Option<f64> {
        let Learned { white, grain } = self.learned.filter(|_| band > 0)?;
        Some(white / (f64::from(band) * f64::from(band)) + grain + MODEL_PX * MODEL_PX)
    }
}

impl Detector {
    /// Learns how well markers of one kind, and [`Self::bands`], are known in an image, and tells each.
    pub(super) fn tell_band_noise(&mut self, image: GrayView<'_>, kind: &Kind, out: &mut Markers) {
        let (eyes, every) = (Eyes::new(*kind, self.flip()), SPARSER * rows_between(image.height()));
        let Self { segments, half, meter, bands, band_noise: Some(learned), .. } = self else { return };
        let (segments, scale) = searched(segments, half.as_ref());
        let cover = |rows, near: &mut [u8]| segments.components.cover(rows, scale, near);
        let noise = meter.run_rows(image, every, CLEARANCE_PX, cover).unwrap_or_default();
        eyes.learn(learned, image, &noise, &out.centres_px);
        for (covariance, &mut band) in out.covariance_px2.iter_mut().zip(bands) {
            if let Some(variance) = learned.variance_px2(band) {
                *covariance = [[variance, 0.0], [0.0, variance]];
            }
        }
    }
}
