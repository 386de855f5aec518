//! Markers found at full resolution.

use crate::detect::centre::{CentreRung, Components};
use crate::detect::error::DetectError;
use crate::detect::markers::{Markers, max_markers};
use crate::detect::mask::blob_filter::BlobFilter;
use crate::detect::mask::segmentation::Segmentation;
use crate::detect::outline::Outline;
use crate::image::GrayView;
use crate::params::DetectParams;
use alloc::vec::Vec;

/// Finds the markers; `out` is empty, with room for all of them, and `areas_px2` is scratch.
///
/// # Errors
/// [`DetectError::TooMany`].
pub(in crate::detect) fn run(
    params: &DetectParams,
    image: GrayView<'_>,
    outline: &Outline,
    segmentation: &mut Segmentation,
    areas_px2: &mut Vec<u32>,
    rung: &mut dyn CentreRung,
    out: &mut Markers,
) -> Result<(), DetectError> {
    segmentation.run(image)?;
    let size_px = (image.width(), image.height());
    let max_markers = max_markers(params, size_px);
    let (filter, found) =
        BlobFilter::of(segmentation.components.blobs(), params, size_px, outline, areas_px2);
    if found > max_markers {
        return Err(DetectError::TooMany { found, max: max_markers });
    }
    rung.centre_components(&mut Components { image, segmentation, filter: &filter, max_markers }, out);
    let variance_px2 = params.centre_sigma_px * params.centre_sigma_px;
    let blobs = segmentation.components.blobs().iter();
    out.cut.extend(blobs.filter_map(|blob| filter.cut_marker(blob, variance_px2)));
    Ok(())
}
