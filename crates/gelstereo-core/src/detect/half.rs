//! Markers found in the image at half its size, where that shows them all clearly, and centred at its own size.
//!
//! The mean of 2 x 2 pixels halves the noise, as smoothing would, and leaves a quarter of the pixels to look at. What it hides
//! is small: gaps of two pixels, and what stands within two pixels of the border. The image is searched at its own size, as if it had
//! not been looked at, unless each component is a marker to [`Eyes::single`], or a speck, and thresholds are shares of the
//! markers' contrast, the same at both sizes.

use super::centre;
use super::components::Blob;
use super::glance::{Eyes, Kind};
use super::segments::Segments;
use super::sieve::{Sieve, area_range_px2};
use super::{Detector, Markers};
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::{Centre, DetectParams, FindAt};
use alloc::vec::Vec;

/// Pixels of the image to one of half its size, in each direction.
pub(super) const SCALE: usize = 2;

const PIXELS: u32 = (SCALE * SCALE) as u32;

/// Least usual area, pixels of half the size: a disc of so many covers 4 to 7 of them wherever it lies, neither a speck beside
/// the others nor two of them.
const LEAST_PX2: f64 = 6.0;

/// The image's middle is so many times smaller in each direction.
const MIDDLE: usize = 8;

/// Shares of the usual area between which a component is a marker: those of the sieve with room for areas that are known to a
/// pixel of half the size.
const MARKER: core::ops::RangeInclusive<f64> = 2.0 / 3.0..=1.5;

/// An image at half its size, and its components.
#[derive(Clone, Debug)]
struct Halved {
    levels: Vec<u8>,
    segments: Segments,
}

impl Halved {
    fn new(params: &DetectParams) -> Self {
        Self { levels: Vec::new(), segments: Segments::new(params) }
    }

    /// What the markers are like; `None` when there are too many components.
    fn search(
        &mut self,
        image: GrayView<'_>,
        params: &DetectParams,
        areas_px2: &mut Vec<u32>,
    ) -> Option<Sieve> {
        let size_px = (image.width() / SCALE, image.height() / SCALE);
        halve(image, &mut self.levels);
        let half = GrayView::new(&self.levels, size_px.0, size_px.1, size_px.0).ok()?;
        self.segments.run(half).ok()?;
        Some(Sieve::of(self.segments.components.blobs(), params, size_px, areas_px2).0)
    }

    /// Whether all of some components are markers that lie whole in the image, or specks.
    fn is_clear(&self, sieve: &Sieve, params: &DetectParams, counts: impl Fn(&Blob) -> bool) -> bool {
        // Areas of the least marker, and of the largest component that is none.
        let (mut least_px2, mut largest_px2) = (u32::MAX, None);
        for blob in self.segments.components.blobs().iter().filter(|blob| counts(blob)) {
            let share = f64::from(blob.area_px2) / sieve.usual_px2;
            if MARKER.contains(&share) && sieve.passes_whole(blob) {
                least_px2 = least_px2.min(blob.area_px2);
            } else {
                largest_px2 = largest_px2.max(Some(blob.area_px2));
            }
        }
        // A speck at any size: too small beside the least marker, which may be the usual one there. There is room for what a disc
        // covers: a pixel less where it is a marker, two more where it is a speck.
        let least_px2 = if least_px2 == u32::MAX { 0 } else { least_px2 };
        let (speck_px2, _) = area_range_px2(params.threshold, f64::from(least_px2.saturating_sub(1)));
        sieve.usual_px2 >= LEAST_PX2
            && !self.segments.feel_noise()
            && largest_px2.is_none_or(|area_px2| area_px2 + 2 < speck_px2)
    }
}

/// The search at half size.
#[derive(Clone, Debug)]
pub(super) struct HalfSize {
    /// As for images of that size.
    params: DetectParams,
    whole: Halved,
    middle: Halved,
    /// Whether it showed all that there is in the last image.
    pub is_complete: bool,
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

    /// What the image fell into.
    pub const fn segments(&self) -> &Segments {
        &self.whole.segments
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
        let sieve = middle.ok().and_then(|middle| self.middle.search(middle, &self.params, areas_px2));
        let Some(sieve) = sieve else { return false };
        let (components, is_whole) = (&self.middle.segments.components, |blob: &Blob| !sieve.is_cut(blob));
        let goes_through = |blob: &Blob| {
            let (across, down) = blob.size();
            across as usize == width / SCALE || down as usize == height / SCALE
        };
        if components.blobs().iter().any(is_whole) {
            !self.middle.is_clear(&sieve, &self.params, is_whole)
        } else {
            // Specks only, or markers that hang together.
            components.pieces() > components.blobs().len() || components.blobs().iter().any(goes_through)
        }
    }

    /// What markers are like at half size, if all components are markers that lie whole in the image, or specks.
    fn run(&mut self, image: GrayView<'_>, areas_px2: &mut Vec<u32>) -> Option<Sieve> {
        if self.is_unclear_amid(image, areas_px2) {
            return None;
        }
        let sieve = self.whole.search(image, &self.params, areas_px2)?;
        self.whole.is_clear(&sieve, &self.params, |_| true).then_some(sieve)
    }
}

impl Detector {
    /// Finds the markers at half the image's size, if that shows all that there is; else `out` stays empty. It has room for all.
    pub(super) fn run_half(&mut self, image: GrayView<'_>, out: &mut Markers) -> bool {
        let kind = self.take_clear(image, out);
        let Some(half) = &mut self.half else { return false };
        half.is_complete = kind.is_some();
        match kind {
            Some(kind) => self.tell_band_noise(image, &kind, out),
            None => out.clear(),
        }
        kind.is_some()
    }

    /// Markers of one kind, all of them seen at a glance.
    fn take_clear(&mut self, image: GrayView<'_>, out: &mut Markers) -> Option<Kind> {
        let (flip, variance) = (self.flip(), self.typed_variance_px2());
        let Self { half: Some(half), areas_px2, bands, .. } = self else { return None };
        let sieve = half.run(image, areas_px2)?;
        let whole = || half.segments().components.blobs().iter().filter(|blob| sieve.passes_whole(blob));
        // Their mean: a single area at half size is known to a few pixels.
        let (count, sum) = whole().fold((0_u32, 0), |(n, sum), blob| (n + 1, sum + PIXELS * blob.area_px2));
        let kind = Kind::of(f64::from(sum) / f64::from(count))?;
        let eyes = Eyes::new(kind, flip);
        for blob in whole() {
            let spot = eyes.single(image, full_size(centre::binary(blob)))?;
            bands.push(spot.band);
            out.push(spot.centre_px, [[variance, 0.0], [0.0, variance]], spot.area_px2);
        }
        Some(kind)
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
