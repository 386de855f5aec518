//! Blob filter: which components are markers, by area relative to the others and by shape.

use super::components::Blob;
use super::usual_area::{area_range_px2, regular_area_px2, usual_area_px2};
use crate::detect::markers::CutMarker;
use crate::detect::outline::Outline;
use crate::params::{DetectParams, Threshold};
use alloc::vec::Vec;

/// Relative spread of marker areas: a cut marker of the usual visible area may still lack this share.
pub(in crate::detect) const AREA_SPREAD: f64 = 0.2;

/// Area and shape limits of the markers of one image.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) struct BlobFilter<'a> {
    size_px: (usize, usize),
    outline: &'a Outline,
    min_area_px2: u32,
    max_area_px2: u32,
    min_fill: f64,
    /// Usual marker area; 0 if no marker lies entirely in the image.
    pub usual_px2: f64,
    /// Least and largest marker area, relative to the usual area.
    pub range_px2: (u32, u32),
}

impl<'a> BlobFilter<'a> {
    /// Builds the filter from the components of an image of this size, and counts those that are markers
    /// by their own area and shape. `areas_px2` is scratch.
    pub fn of(
        blobs: &[Blob],
        params: &DetectParams,
        size_px: (usize, usize),
        outline: &'a Outline,
        areas_px2: &mut Vec<u32>,
    ) -> (Self, usize) {
        let ([min_area_px2, max_area_px2], min_fill) = (params.areas_px2(), params.min_fill);
        let range_px2 = (0, u32::MAX);
        let mut sieve =
            Self { size_px, outline, min_area_px2, max_area_px2, min_fill, usual_px2: 0.0, range_px2 };
        let mut found = 0;
        areas_px2.clear();
        for blob in blobs.iter().filter(|blob| sieve.is_marker(blob)) {
            found += 1;
            if !sieve.is_cut(blob) {
                areas_px2.push(blob.area_px2);
            }
        }
        sieve.usual_px2 = usual_area_px2(areas_px2);
        sieve.range_px2 = area_range_px2(params.threshold, sieve.usual_px2);
        // Large objects behind a clear gel may have more pixels than all markers together.
        let usual =
            areas_px2.iter().filter(|area| sieve.range_px2.0 <= **area && **area <= sieve.range_px2.1);
        if params.threshold == Threshold::Auto && 2 * usual.count() < areas_px2.len() {
            let whole = |blob: &&Blob| sieve.is_marker(blob) && !sieve.is_cut(blob);
            if let Some(area_px2) = regular_area_px2(&|| blobs.iter().filter(whole), areas_px2) {
                sieve.usual_px2 = area_px2;
                sieve.range_px2 = area_range_px2(params.threshold, area_px2);
            }
        }
        (sieve, found)
    }

    /// Whether a component is a marker that lies entirely in the image.
    pub fn passes_whole(&self, blob: &Blob) -> bool {
        self.is_marker(blob) && !self.is_cut(blob) && self.in_range(blob)
    }

    /// The cut marker of which a component is the visible part, or `None`; `variance` is that of one
    /// coordinate of a whole marker, px².
    pub fn cut_marker(&self, blob: &Blob, variance: f64) -> Option<CutMarker> {
        let is_one = self.is_marker(blob)
            && self.is_cut(blob)
            && self.in_range(blob)
            && is_as_long_as_a_marker(blob, self.usual_px2);
        is_one.then(|| cut_marker(blob, blob.sides_reached(self.size_px), self.usual_px2, variance))
    }

    /// Whether a component has a plausible area, is round enough and lies within the outline.
    fn is_marker(&self, blob: &Blob) -> bool {
        (self.min_area_px2..=self.max_area_px2).contains(&blob.area_px2)
            && in_shape(blob, self.min_fill)
            && self.outline.contains(blob.mean_px())
    }

    /// Whether a component reaches the outermost pixels of the image.
    pub fn is_cut(&self, blob: &Blob) -> bool {
        blob.sides_reached(self.size_px) != (false, false)
    }

    fn in_range(&self, blob: &Blob) -> bool {
        (self.range_px2.0..=self.range_px2.1).contains(&blob.area_px2)
    }
}

/// Whether a component fills enough of its bounding ellipse.
pub(in crate::detect) fn in_shape(blob: &Blob, min_fill: f64) -> bool {
    let (width, height) = blob.size();
    let ellipse_area = core::f64::consts::FRAC_PI_4 * f64::from(width) * f64::from(height);
    f64::from(blob.area_px2) >= min_fill * ellipse_area
}

/// Whether a component at the border may be part of a marker and not a strip along the border. Always
/// false without whole markers to compare with.
fn is_as_long_as_a_marker(blob: &Blob, usual_px2: f64) -> bool {
    let (width, height) = blob.size();
    let side = f64::from(width.max(height));
    // Twice the diameter, since markers need not be round.
    side * side <= 4.0 * 4.0 * core::f64::consts::FRAC_1_PI * usual_px2
}

/// Cut marker of a component that reaches the image's borders across (x, y).
fn cut_marker(blob: &Blob, reached: (bool, bool), usual_px2: f64, variance: f64) -> CutMarker {
    let area = f64::from(blob.area_px2);
    let full = (1.0 + AREA_SPREAD) * usual_px2.max(area);
    // If the border cuts straight, the visible centroid is off by less than the radius times the hidden
    // share.
    let hidden_px = crate::math::sqrt(full * core::f64::consts::FRAC_1_PI) * (1.0 - area / full);
    let of = |reached: bool| variance + if reached { hidden_px * hidden_px } else { 0.0 };
    CutMarker {
        centre_px: blob.mean_px(),
        covariance_px2: [[of(reached.0), 0.0], [0.0, of(reached.1)]],
        area_px2: blob.area_px2,
    }
}
