//! Centres by one Gauss-Newton step of a matched filter for a blurred disc, with precomputed integer weights.
//!
//! The weights are the best linear unbiased estimator of the displacement in the image's noise and grain,
//! for a disc of that radius and blur at the nearest of 4 x 4 sub-pixel positions. (It is Lucas and
//! Kanade's step with the template's slopes instead of the image's: Baker and Matthews, "Lucas-Kanade 20
//! years on", IJCV 2004, section 3.2.) The weights are insensitive to contrast, ground, light slope,
//! radius, stretch and blur. The remaining displacement after a step is of third order.

mod cholesky;
mod correlate;
mod covariance;
mod design;
mod disc;
mod filter;
mod learn;
mod support;
mod tables;

pub use filter::{MAX_MISFIT, Refined};

use super::covered;
use super::noise::{CLEARANCE_PX, ENOUGH_ROWS, Noise, NoiseMeter, every_row_of};
use super::weighted::WeightedCentroid;
use super::{CentreRung, Components, MaskedMarkers};
use crate::detect::markers::Markers;
use crate::detect::mask::bit_rows::BitRow;
use crate::detect::mask::components::{Blob, Run};
use crate::detect::window::size::MarkerSize;
use crate::image::GrayView;
use crate::math::{DVec2, round};
use crate::params::DetectParams;
use filter::MatchedFilter;
use learn::Samples;

/// Standard deviation of an intensity-weighted centroid over that of a step, if the step failed: 2.0 on
/// inclined markers of a rendered dome. Twice as much overstated their variance fourfold.
const UNFITTED: f64 = 2.0;

/// The matched filter and the learning of its weights.
#[derive(Clone, Debug)]
pub struct Matched {
    filter: MatchedFilter,
    samples: Samples,
    meter: NoiseMeter,
    weighted: WeightedCentroid,
    variance_px2: f64,
}

impl Matched {
    /// Creates the rung from its settings.
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            filter: MatchedFilter::new(params),
            samples: Samples::default(),
            meter: NoiseMeter::default(),
            weighted: WeightedCentroid::new(params),
            variance_px2: params.centre_sigma_px * params.centre_sigma_px,
        }
    }

    /// Learns blur and radius of an image's discs from some of its markers, given by approximate centres
    /// and areas. Chooses the weights for these, for the noise and for the distance of neighbours.
    /// Weights are kept from image to image while they are suitable.
    pub fn prepare(&mut self, image: GrayView<'_>, noise: Noise, markers: &Markers) {
        self.filter.noise = noise;
        self.filter.learn(&mut self.samples, image, markers);
    }

    /// Standard deviation of the total blur of the last image learned, pixels.
    #[must_use]
    pub const fn blur_px(&self) -> f64 {
        self.filter.blur_px
    }

    /// Radius of a disc whose component has this area, in the last image learned.
    #[must_use]
    pub fn radius_px(&self, area_px2: u32) -> f64 {
        self.filter.radius_px(area_px2)
    }

    /// Finds the disc of about this radius whose centre is within about a pixel of `near_px`. `None` if
    /// the support leaves the image, nothing of that polarity is there, or steps do not converge.
    pub fn refine(&mut self, image: GrayView<'_>, near_px: DVec2, radius_px: f64) -> Option<Refined> {
        self.filter.refine(image, near_px, radius_px)
    }

    /// Replaces centre and covariance of a listed marker, as a disc whose component has about this area;
    /// returns whether it succeeded.
    fn replace(
        &mut self,
        image: GrayView<'_>,
        (index, area_px2): (usize, u32),
        markers: &mut Markers,
    ) -> bool {
        let (near_px, radius_px) = (markers.centres_px[index], self.filter.radius_px(area_px2));
        let found =
            self.filter.refine(image, near_px, radius_px).filter(|refined| refined.misfit <= MAX_MISFIT);
        match found {
            Some(refined) => {
                markers.centres_px[index] = refined.centre_px;
                markers.covariance_px2[index] = refined.covariance_px2;
            }
            None => {
                markers.unfitted += 1;
                let least = self.unfitted_variance_px2(radius_px);
                let covered = covered::unfitted_px2(image, markers, index);
                let [[xx, _], [_, yy]] = &mut markers.covariance_px2[index];
                (*xx, *yy) = (xx.max(least) + covered, yy.max(least) + covered);
            }
        }
        found.is_some()
    }

    /// Least variance of a coordinate, px², if the step failed.
    fn unfitted_variance_px2(&mut self, radius_px: f64) -> f64 {
        let Some((_, [white, grain])) = self.filter.tables.find(radius_px) else { return 0.0 };
        let contrast = self.filter.contrast_levels;
        UNFITTED * UNFITTED * (white + grain) / (contrast * contrast).max(1.0)
    }
}

impl CentreRung for Matched {
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers) {
        found.push_means(self.variance_px2, out);
        let (image, components) = (found.image, &found.segmentation.components);
        let every = every_row_of(image.height(), ENOUGH_ROWS);
        let cover = |rows, near: &mut BitRow| components.cover(rows, 1, near);
        let noise = self.meter.run_rows(image, &out.centres_px, (every, CLEARANCE_PX), cover);
        self.prepare(image, noise.unwrap_or_default(), out);
        self.weighted.reserve(image.height());
        for (k, blob) in found.markers().enumerate() {
            if !self.replace(image, (k, out.area_px2[k]), out) {
                out.centres_px[k] = self.weighted.run(image, blob, found.runs(blob));
            }
        }
    }

    fn centre_piece(&mut self, _: GrayView<'_>, blob: &Blob, _: &[Run]) -> DVec2 {
        blob.mean_px()
    }

    fn refine_masked(
        &mut self,
        found: &MaskedMarkers<'_>,
        weighted: &mut dyn FnMut(usize) -> Option<DVec2>,
        out: &mut Markers,
    ) {
        let (image, gel) = (found.image, (found.mask, out.centres_px.as_slice()));
        let every = every_row_of(image.height(), ENOUGH_ROWS);
        let noise = self.meter.run(image, gel, every, CLEARANCE_PX);
        self.prepare(image, noise.unwrap_or_default(), out);
        for k in 0..out.centres_px.len() {
            if !self.replace(image, (k, out.area_px2[k]), out)
                && let Some(centre_px) = weighted(k)
            {
                out.centres_px[k] = centre_px;
            }
        }
    }

    /// Uses the weights chosen for the last whole image searched, and the usual radius, which is known
    /// better than that of a single window.
    fn refine_windows(&mut self, image: GrayView<'_>, size: &MarkerSize, out: &mut Markers) -> bool {
        let usual_px2 = round(size.usual_area_px2()) as u32;
        for k in 0..out.centres_px.len() {
            self.replace(image, (k, usual_px2), out);
        }
        true
    }

    fn window_variance_px2(&self, _: u8) -> f64 {
        self.variance_px2
    }

    fn forget(&mut self) {
        self.filter.forget();
    }
}
