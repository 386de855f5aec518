//! From a component to a sub-pixel centre: a trait and one rung per [`Centre`](crate::params::Centre).

mod binary;
pub(super) mod covered;
pub mod fit;
mod influence;
mod middle;
pub(super) mod noise;
mod region;
mod rung;
mod sampling;
pub(super) mod soft_threshold;
pub(super) mod weighted;

pub(super) use rung::Rung;

use super::markers::Markers;
use super::mask::blob_filter::BlobFilter;
use super::mask::components::{Blob, Run};
use super::mask::segmentation::Segmentation;
use super::window::size::MarkerSize;
use super::workload::Workload;
use crate::image::GrayView;

/// Components of an image, and the filter that selects the markers.
pub(super) struct Components<'a> {
    pub image: GrayView<'a>,
    pub segmentation: &'a mut Segmentation,
    pub filter: &'a BlobFilter<'a>,
    /// Largest number of markers of an image of this size.
    pub max_markers: usize,
}

impl Components<'_> {
    /// Components that are markers and lie entirely in the image.
    fn markers(&self) -> impl Iterator<Item = &Blob> {
        self.segmentation.components.blobs().iter().filter(|blob| self.filter.passes_whole(blob))
    }

    fn runs(&self, blob: &Blob) -> impl Iterator<Item = &Run> + Clone {
        self.segmentation.components.runs(blob)
    }

    /// Appends the mean positions of the markers' components.
    fn push_means(&self, variance_px2: f64, out: &mut Markers) {
        self.markers().for_each(|blob| out.push(blob.mean_px(), variance_px2, blob.area_px2));
    }
}

/// Method that computes centres and covariances from components.
pub(super) trait CentreRung {
    /// Appends the markers of an image in the order of their components; `out` is empty, with room for all.
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers);

    /// Reserves memory for [`Self::refine_windows`] of so many markers, in images of this size.
    fn reserve_windows(&mut self, _max: usize, _size_px: (usize, usize)) {}

    /// Refines listed markers found by the window classifier; returns whether any may have moved.
    fn refine_windows(&mut self, _: GrayView<'_>, _: &MarkerSize, _: &mut Markers) -> bool {
        false
    }

    /// Variance of a coordinate, px², of a marker found by the window classifier with this band.
    fn window_variance_px2(&self, band: u8) -> f64;

    /// Whether a marker's area shows how much of it a light's reflection hides.
    fn area_shows_glare(&self) -> bool {
        true
    }

    /// Adds what the last image showed of the work of later ones.
    fn add_workload(&self, _: &mut Workload) {}

    /// Discards what was learned from earlier images.
    fn forget(&mut self) {}
}
