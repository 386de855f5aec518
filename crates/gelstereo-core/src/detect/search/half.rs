//! Markers detected at half resolution if that is unambiguous, and centred at full resolution.
//!
//! The mean of 2 x 2 pixels halves the noise, as smoothing would, and leaves a quarter of the pixels. It
//! hides only gaps of two pixels and structures within two pixels of the border. Half resolution is used
//! only if every component is a marker to [`SizedClassifier::single`] or a speck, and if thresholds are
//! shares of the markers' contrast, the same at both resolutions. Otherwise the image is searched at full
//! resolution from scratch.

use crate::detect::centre::noise::MarkerPixels;
use crate::detect::centre::soft_threshold::SoftThreshold;
use crate::detect::markers::Markers;
use crate::detect::mask::blob_filter::BlobFilter;
use crate::detect::mask::components::Blob;
use crate::detect::mask::segmentation::Segmentation;
use crate::detect::mask::usual_area::area_range_px2;
use crate::detect::outline::NO_OUTLINE;
use crate::detect::window::size::MarkerSize;
use crate::detect::window::sized::SizedClassifier;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::{Centre, DetectParams, FindAt};
use alloc::vec::Vec;

/// Image pixels per half-resolution pixel, in each direction.
pub(in crate::detect) const SCALE: usize = 2;

const PIXELS: u32 = (SCALE * SCALE) as u32;

/// Least usual area, half-resolution pixels. A disc of this area covers 4 to 7 of them at any position, so
/// it is mistaken neither for a speck nor for two markers.
const MIN_PX2: f64 = 6.0;

/// Ratio of the image's size to that of its central part, in each direction.
const MIDDLE: usize = 8;

/// Range of marker areas as shares of the usual one: that of the blob filter, with a margin since areas are
/// known to one half-resolution pixel.
const MARKER: core::ops::RangeInclusive<f64> = 2.0 / 3.0..=1.5;

/// Half-resolution image and its components.
#[derive(Clone, Debug)]
struct Halved {
    levels: Vec<u8>,
    segmentation: Segmentation,
}

impl Halved {
    fn new(params: &DetectParams) -> Self {
        Self { levels: Vec::new(), segmentation: Segmentation::new(params) }
    }

    /// Blob filter of the markers; `None` if there are too many components.
    fn search(
        &mut self,
        image: GrayView<'_>,
        params: &DetectParams,
        areas_px2: &mut Vec<u32>,
    ) -> Option<BlobFilter<'static>> {
        let size_px = (image.width() / SCALE, image.height() / SCALE);
        halve(image, &mut self.levels);
        let half = GrayView::new(&self.levels, size_px.0, size_px.1, size_px.0).ok()?;
        self.segmentation.run(half).ok()?;
        Some(BlobFilter::of(self.segmentation.components.blobs(), params, size_px, &NO_OUTLINE, areas_px2).0)
    }

    /// Whether all selected components are specks, or markers that lie entirely in the image.
    fn is_clear(
        &self,
        filter: &BlobFilter<'_>,
        params: &DetectParams,
        counts: impl Fn(&Blob) -> bool,
    ) -> bool {
        // Areas of the smallest marker, and of the largest component that is not a marker.
        let (mut min_px2, mut largest_px2) = (u32::MAX, None);
        for blob in self.segmentation.components.blobs().iter().filter(|blob| counts(blob)) {
            let share = f64::from(blob.area_px2) / filter.usual_px2;
            if MARKER.contains(&share) && filter.passes_whole(blob) {
                min_px2 = min_px2.min(blob.area_px2);
            } else {
                largest_px2 = largest_px2.max(Some(blob.area_px2));
            }
        }
        // A speck must be too small at any resolution, even if the smallest marker were the usual one.
        // The margin covers a disc's pixel count: one less for a marker, two more for a speck.
        let min_px2 = if min_px2 == u32::MAX { 0 } else { min_px2 };
        let (speck_px2, _) = area_range_px2(params.threshold, f64::from(min_px2.saturating_sub(1)));
        filter.usual_px2 >= MIN_PX2
            && !self.segmentation.feel_noise()
            && largest_px2.is_none_or(|area_px2| area_px2 + 2 < speck_px2)
    }
}

/// The half-resolution search.
#[derive(Clone, Debug)]
pub(in crate::detect) struct HalfSize {
    /// Settings scaled to half resolution.
    params: DetectParams,
    whole: Halved,
    middle: Halved,
    /// Whether the last image was searched at half resolution only.
    is_complete: bool,
}

impl HalfSize {
    /// `None` if the settings require full resolution. Only the soft-threshold centroid
    /// ([`Centre::SoftThreshold`]) is independent of a component's outline.
    pub fn new(params: &DetectParams) -> Option<Self> {
        let wanted = params.find_at == FindAt::HalfSize && params.centre == Centre::SoftThreshold;
        let [min_area_px2, max_area_px2] = params.areas_px2();
        let half_kernel = |side_px: usize| (side_px / SCALE) | 1;
        let params = DetectParams {
            smooth_kernel_px: half_kernel(params.smooth_kernel_px),
            background_kernel_px: half_kernel(params.background_kernel_px),
            morphology_kernel_px: half_kernel(params.morphology_kernel_px),
            min_area_px2: min_area_px2.div_ceil(PIXELS),
            max_area_px2: (max_area_px2 / PIXELS).max(1),
            dot_px: None,
            ..params.clone()
        };
        let [whole, middle] = [Halved::new(&params), Halved::new(&params)];
        wanted.then_some(Self { params, whole, middle, is_complete: false })
    }

    /// Segmentation of the last image, if half resolution was sufficient.
    pub fn complete(&self) -> Option<&Segmentation> {
        self.is_complete.then_some(&self.whole.segmentation)
    }

    /// Reserves memory for images of this size.
    pub fn reserve(&mut self, image: GrayView<'_>, areas_px2: &mut Vec<u32>) {
        // Too many components is reported by the search itself.
        let _ = self.whole.search(image, &self.params, areas_px2);
        let _ = self.is_unclear_amid(image, areas_px2);
    }

    /// Whether the image's central part is ambiguous: a cheap check that avoids a futile search of the whole.
    /// It depends on no earlier image, since centres found at the two resolutions differ in their last bits.
    fn is_unclear_amid(&mut self, image: GrayView<'_>, areas_px2: &mut Vec<u32>) -> bool {
        let (width, height) = (image.width() / MIDDLE, image.height() / MIDDLE);
        let middle = image.crop((image.width() - width) / 2, (image.height() - height) / 2, width, height);
        let filter = middle.ok().and_then(|middle| self.middle.search(middle, &self.params, areas_px2));
        let Some(filter) = filter else { return false };
        let (components, is_whole) =
            (&self.middle.segmentation.components, |blob: &Blob| !filter.is_cut(blob));
        let goes_through = |blob: &Blob| {
            let (across, down) = blob.size();
            across as usize == width / SCALE || down as usize == height / SCALE
        };
        if components.blobs().iter().any(is_whole) {
            !self.middle.is_clear(&filter, &self.params, is_whole)
        } else {
            // Specks only, or connected markers.
            components.count() > components.blobs().len() || components.blobs().iter().any(goes_through)
        }
    }

    /// Finds the markers at half resolution if that is sufficient; otherwise `out` stays empty. `out` has
    /// room for `max_markers`.
    pub fn run(
        &mut self,
        image: GrayView<'_>,
        rung: &mut SoftThreshold,
        areas_px2: &mut Vec<u32>,
        max_markers: usize,
        out: &mut Markers,
    ) -> bool {
        rung.start(image, max_markers);
        let size = self.take_clear(image, rung, areas_px2, out);
        self.is_complete = size.is_some();
        match size {
            Some(size) => {
                let components = &self.whole.segmentation.components;
                rung.state_variances(
                    image,
                    &size,
                    MarkerPixels::Components { components, scale: SCALE },
                    out,
                );
            }
            None => out.clear(),
        }
        self.is_complete
    }

    /// Appends markers of one size, if all components are specks or whole markers that pass the window
    /// classifier.
    fn take_clear(
        &mut self,
        image: GrayView<'_>,
        rung: &mut SoftThreshold,
        areas_px2: &mut Vec<u32>,
        out: &mut Markers,
    ) -> Option<MarkerSize> {
        if self.is_unclear_amid(image, areas_px2) {
            return None;
        }
        let Self { whole, params, .. } = self;
        let filter = whole.search(image, params, areas_px2)?;
        if !whole.is_clear(&filter, params, |_| true) {
            return None;
        }
        let blobs = || whole.segmentation.components.blobs().iter().filter(|blob| filter.passes_whole(blob));
        // Mean area: a single area at half resolution is known to a few pixels.
        let (count, sum) = blobs().fold((0_u32, 0), |(n, sum), blob| (n + 1, sum + PIXELS * blob.area_px2));
        let size = MarkerSize::of(f64::from(sum) / f64::from(count))?;
        let classifier = SizedClassifier::new(size, params.polarity);
        for blob in blobs() {
            rung.push(&classifier.single(image, full_size(blob.mean_px()))?, out);
        }
        Some(size)
    }
}

/// Converts a half-resolution position to full resolution; the first half-resolution pixel covers columns
/// and rows 0 and 1.
fn full_size(half_px: DVec2) -> DVec2 {
    SCALE as f64 * half_px + 0.5
}

/// Means of 2 x 2 pixels, rounded; an odd last column or row is left out.
fn halve(image: GrayView<'_>, out: &mut Vec<u8>) {
    let (width, height) = (image.width() / SCALE, image.height() / SCALE);
    out.resize(width * height, 0);
    for (y, out) in (0..).step_by(SCALE).zip(out.chunks_exact_mut(width.max(1))) {
        halve_rows(image.row(y).as_chunks().0, image.row(y + 1).as_chunks().0, out);
    }
}

/// Averages two rows. Pairs of levels are read as 16-bit numbers: there are instructions for eight of them.
#[inline(never)]
fn halve_rows(above: &[[u8; SCALE]], below: &[[u8; SCALE]], out: &mut [u8]) {
    let sum = |&pair: &[u8; SCALE]| {
        let both = u16::from_le_bytes(pair);
        (both & 0xff) + (both >> 8)
    };
    for ((out, above), below) in out.iter_mut().zip(above).zip(below) {
        *out = ((sum(above) + sum(below) + 2) >> 2) as u8;
    }
}
