//! How well the centres of [`Centre::Band`](crate::params::Centre::Band) are known.
//!
//! Such a centre answers to the pixels of the marker's edge, and of the window's corners, by known weights: its variance is that
//! of their sum in the image's noise and grain. White noise counts by the square of the marker's own contrast; grain is of the
//! paint, and fades with the light as the contrast does, so that its part is the same for all markers.

mod profile;

use super::fit::{CLEARANCE_PX, Noise};
use super::glance::{Eye, Eyes, Kind};
use super::{Detector, Markers, rows_between, searched};
use crate::image::GrayView;
use crate::math::{DVec2, exp};
pub(super) use profile::Frame;
use profile::{Profile, Variances};

/// Rows from which noise is measured: in half as many the grain that matters most beside noise of 18 levels is seldom seen.
const NOISE_ROWS: usize = 80;
/// Markers from whose windows the profile is taken, spread evenly: some 80 pixels in each ring of the edge.
const SAMPLES: usize = 12;
/// Standard deviation of a coordinate without any noise, for weights that begin and end within a pixel follow the grid: dots of 4
/// to 5 px behind 0.8 px of defocus (simulated). Noise rounds the ends off: over this share of the band the error falls by e
/// (0.009, 0.0073, 0.0065, 0.0050, 0.0038 px at noise of 0, 0.034, 0.05, 0.1, 0.15 of the band).
const MODEL_PX: f64 = 0.009;
const ROUNDED_OFF: f64 = 0.19;

/// What was last learned of an image.
#[derive(Clone, Debug)]
pub(super) struct BandNoise {
    learned: Option<Variances>,
}

impl BandNoise {
    pub fn new() -> Self {
        Self { learned: None }
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
        let mut profile = Profile::new(eye.kind().radius_px);
        let samples = SAMPLES.min(centres_px.len());
        for at_px in (0..samples).map(|k| centres_px[(2 * k + 1) * centres_px.len() / (2 * samples)]) {
            if let Some(frame) =
                eye.shares(image, at_px, |distance_px2, share| profile.add(distance_px2, share))
            {
                profile.close(frame);
            }
        }
        self.learned = profile.variances(noise);
    }

    /// Variance of a coordinate of a marker with this contrast between the band's ends; `None` while nothing was learned.
    pub fn variance_px2(&self, band: u8) -> Option<f64> {
        let Variances { white, grain, noise_share } = self.learned.filter(|_| band > 0)?;
        let model_px = MODEL_PX * exp(-noise_share / ROUNDED_OFF);
        Some(white / (f64::from(band) * f64::from(band)) + grain + model_px * model_px)
    }
}

impl Detector {
    /// Learns how well markers of one kind, and [`Self::bands`], are known in an image, and tells each.
    pub(super) fn tell_band_noise(&mut self, image: GrayView<'_>, kind: &Kind, out: &mut Markers) {
        let (eyes, every) = (Eyes::new(*kind, self.flip()), rows_between(image.height(), NOISE_ROWS));
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
