//! Markers found in the image at half its size, where that shows them all clearly, and centred at its own size.
//!
//! The mean of 2 x 2 pixels halves the noise, as smoothing would, and leaves a quarter of the pixels to look at. What it hides
//! is small: gaps of two pixels, and what stands within two pixels of the border. The image is searched at its own size, as if it had
//! not been looked at, unless each component is a marker to [`SizedClassifier::single`], or a speck, and thresholds are shares of the
//! markers' contrast, the same at both sizes.

use crate::detect::centre::soft_threshold::SoftThreshold;
use crate::detect::markers::Markers;
use crate::detect::mask::blob_filter::{BlobFilter, area_range_px2};
use crate::detect::mask::components::Blob;
use crate::detect::mask::segmentation::Segmentation;
use crate::detect::window::size::MarkerSize;
use crate::detect::window::sized::SizedClassifier;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::{Centre, DetectParams, FindAt};
use alloc::vec::Vec;

/// Pixels of the image to one of half its size, in each direction.
pub(in crate::detect) const SCALE: usize = 2;

const PIXELS: u32 = (SCALE * SCALE) as u32;

/// Least usual area, pixels of half the size: a disc of so many covers 4 to 7 of them wherever it lies, neither a speck beside
/// the others nor two of them.
const MIN_PX2: f64 = 6.0;

/// The image's middle is so many times smaller in each direction.
const MIDDLE: usize = 8;

/// Shares of the usual area between which a component is a marker: those of the filter with room for areas that are known to a
/// pixel of half the size.
const MARKER: core::ops::RangeInclusive<f64> = 2.0 / 3.0..=1.5;

/// An image at half its size, and its components.
#[derive(Clone, Debug)]
struct Halved {
    levels: Vec<u8>,
    segmentation: Segmentation,
}

impl Halved {
    fn new(params: &DetectParams) -> Self {
        Self { levels: Vec::new(), segmentation: Segmentation::new(params) }
    }

    /// What the markers are like; `None` when there are too many components.
    fn search(
        &mut self,
        image: GrayView<'_>,
        params: &DetectParams,
        areas_px2: &mut Vec<u32>,
    ) -> Option<BlobFilter> {
        let size_px = (image.width() / SCALE, image.height() / SCALE);
        halve(image, &mut self.levels);
        let half = GrayView::new(&self.levels, size_px.0, size_px.1, size_px.0).ok()?;
        self.segmentation.run(half).ok()?;
        Some(BlobFilter::of(self.segmentation.components.blobs(), params, size_px, areas_px2).0)
    }

    /// Whether all of some components are markers that lie whole in the image, or specks.
    fn is_clear(&self, filter: &BlobFilter, params: &DetectParams, counts: impl Fn(&Blob) -> bool) -> bool {
        // Areas of the least marker, and of the largest component that is none.
        let (mut least_px2, mut largest_px2) = (u32::MAX, None);
        for blob in self.segmentation.components.blobs().iter().filter(|blob| counts(blob)) {
            let share = f64::from(blob.area_px2) / filter.usual_px2;
            if MARKER.contains(&share) && filter.passes_whole(blob) {
                least_px2 = least_px2.min(blob.area_px2);
            } else {
                largest_px2 = largest_px2.max(Some(blob.area_px2));
            }
        }
        // A speck at any size: too small beside the least marker, which may be the usual one there. There is room for what a disc
        // covers: a pixel less where it is a marker, two more where it is a speck.
        let least_px2 = if least_px2 == u32::MAX { 0 } else { least_px2 };
        let (speck_px2, _) = area_range_px2(params.threshold, f64::from(least_px2.saturating_sub(1)));
        filter.usual_px2 >= MIN_PX2
            && !self.segmentation.feel_noise()
            && largest_px2.is_none_or(|area_px2| area_px2 + 2 < speck_px2)
    }
}

/// The search at half size.
#[derive(Clone, Debug)]
pub(in crate::detect) struct HalfSize {
    /// As for images of that size.
    params: DetectParams,
    whole: Halved,
    middle: Halved,
    /// Whether it showed all that there is in the last image.
    is_complete: bool,
}

impl HalfSize {
    /// `None` for settings that want every image searched at its own size: only the band's centres owe nothing to the outline
    /// of a component.
    pub fn new(params: &DetectParams) -> Option<Self> {
        let wanted = params.find_at == FindAt::HalfSize && params.centre == Centre::Band;
        let half_kernel = |side_px: usize| (side_px / SCALE) | 1;
        let params = DetectParams {
            smooth_kernel_px: half_kernel(params.smooth_kernel_px),
            background_kernel_px: half_kernel(params.background_kernel_px),
            morphology_kernel_px: half_kernel(params.morphology_kernel_px),
            min_area_px2: params.min_area_px2.div_ceil(PIXELS),
            max_area_px2: (params.max_area_px2 / PIXELS).max(1),
            ..params.clone()
        };
        let [whole, middle] = [Halved::new(&params), Halved::new(&params)];
        wanted.then_some(Self { params, whole, middle, is_complete: false })
    }

    /// What the last image fell into, where that showed all that there was.
    pub fn complete(&self) -> Option<&Segmentation> {
        self.is_complete.then_some(&self.whole.segmentation)
    }

    /// Makes room for images like this one, whether they are clear or not.
    pub fn reserve(&mut self, image: GrayView<'_>, areas_px2: &mut Vec<u32>) {
        // Whether it has too many components its search will tell.
        let _ = self.whole.search(image, &self.params, areas_px2);
        let _ = self.is_unclear_amid(image, areas_px2);
    }

    /// Whether the middle of the image shows something unclear: that costs little to see, and the search of the whole in vain
    /// much. Nothing is remembered of the image before: centres found at one size and the other differ in their last bits,
    /// which must not depend on what was seen earlier.
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
            // Specks only, or markers that hang together.
            components.pieces() > components.blobs().len() || components.blobs().iter().any(goes_through)
        }
    }

    /// Finds the markers at half the image's size, if that shows all that there is; else `out` stays empty. It has room for
    /// so many.
    pub fn run(
        &mut self,
        image: GrayView<'_>,
        rung: &mut SoftThreshold,
        areas_px2: &mut Vec<u32>,
        (max_markers, out): (usize, &mut Markers),
    ) -> bool {
        rung.start(image, max_markers);
        let size = self.take_clear(image, rung, areas_px2, out);
        self.is_complete = size.is_some();
        match size {
            Some(size) => {
                rung.state_variances(image, &size, (&self.whole.segmentation.components, SCALE), out);
            }
            None => out.clear(),
        }
        self.is_complete
    }

    /// Lists markers of one size, if all components are markers that lie whole in the image and show at a glance, or
    /// specks.
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
        // Their mean: a single area at half size is known to a few pixels.
        let (count, sum) = blobs().fold((0_u32, 0), |(n, sum), blob| (n + 1, sum + PIXELS * blob.area_px2));
        let size = MarkerSize::of(f64::from(sum) / f64::from(count))?;
        let classifier = SizedClassifier::new(size, params.polarity);
        for blob in blobs() {
            rung.push(&classifier.single(image, full_size(blob.mean_px()))?, out);
        }
        Some(size)
    }
}

/// The place in the image of one at half its size, whose first pixel covers the columns and rows 0 and 1.
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

/// Of two rows. Pairs of levels as numbers of 16 bits: there are instructions for eight of them.
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
