//! Finding markers in one image (section III-A): what differs from its surround by enough, in one piece, of a
//! plausible size, with its centre.

mod band;
pub mod blocks;
pub mod blur;
pub mod centre;
pub mod components;
mod covered;
mod difference;
mod error;
pub mod fit;
pub mod glance;
mod half;
mod markers;
pub mod matched;
pub mod morphology;
pub mod near;
pub mod noise;
pub mod pieces;
pub mod region;
pub mod row_bits;
mod sampling;
mod segments;
mod sieve;
pub mod smooth;
pub mod threshold;
mod walls;
mod whole;
pub mod window;
mod windows;

pub use error::DetectError;
pub use markers::{CutMarker, Markers};

use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::{Centre, DetectParams, FindAt, Threshold};
use alloc::vec::Vec;
use band::BandNoise;
use centre::GreyCentre;
use covered::Glares;
use fit::{DiscFit, NoiseMeter};
use half::HalfSize;
use matched::Matched;
use near::Search;
use segments::Segments;
use windows::Glances;

/// Most markers of an image, those that the border cuts included: 90 x 90 and a few.
pub const MOST_MARKERS: usize = 8192;

/// Pixels of an image for each of the markers that it may have.
pub const PIXELS_PER_MARKER: usize = 50;

/// The detection stage and its scratch.
#[derive(Clone, Debug)]
pub struct Detector {
    params: DetectParams,
    segments: Segments,
    half: Option<HalfSize>,
    grey_centre: GreyCentre,
    disc_fit: Option<DiscFit>,
    matched: Matched,
    band_noise: Option<BandNoise>,
    /// Of each marker that was seen at a glance, [`Spot::band`](glance::Spot::band); else 0.
    bands: Vec<u8>,
    meter: NoiseMeter,
    /// Region of interest: first column and row, width and height; of the whole image where there is none.
    roi_px: Option<[usize; 4]>,
    /// Of the part that is searched.
    size_px: (usize, usize),
    whole_px: (usize, usize),
    areas_px2: Vec<u32>,
    glares: Glares,
    near: Search,
    glances: Glances,
}

impl Detector {
    /// With these settings (already validated by `Params::validate`).
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            segments: Segments::new(params),
            half: HalfSize::new(params),
            grey_centre: GreyCentre::default(),
            disc_fit: (params.centre == Centre::Fit).then(|| DiscFit::new(params)),
            matched: Matched::new(params),
            band_noise: (params.centre == Centre::Band).then(BandNoise::new),
            bands: Vec::new(),
            meter: NoiseMeter::default(),
            roi_px: None,
            size_px: (0, 0),
            whole_px: (0, 0),
            areas_px2: Vec::new(),
            glares: Glares::default(),
            near: Search::default(),
            glances: Glances::default(),
        }
    }

    /// Searches this part of images alone: first column and row, width and height, pixels. All positions stay those of the whole
    /// image. What the part's border cuts is listed in [`Markers::cut`].
    #[must_use]
    pub fn within(self, roi_px: Option<[usize; 4]>) -> Self {
        Self { roi_px, ..self }
    }

    /// The part that is searched, and where it begins.
    fn part<'a>(&mut self, image: GrayView<'a>) -> Result<(GrayView<'a>, DVec2), DetectError> {
        self.whole_px = (image.width(), image.height());
        let Some(roi_px) = self.roi_px else { return Ok((image, DVec2::ZERO)) };
        let [x, y, columns, rows] = roi_px;
        let part = match DetectError::beyond(roi_px, self.whole_px) {
            None => image.crop(x, y, columns, rows).ok(),
            Some(_) => None,
        };
        let (width, height) = self.whole_px;
        let part = part.ok_or(DetectError::Region { roi_px, width, height })?;
        Ok((part, DVec2::new(x as f64, y as f64)))
    }

    /// Forgets what was learned of earlier images (the weights of [`Centre::Matched`], the noise of [`Centre::Band`]), so that the next one has the same
    /// bits as a first one.
    pub fn reset(&mut self) {
        self.matched.forget();
        if let Some(noise) = &mut self.band_noise {
            noise.forget();
        }
    }

    /// Finds the markers; `out` is cleared first. No allocation after the first image of a size.
    ///
    /// A component that reaches the outermost pixels of the image is listed in [`Markers::cut`]: what the border cut off is
    /// unknown, and the centre of the rest is not the marker's. An image with contrast but without markers gives an empty list.
    ///
    /// # Errors
    /// [`DetectError`]; `out` is then empty.
    pub fn run(&mut self, image: GrayView<'_>, out: &mut Markers) -> Result<(), DetectError> {
        out.clear();
        let (image, origin_px) = self.part(image)?;
        self.run_part(image, out)?;
        out.shift(origin_px);
        Ok(())
    }

    fn run_part(&mut self, image: GrayView<'_>, out: &mut Markers) -> Result<(), DetectError> {
        self.check(image)?;
        self.make_room(image);
        let most = most_markers(&self.params, self.size_px);
        // Along the border every second pixel at most begins a marker.
        out.reserve(most, most.min(image.width() + image.height()));
        self.areas_px2.clear();
        self.areas_px2.reserve(most);
        if self.params.centre == Centre::Band {
            self.bands.clear();
            self.bands.reserve(most);
        }
        if !self.run_half(image, out) {
            self.run_whole(image, out)?;
        }
        self.doubt_under_glare(image, out);
        Ok(())
    }

    /// The fit tells by its residuals.
    fn doubt_under_glare(&mut self, image: GrayView<'_>, out: &mut Markers) {
        if self.params.centre != Centre::Fit {
            self.glares.doubt(image, &mut self.areas_px2, out);
        }
    }

    /// The first image of a size is looked at in both sizes, so that no later one needs more room.
    fn make_room(&mut self, image: GrayView<'_>) {
        let size_px = (image.width(), image.height());
        if let (Some(half), true) = (&mut self.half, self.size_px != size_px) {
            half.reserve(image, &mut self.areas_px2);
            // Whether it has too many components its search will tell.
            let _ = self.segments.run(image);
            self.grey_centre.reserve(image.height());
        }
        self.size_px = size_px;
    }

    /// At which size the markers of the last image were found.
    #[must_use]
    pub fn found_at(&self) -> FindAt {
        match searched(&self.segments, self.half.as_ref()) {
            (_, half::SCALE) => FindAt::HalfSize,
            _ => FindAt::FullSize,
        }
    }

    /// Writes the mask of the last image, 255 where a pixel belongs to a component, row by row.
    pub fn mask(&self, out: &mut Vec<u8>) {
        let (segments, scale) = searched(&self.segments, self.half.as_ref());
        segments.draw_scaled(self.size_px, scale, out);
        let Some([x, y, columns, _]) = self.roi_px.filter(|_| self.size_px != (0, 0)) else { return };
        let part = core::mem::take(out);
        out.resize(self.whole_px.0 * self.whole_px.1, 0);
        let rows = out.chunks_exact_mut(self.whole_px.0).skip(y);
        rows.zip(part.chunks_exact(columns))
            .for_each(|(row, part)| row[x..x + columns].copy_from_slice(part));
    }

    /// Variance of a coordinate for rungs that do not measure their own, px².
    fn typed_variance_px2(&self) -> f64 {
        self.params.centre_sigma_px * self.params.centre_sigma_px
    }

    fn check(&self, image: GrayView<'_>) -> Result<(), DetectError> {
        let (width, height) = (image.width(), image.height());
        let least = crate::math::ceil(crate::math::sqrt(f64::from(self.params.min_area_px2))) as usize + 2;
        if width.min(height) < least {
            return Err(DetectError::TooSmall { width, height, least });
        }
        let threshold_levels = match self.params.threshold {
            Threshold::Fixed => self.params.threshold_levels,
            Threshold::Auto => threshold::LEAST_LEVELS,
        };
        if !image.spans(threshold_levels) {
            let (low, high) = image.range();
            return Err(DetectError::Flat { low, high, threshold_levels });
        }
        Ok(())
    }
}

/// What the last image fell into, and how many of its columns and rows each pixel of that has.
fn searched<'a>(segments: &'a Segments, half: Option<&'a HalfSize>) -> (&'a Segments, usize) {
    half.filter(|half| half.is_complete).map_or((segments, 1), |half| (half.segments(), half::SCALE))
}

/// Most markers of an image of this size (width, height), however small they may be; more are refused.
///
/// Dots can be told apart from a pitch of about 6 px on, and a square lattice covers at most three quarters of the image: one marker
/// for each [`PIXELS_PER_MARKER`].
#[must_use]
pub fn most_markers(params: &DetectParams, size_px: (usize, usize)) -> usize {
    let pixels = size_px.0 * size_px.1;
    (pixels / params.min_area_px2.max(4) as usize)
        .min((pixels / PIXELS_PER_MARKER).max(1024))
        .min(MOST_MARKERS)
}

/// How many rows to go on, to see so many of an image or a few more.
const fn rows_between(height: usize, rows: usize) -> usize {
    if height < 2 * rows { 1 } else { height / rows }
}
