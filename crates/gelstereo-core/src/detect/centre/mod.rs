//! From a component to a sub-pixel centre: a trait, and a rung for every [`Centre`](crate::params::Centre).

mod binary;
pub(super) mod covered;
pub mod fit;
mod influence;
pub mod matched;
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
use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;

/// The components of an image, and which of them are markers.
pub(super) struct Components<'a> {
    pub image: GrayView<'a>,
    pub segmentation: &'a mut Segmentation,
    pub filter: &'a BlobFilter,
    /// Most markers that an image of this size may have.
    pub max_markers: usize,
}

impl Components<'_> {
    /// Components that are markers and lie whole in the image.
    fn markers(&self) -> impl Iterator<Item = &Blob> {
        self.segmentation.components.blobs().iter().filter(|blob| self.filter.passes_whole(blob))
    }

    fn runs(&self, blob: &Blob) -> impl Iterator<Item = &Run> + Clone {
        self.segmentation.components.runs(blob)
    }

    /// Lists the means of the markers' components.
    fn push_means(&self, variance_px2: f64, out: &mut Markers) {
        self.markers().for_each(|blob| out.push(blob.mean_px(), variance_px2, blob.area_px2));
    }
}

/// A marker found in a window of the mask.
#[derive(Clone, Copy, Debug)]
pub(super) struct MaskedMarker {
    /// Index of the expected position.
    pub position: u32,
    /// Row and column of its first pixel: no two components of an image share it.
    pub key: (u16, u16),
    pub centre_px: DVec2,
    pub area_px2: u32,
    pub spread_px2: Symmetric<2>,
}

/// The markers found in windows of an image's mask.
pub(super) struct MaskedMarkers<'a> {
    pub image: GrayView<'a>,
    pub mask: &'a [u8],
    /// In the order in which the markers are listed.
    pub markers: &'a [MaskedMarker],
    pub max_markers: usize,
}

/// A way from components to centres with covariances.
pub(super) trait CentreRung {
    /// Lists the markers of an image in the order of their components; `out` is empty, with room for all.
    fn centre_components(&mut self, found: &mut Components<'_>, out: &mut Markers);

    /// First centre of a component in a window of the mask.
    fn centre_piece(&mut self, image: GrayView<'_>, blob: &Blob, runs: &[Run]) -> DVec2;

    /// Refines listed markers; `weighted` gives the intensity-weighted centroid of one of them.
    fn refine_masked(
        &mut self,
        _: &MaskedMarkers<'_>,
        _weighted: &mut dyn FnMut(usize) -> Option<DVec2>,
        _: &mut Markers,
    ) {
    }

    /// Refines listed markers that windows of the image showed; whether it may have moved any.
    fn refine_windows(&mut self, _: GrayView<'_>, _: &MarkerSize, _: &mut Markers) -> bool {
        false
    }

    /// Variance of a coordinate of a marker that a window showed with this contrast over which weights grow, px².
    fn window_variance_px2(&self, band: u8) -> f64;

    /// Whether its covariances allow for light's reflections.
    fn sees_glare(&self) -> bool {
        false
    }

    /// Forgets what was learned of earlier images.
    fn forget(&mut self) {}
}
