//! Variances of the soft-threshold centroids of
//! [`Centre::SoftThreshold`](crate::params::Centre::SoftThreshold).
//!
//! Such a centroid is a weighted sum of the pixels at the marker's edge and in the window's corners, with
//! known weights. Its variance is that of the sum in the image's noise and grain. White noise counts
//! relative to the marker's own contrast: by its square, and by more if noise is so strong that gel gets
//! weights. Grain is in the paint and scales with the light like the contrast, so its part is the same
//! for all markers.

mod profile;

use super::covered;
use super::noise::{CLEARANCE_PX, MarkerPixels, Noise, NoiseMeter, NoiseRows};
use super::weighted::WeightedCentroid;
use super::{CentreRung, Components};
use crate::detect::markers::Markers;
use crate::detect::window::classifier::{WindowClassifier, WindowMarker};
use crate::detect::window::size::MarkerSize;
use crate::detect::window::sized::SizedClassifier;
use crate::detect::workload::Workload;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::{DetectParams, Polarity};
use alloc::vec::Vec;
use profile::{Profile, Variances};

/// Rows from which noise is measured. With half as many, the grain that matters beside noise of 18 levels
/// is seldom detected.
const NOISE_ROWS: usize = 80;

/// Most markers from which the profile of their weights is learned, evenly spread over the list: as many as a
/// print of 25x25 has, for which the covariances were calibrated. With 200 of those, the variances on the
/// path-traced working images would be 7 % larger in the median and up to 36 %, since the sampling error of
/// an uneven profile is larger.
pub(crate) const MAX_PROFILE_MARKERS: usize = 625;

/// Variance of 1 / band² over its square, for noise equal to the band. The band is half the contrast
/// between the corners' mean of 36 pixels or so and the darkest pixel, the least of some twenty, whose
/// standard deviation is half a pixel's (Tippett 1925).
const SCATTER: f64 = 4.0 * 0.25 * (0.25 + 1.0 / 36.0);

/// What was last learned from an image.
#[derive(Clone, Debug)]
struct BandNoise {
    learned: Option<Learned>,
}

#[derive(Clone, Copy, Debug)]
struct Learned {
    variances: Variances,
    /// Part that is the same for all markers: grain and the model's own error.
    others_px2: f64,
    usual: Usual,
}

/// Distribution of the bands over the markers of an image.
#[derive(Clone, Copy, Debug)]
struct Usual {
    /// Mean of 1 / band² over all of them.
    per_band2: f64,
    /// Share of a marker's own deviation from it that its variance follows.
    own: f64,
}

impl Usual {
    /// Noise makes bands differ too, and the variance follows half of these differences: at the same
    /// contrast, a wider band makes the centre less sensitive to each pixel but contains more pixels. The
    /// rest are differences of contrast (empirical Bayes: their share of the variance over markers is the
    /// part not explained by noise).
    fn of(bands: &[u8], noise_share: f64) -> Option<Self> {
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for band in bands.iter().filter(|&&band| band > 0).map(|&band| f64::from(band)) {
            let per_band2 = 1.0 / (band * band);
            count += 1.0;
            sum += per_band2;
            squares += per_band2 * per_band2;
        }
        let by_noise = SCATTER * noise_share * noise_share * sum * sum;
        let differ = count * squares - sum * sum;
        (count > 0.0)
            .then(|| Self { per_band2: sum / count, own: 1.0 - 0.5 * by_noise / differ.max(by_noise) })
    }
}

impl BandNoise {
    const fn new() -> Self {
        Self { learned: None }
    }

    fn forget(&mut self) {
        self.learned = None;
    }

    /// Learns from some of these markers, and from the bands of all, in an image with this noise.
    fn learn(
        &mut self,
        image: GrayView<'_>,
        classifier: &SizedClassifier,
        noise: &Noise,
        centres_px: &[DVec2],
        bands: &[u8],
    ) {
        match classifier {
            SizedClassifier::Small(classifier) => self.learn_by(image, classifier, noise, centres_px, bands),
            SizedClassifier::Large(classifier) => self.learn_by(image, classifier, noise, centres_px, bands),
        }
    }

    fn learn_by<const L: usize>(
        &mut self,
        image: GrayView<'_>,
        classifier: &WindowClassifier<L>,
        noise: &Noise,
        centres_px: &[DVec2],
        bands: &[u8],
    ) {
        let mut profile = Profile::new(classifier.size().radius_px);
        let count = centres_px.len().min(MAX_PROFILE_MARKERS);
        for at_px in (0..count).map(|k| centres_px[k * centres_px.len() / count]) {
            if let Some(frame) =
                classifier.shares(image, at_px, |distance_px2, share| profile.add(distance_px2, share))
            {
                profile.close(frame);
            }
        }
        profile.end_at_edge();
        self.learned = profile.variances(noise).and_then(|variances| {
            let others_px2 = variances.grain + profile.grid_error_px2(variances.noise_share);
            Some(Learned { variances, others_px2, usual: Usual::of(bands, variances.noise_share)? })
        });
    }

    /// Variance of a coordinate of a marker with this band; `typed_px2`, the configured one, before
    /// anything was learned.
    ///
    /// A marker without a band is touched by something else, possibly noise. Its variance is at least
    /// that of the usual marker and at least `typed_px2`.
    fn variance_px2(&self, band: u8, typed_px2: f64) -> f64 {
        let Some(Learned { variances, others_px2, usual }) = self.learned else { return typed_px2 };
        let Variances { white, per_band2, power, .. } = variances;
        if band == 0 {
            return typed_px2.max(white + others_px2);
        }
        let own = 1.0 / (f64::from(band) * f64::from(band));
        let ratio = (usual.per_band2 + usual.own * (own - usual.per_band2)) / per_band2;
        // Second-order expansion above one; below one its inverse, which stays positive.
        let raised = |more: f64| 1.0 + power * more * (1.0 + 0.5 * (power - 1.0) * more);
        let grown = if ratio >= 1.0 { raised(ratio - 1.0) } else { 1.0 / raised(1.0 / ratio - 1.0) };
        white * grown + others_px2
    }
}

/// Soft-threshold centroids with their variances, and scratch.
#[derive(Clone, Debug)]
pub(in crate::detect) struct SoftThreshold {
    polarity: Polarity,
    variance_px2: f64,
    weighted: WeightedCentroid,
    meter: NoiseMeter,
    noise: BandNoise,
    /// [`WindowMarker::band`] of each marker found by the window classifier, 0 for others.
    bands: Vec<u8>,
}

impl SoftThreshold {
    /// Creates the rung from its settings.
    pub fn new(params: &DetectParams) -> Self {
        Self {
            polarity: params.polarity,
            variance_px2: params.centre_sigma_px * params.centre_sigma_px,
            weighted: WeightedCentroid::new(params),
            meter: NoiseMeter::default(),
            noise: BandNoise::new(),
            bands: Vec::new(),
        }
    }

    /// Starts an image of at most `max_markers` markers.
    pub fn start(&mut self, image: GrayView<'_>, max_markers: usize) {
        self.weighted.reserve(image.height());
        self.bands.clear();
        self.bands.reserve(max_markers);
    }

    /// Appends a marker found by the window classifier. Its variance is set by [`Self::state_variances`].
    pub fn push(&mut self, marker: &WindowMarker, out: &mut Markers) {
        self.bands.push(marker.band);
        out.push(marker.centre_px, self.variance_px2, marker.area_px2);
    }

    /// Computes and sets the variances of the listed markers of one size.
    pub fn state_variances(
        &mut self,
        image: GrayView<'_>,
        size: &MarkerSize,
        pixels: MarkerPixels<'_>,
        out: &mut Markers,
    ) {
        let Self { polarity, variance_px2, meter, noise, bands, .. } = self;
        let classifier = SizedClassifier::new(*size, *polarity);
        let rows = NoiseRows { rows: NOISE_ROWS, clearance_px: CLEARANCE_PX };
        let measured = meter.run(image, pixels, &out.centres_px, rows).unwrap_or_default();
        noise.learn(image, &classifier, &measured, &out.centres_px, bands);
        let markers = out.covariance_px2.iter_mut().zip(bands).zip(out.centres_px.iter().zip(&out.area_px2));
        for ((covariance, &mut band), (&centre_px, &area_px2)) in markers {
            let usual_px2 = size.usual_area_px2();
            let covered = covered::without_band_px2(band, image, centre_px, area_px2, usual_px2);
            let variance = noise.variance_px2(band, *variance_px2) + covered;
            *covariance = [[variance, 0.0], [0.0, variance]];
        }
    }
}

impl CentreRung for SoftThreshold {
    /// Uses windows that show whole markers, otherwise the intensity-weighted centroid of the component.
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers) {
        let size = MarkerSize::of(found.filter.usual_px2);
        let classifier = size.map(|size| SizedClassifier::new(size, self.polarity));
        self.start(found.image, found.max_markers);
        for blob in found.markers() {
            let marker =
                classifier.as_ref().and_then(|classifier| classifier.centre(found.image, blob.mean_px()));
            let marker = marker.unwrap_or_else(|| WindowMarker {
                centre_px: self.weighted.run(found.image, blob, found.runs(blob)),
                area_px2: 0,
                band: 0,
            });
            self.push(&WindowMarker { area_px2: blob.area_px2, ..marker }, out);
        }
        if let Some(size) = size {
            let pixels = MarkerPixels::Components { components: &found.segmentation.components, scale: 1 };
            self.state_variances(found.image, &size, pixels, out);
        }
    }

    fn window_variance_px2(&self, band: u8) -> f64 {
        self.noise.variance_px2(band, self.variance_px2)
    }

    fn add_workload(&self, workload: &mut Workload) {
        self.meter.add_workload(workload);
    }

    fn forget(&mut self) {
        self.noise.forget();
    }
}

#[cfg(test)]
mod tests {
    use super::{BandNoise, Learned, Usual, Variances};
    use crate::math::random::Stream;
    use crate::math::{abs, sqrt};
    use alloc::vec::Vec;

    const NOISE_SHARE: f64 = 0.25;
    const CONTRAST: f64 = 140.0;

    /// Bands of markers with contrasts uniform within this share, from the darkest of twenty pixels and
    /// the mean of 36.
    fn bands(differ: f64) -> Vec<u8> {
        let mut stream = Stream::new(7, "bands");
        let noise = NOISE_SHARE * 0.5 * CONTRAST;
        let band = |k: u32| {
            let contrast = CONTRAST * (1.0 + differ * (f64::from(k % 101) / 50.0 - 1.0));
            let darkest = (0..20).map(|_| stream.normal()).fold(f64::MIN, f64::max);
            (0.5 * (contrast + noise * (darkest - 1.87 + stream.normal() / 6.0))) as u8
        };
        (0..20_000).map(band).collect()
    }

    /// Noise alone explains everything; beside contrasts uniform within ±d, of variance d² / 3, it
    /// explains its share.
    #[test]
    fn bands_that_differ_by_noise_count_for_half() {
        let own = |bands: &[u8]| Usual::of(bands, NOISE_SHARE).unwrap().own;
        assert!((0.5..0.56).contains(&own(&bands(0.0))), "{}", own(&bands(0.0)));
        let (differ, noise) = (0.12_f64, 0.25 * NOISE_SHARE * NOISE_SHARE * (0.25 + 1.0 / 36.0));
        let expected = 1.0 - 0.5 * noise / (noise + differ * differ / 3.0);
        assert!(abs(own(&bands(differ)) - expected) < 0.05, "{} {expected}", own(&bands(differ)));
        assert!(own(&bands(0.5)) > 0.9 && Usual::of(&[0, 0], NOISE_SHARE).is_none());
    }

    /// Correct to second order of the power, and no better than others without a band.
    #[test]
    fn faint_markers_are_known_less_and_those_without_a_band_no_better_than_usual() {
        let per_band2 = 1.0 / 4900.0;
        let variances = Variances { white: 0.01, grain: 0.001, per_band2, power: 1.5, noise_share: 0.3 };
        let usual = Usual { per_band2, own: 1.0 };
        let noise = BandNoise { learned: Some(Learned { variances, others_px2: 0.001, usual }) };
        let at = |band| noise.variance_px2(band, 0.0016);
        for band in [56_u8, 63, 70, 77, 84] {
            let ratio = 4900.0 / (f64::from(band) * f64::from(band));
            let expected = 0.001 + 0.01 * ratio * sqrt(ratio);
            assert!(abs(at(band) / expected - 1.0) < 0.01, "{band}: {} {expected}", at(band));
        }
        assert!((1..255).all(|band| at(band) > at(band + 1) && at(band + 1) > 0.001));
        assert!(abs(at(0) - 0.011) < 1e-6);
        assert_eq!(noise.variance_px2(0, 0.02), 0.02);
        assert_eq!(BandNoise::new().variance_px2(70, 0.0016), 0.0016);
    }
}
