//! How well the centres of [`Centre::Band`](crate::params::Centre::Band) are known.
//!
//! Such a centre answers to the pixels of the marker's edge, and of the window's corners, by known weights: its variance is that
//! of their sum in the image's noise and grain. White noise counts by the marker's own contrast: by its square, and by more where
//! noise is so strong that gel gets weights. Grain is of the paint, and fades with the light as the contrast does, so that its part
//! is the same for all markers.

mod profile;

use super::covered;
use super::fit::{CLEARANCE_PX, Noise};
use super::glance::{Eye, Eyes, Kind};
use super::row_bits::RowBits;
use super::{Detector, Markers, rows_between, searched};
use crate::image::GrayView;
use crate::math::DVec2;
pub(super) use profile::Frame;
use profile::{Profile, Variances};

/// Rows from which noise is measured: in half as many the grain that matters most beside noise of 18 levels is seldom seen.
const NOISE_ROWS: usize = 80;
/// Markers from whose windows the profile is taken, spread evenly: some 80 pixels in each ring of the edge.
const SAMPLES: usize = 12;

/// Variance of 1 / band² over its square by noise of the band's own size: the band is half the contrast of the darkest pixel, the
/// least of some twenty, whose deviation is half that of one (Tippett 1925), and of the corners' mean of 36 or so.
const SCATTER: f64 = 4.0 * 0.25 * (0.25 + 1.0 / 36.0);

/// What was last learned of an image.
#[derive(Clone, Debug)]
pub(super) struct BandNoise {
    learned: Option<Learned>,
}

#[derive(Clone, Copy, Debug)]
struct Learned {
    variances: Variances,
    /// What is the same for all markers: grain, and the model's own error.
    others_px2: f64,
    usual: Usual,
}

/// How markers of an image differ in their bands.
#[derive(Clone, Copy, Debug)]
struct Usual {
    /// Mean of 1 / band² over all of them.
    per_band2: f64,
    /// Share of a marker's own difference from it that its variance follows.
    own: f64,
}

impl Usual {
    /// Noise makes bands differ too, and of these differences a variance follows half: at the same contrast the centre answers less to
    /// each pixel of a wider band, which holds more of them. The rest are differences of contrast (empirical Bayes: their share of
    /// the variance over markers is what noise does not explain).
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
    pub fn new() -> Self {
        Self { learned: None }
    }

    pub fn forget(&mut self) {
        self.learned = None;
    }

    /// Learns from some of these markers, and from the bands of all, in an image of this noise.
    pub fn learn<const L: usize>(
        &mut self,
        image: GrayView<'_>,
        eye: &Eye<L>,
        noise: &Noise,
        centres_px: &[DVec2],
        bands: &[u8],
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
        self.learned = profile.variances(noise).and_then(|variances| {
            let others_px2 = variances.grain + profile.grid_error_px2(variances.noise_share);
            Some(Learned { variances, others_px2, usual: Usual::of(bands, variances.noise_share)? })
        });
    }

    /// Variance of a coordinate of a marker with this contrast between the band's ends; what is typed while nothing was learned.
    ///
    /// A centre without a band is that of a marker which something else touches, noise even: it is known no better than the
    /// usual one alone, nor than what is typed.
    pub fn variance_px2(&self, band: u8, typed_px2: f64) -> f64 {
        let Some(Learned { variances, others_px2, usual }) = self.learned else { return typed_px2 };
        let Variances { white, per_band2, power, .. } = variances;
        if band == 0 {
            return typed_px2.max(white + others_px2);
        }
        let own = 1.0 / (f64::from(band) * f64::from(band));
        let ratio = (usual.per_band2 + usual.own * (own - usual.per_band2)) / per_band2;
        // To second order from one upwards; and downwards its inverse, which stays positive.
        let raised = |more: f64| 1.0 + power * more * (1.0 + 0.5 * (power - 1.0) * more);
        let grown = if ratio >= 1.0 { raised(ratio - 1.0) } else { 1.0 / raised(1.0 / ratio - 1.0) };
        white * grown + others_px2
    }
}

impl Detector {
    /// Learns how well markers of one kind, and [`Self::bands`], are known in an image, and tells each.
    pub(super) fn tell_band_noise(&mut self, image: GrayView<'_>, kind: &Kind, out: &mut Markers) {
        let typed_px2 = self.typed_variance_px2();
        let (eyes, every) = (Eyes::new(*kind, self.flip()), rows_between(image.height(), NOISE_ROWS));
        let Self { segments, half, meter, bands, band_noise: Some(learned), .. } = self else { return };
        let (segments, scale) = searched(segments, half.as_ref());
        let cover = |rows, near: &mut RowBits| segments.components.cover(rows, scale, near);
        let noise = meter.run_rows(image, &out.centres_px, (every, CLEARANCE_PX), cover).unwrap_or_default();
        eyes.learn(learned, image, &noise, &out.centres_px, bands);
        let markers = out.covariance_px2.iter_mut().zip(bands).zip(out.centres_px.iter().zip(&out.area_px2));
        for ((covariance, &mut band), (&centre_px, &area_px2)) in markers {
            let areas_px2 = (area_px2, kind.usual_area_px2());
            let covered = covered::without_band_px2(band, image, centre_px, areas_px2);
            let variance = learned.variance_px2(band, typed_px2) + covered;
            *covariance = [[variance, 0.0], [0.0, variance]];
        }
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

    /// Bands of markers whose contrasts differ evenly by this share, by the darkest of twenty pixels beside the mean of 36.
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

    /// Noise alone explains all; beside contrasts that differ by d evenly, of variance d² / 3, its share.
    #[test]
    fn bands_that_differ_by_noise_count_for_half() {
        let own = |bands: &[u8]| Usual::of(bands, NOISE_SHARE).unwrap().own;
        assert!((0.5..0.56).contains(&own(&bands(0.0))), "{}", own(&bands(0.0)));
        let (differ, noise) = (0.12_f64, 0.25 * NOISE_SHARE * NOISE_SHARE * (0.25 + 1.0 / 36.0));
        let expected = 1.0 - 0.5 * noise / (noise + differ * differ / 3.0);
        assert!(abs(own(&bands(differ)) - expected) < 0.05, "{} {expected}", own(&bands(differ)));
        assert!(own(&bands(0.5)) > 0.9 && Usual::of(&[0, 0], NOISE_SHARE).is_none());
    }

    /// To the second order of the power, and no better than others where there is no band.
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
