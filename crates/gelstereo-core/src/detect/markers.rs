//! Markers found in an image, and those cut by its border.

use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::DetectParams;
use crate::spatial::rows::{MIN_SHARE, share_in_rows};
use alloc::vec;
use alloc::vec::Vec;

/// Largest number of markers of an image, cut ones included: slightly more than 90 x 90.
pub const MAX_MARKERS: usize = 8192;

/// Image pixels per allowed marker.
pub const PIXELS_PER_MARKER: usize = 50;

/// Markers whose neighbours are examined by `Markers::share_in_rows`. It bounds the work.
const MAX_SAMPLED: usize = 256;

/// Markers found in one image, in raster order of their first pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Markers {
    /// Centres, pixels.
    pub centres_px: Vec<DVec2>,
    /// Covariances of the centres, px².
    pub covariance_px2: Vec<Symmetric<2>>,
    /// Areas, square pixels.
    pub area_px2: Vec<u32>,
    /// Number of markers for which the model fit did not converge, so that they kept the
    /// intensity-weighted centroid; 0 for other rungs.
    pub unfitted: usize,
    /// Markers partly cut off by the image's border; they are in none of the lists above.
    pub cut: Vec<CutMarker>,
}

/// Marker that reaches the outermost pixels of the image: accurate enough for labelling, not for a 3D point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutMarker {
    /// Mean position of its visible pixels, pixels; the centre lies farther out.
    pub centre_px: DVec2,
    /// Covariance about the whole marker's centre, px². Across each border reached, the
    /// variance grows by the square of the radius times the missing share of the area.
    pub covariance_px2: Symmetric<2>,
    /// Visible area, square pixels.
    pub area_px2: u32,
}

impl Markers {
    /// Markers at known positions, with one standard deviation for all axes.
    #[must_use]
    pub fn at(centres_px: Vec<DVec2>, sigma_px: f64) -> Self {
        let variance = sigma_px * sigma_px;
        let (covariance_px2, area_px2) =
            (vec![[[variance, 0.0], [0.0, variance]]; centres_px.len()], vec![1; centres_px.len()]);
        Self { centres_px, covariance_px2, area_px2, cut: Vec::new(), unfitted: 0 }
    }

    /// Share of the markers with two opposite neighbours at equal distance, as in the rows of a print; `None`
    /// for fewer than nine markers.
    ///
    /// It is above 0.8 for most prints, and below 0.2 for clutter, noise and prints of random dots.
    #[must_use]
    pub fn share_in_rows(&self) -> Option<f64> {
        share_in_rows(&|| self.centres_px.iter().copied(), MAX_SAMPLED)
    }

    /// Whether the markers look like a printed lattice; `None` for fewer than nine.
    #[must_use]
    pub fn is_in_rows(&self) -> Option<bool> {
        self.share_in_rows().map(|share| share >= MIN_SHARE)
    }

    pub(super) fn clear(&mut self) {
        self.centres_px.clear();
        self.covariance_px2.clear();
        self.area_px2.clear();
        self.cut.clear();
        self.unfitted = 0;
    }

    pub(super) fn shift(&mut self, by_px: DVec2) {
        if by_px != DVec2::ZERO {
            self.centres_px.iter_mut().for_each(|centre| *centre += by_px);
            self.cut.iter_mut().for_each(|cut| cut.centre_px += by_px);
        }
    }

    pub(super) fn reserve(&mut self, markers: usize, cut: usize) {
        self.centres_px.reserve(markers);
        self.covariance_px2.reserve(markers);
        self.area_px2.reserve(markers);
        self.cut.reserve(cut);
    }

    /// Appends a marker with one variance for both coordinates.
    pub(super) fn push(&mut self, centre_px: DVec2, variance_px2: f64, area_px2: u32) {
        self.centres_px.push(centre_px);
        self.covariance_px2.push([[variance_px2, 0.0], [0.0, variance_px2]]);
        self.area_px2.push(area_px2);
    }
}

/// Largest allowed number of markers of an image of this size (width, height); more are an error.
///
/// Dots can be separated from a pitch of about 6 px on, and a square lattice covers at most three
/// quarters of the image: one marker per [`PIXELS_PER_MARKER`].
#[must_use]
pub fn max_markers(params: &DetectParams, size_px: (usize, usize)) -> usize {
    let pixels = size_px.0 * size_px.1;
    (pixels / params.areas_px2()[0].max(4) as usize)
        .min((pixels / PIXELS_PER_MARKER).max(1024))
        .min(MAX_MARKERS)
}
