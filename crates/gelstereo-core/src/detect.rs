//! Finding markers in one image.

use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::DetectParams;
use alloc::vec::Vec;

/// Markers found in one image, in the raster order of their first pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Markers {
    /// Centres, pixels.
    pub centres_px: Vec<DVec2>,
    /// Areas, square pixels.
    pub area_px2: Vec<u32>,
}

/// Why an image has no markers to offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectError {
    /// Smaller than the smallest marker's surround.
    TooSmall { width: usize, height: usize, least: usize },
    /// No contrast.
    Flat { low: u8, high: u8, threshold_levels: u8 },
    // room owner: extend as needed
}

impl core::fmt::Display for DetectError {
    fn fmt(&self, _f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        unimplemented!()
    }
}

impl core::error::Error for DetectError {}

/// The detection stage and its scratch.
#[derive(Clone, Debug)]
pub struct Detector {
    params: DetectParams,
}

impl Detector {
    /// With these settings (already validated by `Params::validate`).
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self { params: params.clone() }
    }

    /// Finds the markers; `out` is cleared first. No allocation after the first image of a size.
    ///
    /// # Errors
    /// [`DetectError`].
    pub fn run(&mut self, image: GrayView<'_>, out: &mut Markers) -> Result<(), DetectError> {
        let _ = (&self.params, image, out);
        unimplemented!()
    }
}
