//! Centres from a model of the whole marker: a blurred disc, tilted into an ellipse, on ground with a
//! light slope.
//!
//! Nine parameters per marker (centre, ellipse, contrast, ground, its two slopes), and blur, noise and grain
//! for the whole image. Gauss-Newton steps move the outline until the residuals, weighted for the image's
//! noise along the edge, balance. The first step is a linear filter common to all markers. In white noise
//! that is least squares. In grain, which correlates neighbouring pixels, the errors of least squares would
//! be half as large again as the bound (Kay, Estimation Theory, section 4.5: whitened residuals).

mod bessel;
mod contour;
mod disc;
mod edge;
mod extent;
mod fitter;
mod lanes;
mod learn;
mod step;
mod template;

use super::noise::MarkerPixels;
pub use super::noise::Noise;
pub use step::{Fitted, Start};

use super::covered;
use super::weighted::WeightedCentroid;
use super::{CentreRung, Components};
use crate::detect::markers::Markers;
use crate::detect::mask::components::{Blob, Limits};
use crate::detect::mask::segmentation::MIN_NEIGHBOUR_PX2;
use crate::detect::window::size::MarkerSize;
use crate::detect::workload::Workload;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::DetectParams;
use crate::spatial::Grid;
use alloc::vec::Vec;
use core::f64::consts::PI;
use fitter::{FIRST_BLUR_PX, Fitter, REACH_PX};
use learn::Learner;

/// Least search radius for neighbours.
const MIN_FAR_PX: f64 = 2.0 + REACH_PX + 4.0 * FIRST_BLUR_PX;
/// Standard deviation of an intensity-weighted centroid over the bound, if the fit did not converge.
const UNFITTED: f64 = 4.0;

/// A marker's place in the list, and its approximate radius.
#[derive(Clone, Copy)]
struct Listed {
    index: usize,
    radius_px: f64,
}

/// Fit of all markers of an image, with its scratch.
#[derive(Clone, Debug)]
pub struct DiscFit {
    fitter: Fitter,
    learner: Learner,
    weighted: WeightedCentroid,
    variance_px2: f64,
    starts: Vec<Start>,
    /// Indices of the last image's markers that were not fitted.
    unfitted: Vec<u32>,
    /// Centres of all components, then those of the listed markers once they are asked for.
    grid: Grid,
    has_listed: bool,
    centres_px: Vec<DVec2>,
}

impl DiscFit {
    /// Creates the rung from its settings.
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            fitter: Fitter::new(params),
            learner: Learner::new(),
            weighted: WeightedCentroid::new(params),
            variance_px2: params.centre_sigma_px * params.centre_sigma_px,
            starts: Vec::new(),
            unfitted: Vec::new(),
            grid: Grid::default(),
            has_listed: false,
            centres_px: Vec::new(),
        }
    }

    /// Noise of the last image learned.
    #[must_use]
    pub const fn noise(&self) -> Noise {
        self.fitter.noise
    }

    /// Standard deviation of its blur, pixels.
    #[must_use]
    pub const fn blur_px(&self) -> f64 {
        self.fitter.blur_px
    }

    /// Learns noise and blur of an image from its gel (`mask` is 0 there) and some of its markers.
    pub fn learn(&mut self, image: GrayView<'_>, mask: &[u8], starts: &[Start]) {
        self.learner.reserve(starts.len());
        self.learner.learn(&mut self.fitter, image, MarkerPixels::Mask(mask), starts);
    }

    /// Fits one marker with the noise and blur last learned. `None` if the fit does not converge,
    /// converges to a disc unlike the start's, or includes a light's reflection.
    #[must_use]
    pub fn run(&mut self, image: GrayView<'_>, start: &Start) -> Option<Fitted> {
        self.fitter.run(image, start)
    }

    /// Clears the markers of the last image and reserves memory for `max`.
    fn clear(&mut self, max: usize) {
        self.starts.clear();
        self.starts.reserve(max);
        self.unfitted.clear();
        self.unfitted.reserve(max);
        self.learner.reserve(max);
    }

    /// Adds a marker with its approximate centre and spread ([`Blob::spread_px2`]).
    fn add(&mut self, centre_px: DVec2, spread_px2: Symmetric<2>) {
        self.starts.push(Start { centre_px, spread_px2, neighbour_px: f64::INFINITY });
    }

    /// Fits the added markers, which `markers` lists in the same order, and replaces centre and
    /// covariance on success. `others_px` are the centres of all components of the image, since pixels of
    /// neighbours are excluded.
    fn finish(
        &mut self,
        image: GrayView<'_>,
        pixels: MarkerPixels<'_>,
        others_px: impl Iterator<Item = DVec2>,
        markers: &mut Markers,
    ) {
        self.find_neighbours(image, others_px);
        self.learner.learn(&mut self.fitter, image, pixels, &self.starts);
        for k in 0..self.starts.len() {
            let start = &self.starts[k];
            let (fitted, radius_px) = (self.fitter.run(image, start), start.radius_px());
            if !self.replace(image, Listed { index: k, radius_px }, fitted, markers) {
                self.unfitted.push(k as u32);
            }
        }
        markers.unfitted = self.unfitted.len();
    }

    /// Replaces centre and covariance of a listed marker if it was fitted; returns whether it was.
    fn replace(
        &mut self,
        image: GrayView<'_>,
        Listed { index, radius_px }: Listed,
        fitted: Option<Fitted>,
        markers: &mut Markers,
    ) -> bool {
        if let Some(Fitted { centre_px, covariance_px2: [[xx, xy], [_, yy]], .. }) = fitted {
            // What is left of a covered disc may pass for an ellipse.
            let usual_px2 = PI * self.fitter.usual_radius_px() * self.fitter.usual_radius_px();
            let may_be_hidden = covered::may_be_hidden(image, markers, index, usual_px2);
            let hidden = if may_be_hidden { self.covered_px2(image, markers, index) } else { 0.0 };
            markers.centres_px[index] = centre_px;
            markers.covariance_px2[index] = [[xx + hidden, xy], [xy, yy + hidden]];
            return true;
        }
        let min = unfitted_variance_px2(&self.fitter, radius_px);
        let covered = self.covered_px2(image, markers, index);
        let [[xx, _], [_, yy]] = &mut markers.covariance_px2[index];
        (*xx, *yy) = (xx.max(min) + covered, yy.max(min) + covered);
        false
    }

    /// Variance of a listed marker relative to those around it. These are sorted for the first one only: few
    /// images need it.
    fn covered_px2(&mut self, image: GrayView<'_>, markers: &Markers, index: usize) -> f64 {
        if !self.has_listed {
            self.grid.build_evenly(markers.centres_px.iter().copied(), MIN_FAR_PX);
            self.has_listed = true;
        }
        covered::unfitted_px2(image, markers, &self.grid, index)
    }

    fn find_neighbours(&mut self, image: GrayView<'_>, others_px: impl Iterator<Item = DVec2>) {
        let Self { starts, grid, centres_px, .. } = self;
        let widest = starts.iter().map(Start::radius_px).fold(1.0, f64::max);
        // A neighbour farther away takes no pixels.
        let far_px = 2.0 * widest + REACH_PX + 4.0 * FIRST_BLUR_PX;
        centres_px.clear();
        let max = Limits::of(image.width(), image.height()).kept;
        centres_px.reserve(max);
        centres_px.extend(others_px);
        grid.reserve(max, (image.width(), image.height()), MIN_FAR_PX);
        grid.build(centres_px, far_px);
        self.has_listed = false;
        for start in starts {
            let (at, own_px) = (start.centre_px, 0.5 * start.radius_px());
            let other = grid.nearest(centres_px, at, far_px, |n| centres_px[n].distance(at) > own_px);
            start.neighbour_px = other.map_or(f64::INFINITY, |n| centres_px[n].distance(at));
        }
    }
}

impl CentreRung for DiscFit {
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers) {
        found.push_means(self.variance_px2, out);
        self.clear(found.max_markers);
        let (image, components) = (found.image, &found.segmentation.components);
        found.markers().for_each(|blob| self.add(blob.mean_px(), blob.spread_px2(found.runs(blob))));
        let others = components.blobs().iter().filter(|blob| blob.area_px2 >= MIN_NEIGHBOUR_PX2);
        let pixels = MarkerPixels::Components { components, scale: 1 };
        self.finish(image, pixels, others.map(Blob::mean_px), out);
        self.weighted.reserve(image.height());
        let mut unfitted = self.unfitted.iter().map(|&k| k as usize).peekable();
        for (k, blob) in found.markers().enumerate() {
            if unfitted.next_if_eq(&k).is_some() {
                out.centres_px[k] = self.weighted.run(image, blob, found.runs(blob));
            }
        }
    }

    fn reserve_windows(&mut self, max: usize, size_px: (usize, usize)) {
        self.grid.reserve(max, size_px, MIN_FAR_PX);
    }

    /// Uses what was learned from the last whole image searched.
    fn refine_windows(&mut self, image: GrayView<'_>, _: &MarkerSize, out: &mut Markers) -> bool {
        let radius_px = self.fitter.usual_radius_px();
        self.has_listed = false;
        for k in 0..out.centres_px.len() {
            let fitted = self.fitter.run_usual(image, out.centres_px[k]);
            out.unfitted += usize::from(!self.replace(image, Listed { index: k, radius_px }, fitted, out));
        }
        true
    }

    fn window_variance_px2(&self, _: u8) -> f64 {
        self.variance_px2
    }

    /// A fitted marker is judged by its outline, and areas of others are in their variances already.
    fn area_shows_glare(&self) -> bool {
        false
    }

    fn add_workload(&self, workload: &mut Workload) {
        self.learner.add_workload(workload);
        self.fitter.add_workload(workload);
    }

    fn forget(&mut self) {
        self.fitter.forget();
    }
}

/// Least variance of a coordinate, px², of a marker that was not fitted.
fn unfitted_variance_px2(fitter: &Fitter, radius_px: f64) -> f64 {
    // (sigma / C)² 2 b / (sqrt(pi) r) for white noise.
    let per_contrast2 = fitter.noise.variance_levels2() / (fitter.contrast * fitter.contrast).max(1.0);
    UNFITTED * UNFITTED * per_contrast2 * 1.13 * fitter.blur_px / radius_px.max(1.0)
}
