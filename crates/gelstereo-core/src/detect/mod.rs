//! Finding markers in one image (section III-A): what differs from its surround by enough, in one piece, of a
//! plausible size, with its centre.

pub mod bias;
pub mod blur;
pub mod centre;
pub mod components;
pub mod fit;
pub mod morphology;

use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::{Background, Centre, DetectParams, Polarity};
use alloc::vec;
use alloc::vec::Vec;
use blur::{BoxMean, FRACTION_BITS, GaussianBlur};
use centre::GreyCentre;
use components::{Blob, Components};
use fit::DiscFit;
use morphology::Closing;

/// Markers found in one image, in the raster order of their first pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Markers {
    /// Centres, pixels.
    pub centres_px: Vec<DVec2>,
    /// Covariances of the centres, px².
    pub covariance_px2: Vec<Symmetric<2>>,
    /// Areas, square pixels.
    pub area_px2: Vec<u32>,
    /// How many of them the model fit did not settle on, and which kept the grey centroid; 0 for other rungs.
    pub unfitted: usize,
}

impl Markers {
    /// Markers at known places, with one standard deviation per axis for all.
    #[must_use]
    pub fn at(centres_px: Vec<DVec2>, sigma_px: f64) -> Self {
        let variance = sigma_px * sigma_px;
        let (covariance_px2, area_px2) =
            (vec![[[variance, 0.0], [0.0, variance]]; centres_px.len()], vec![1; centres_px.len()]);
        Self { centres_px, covariance_px2, area_px2, unfitted: 0 }
    }
}

/// Why an image has no markers to offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectError {
    /// Too small for the smallest marker and a pixel of gel on each side of it.
    TooSmall {
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
        /// Least side, pixels.
        least: usize,
    },
    /// No contrast: no pixel can differ from its surround by the threshold.
    Flat {
        /// Darkest grey level found.
        low: u8,
        /// Brightest grey level found.
        high: u8,
        /// `detect.threshold_levels`.
        threshold_levels: u8,
    },
}

impl core::fmt::Display for DetectError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::TooSmall { width, height, least } => write!(
                f,
                "the image is {width} x {height} pixels; a marker of detect.min_area_px2 with gel around it needs \
                 {least} x {least}"
            ),
            Self::Flat { low, high, threshold_levels } => {
                write!(
                    f,
                    "all grey levels lie from {low} to {high}, but markers must differ from their surround by \
                     detect.threshold_levels = {threshold_levels}"
                )?;
                if high < threshold_levels {
                    write!(f, ": the image is black, check the light and the exposure")?;
                } else if low > u8::MAX - threshold_levels {
                    write!(f, ": the image is saturated, shorten the exposure")?;
                }
                Ok(())
            }
        }
    }
}

impl core::error::Error for DetectError {}

/// The detection stage and its scratch.
#[derive(Clone, Debug)]
pub struct Detector {
    params: DetectParams,
    smooth: GaussianBlur,
    surround: Surround,
    closing: Closing,
    components: Components,
    grey_centre: GreyCentre,
    disc_fit: DiscFit,
    smooth_row: Vec<u16>,
    surround_row: Vec<u16>,
    mask: Vec<u8>,
}

/// The rungs of [`Background`].
#[derive(Clone, Debug)]
enum Surround {
    Gaussian(GaussianBlur),
    Box(BoxMean),
}

impl Detector {
    /// With these settings (already validated by `Params::validate`).
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            smooth: GaussianBlur::new(params.smooth_kernel_px),
            surround: match params.background {
                Background::Gaussian => Surround::Gaussian(GaussianBlur::new(params.background_kernel_px)),
                Background::Box => Surround::Box(BoxMean::new(params.background_kernel_px)),
            },
            closing: Closing::new(params.morphology_kernel_px),
            components: Components::default(),
            grey_centre: GreyCentre::default(),
            disc_fit: DiscFit::new(params),
            smooth_row: Vec::new(),
            surround_row: Vec::new(),
            mask: Vec::new(),
        }
    }

    /// Finds the markers; `out` is cleared first. No allocation after the first image of a size.
    ///
    /// A component that reaches the outermost pixels of the image is dropped: what the border cut off is unknown, and
    /// the centre of the rest is not the marker's. An image with contrast but without markers gives an empty list.
    ///
    /// # Errors
    /// [`DetectError`]; `out` is then empty.
    pub fn run(&mut self, image: GrayView<'_>, out: &mut Markers) -> Result<(), DetectError> {
        out.centres_px.clear();
        out.covariance_px2.clear();
        out.area_px2.clear();
        out.unfitted = 0;
        self.check(image)?;
        self.threshold(image);
        self.closing.run(&mut self.mask, image.width());
        let Self { params, components, grey_centre, disc_fit, mask, .. } = self;
        // No two markers share pixels, so that this many are the most there can be.
        let most = image.width() * image.height() / params.min_area_px2.max(4) as usize;
        out.centres_px.reserve(most);
        out.covariance_px2.reserve(most);
        out.area_px2.reserve(most);
        disc_fit.clear(if params.centre == Centre::Fit { most } else { 0 });
        components.run(mask, image.width());
        let variance = params.centre_sigma_px * params.centre_sigma_px;
        for blob in components.blobs() {
            if is_marker(blob, params, image) {
                out.centres_px.push(match params.centre {
                    Centre::Binary => centre::binary(blob),
                    Centre::Grey | Centre::Fit => {
                        grey_centre.run(image, blob, components.runs(blob), params.polarity)
                    }
                });
                out.covariance_px2.push([[variance, 0.0], [0.0, variance]]);
                out.area_px2.push(blob.area_px2);
                if let (Centre::Fit, Some(&centre)) = (params.centre, out.centres_px.last()) {
                    disc_fit.add(blob, components.runs(blob), centre);
                }
            }
        }
        if params.centre == Centre::Fit {
            disc_fit.finish(image, mask, components.blobs(), out);
        }
        Ok(())
    }

    /// The mask of the last image, 255 where a pixel belongs to a component, row by row.
    #[must_use]
    pub fn mask(&self) -> &[u8] {
        &self.mask
    }

    fn check(&self, image: GrayView<'_>) -> Result<(), DetectError> {
        let (width, height) = (image.width(), image.height());
        let least = crate::math::ceil(crate::math::sqrt(f64::from(self.params.min_area_px2))) as usize + 2;
        if width.min(height) < least {
            return Err(DetectError::TooSmall { width, height, least });
        }
        let (low, high) = image.range();
        let threshold_levels = self.params.threshold_levels;
        if high - low < threshold_levels {
            return Err(DetectError::Flat { low, high, threshold_levels });
        }
        Ok(())
    }

    /// Difference of the two filtered images, made binary, one row at a time.
    fn threshold(&mut self, image: GrayView<'_>) {
        let width = image.width();
        self.mask.clear();
        self.mask.resize(width * image.height(), 0);
        for row in [&mut self.smooth_row, &mut self.surround_row] {
            row.clear();
            row.resize(width, 0);
        }
        let least = u16::from(self.params.threshold_levels) << FRACTION_BITS;
        for (y, mask) in self.mask.chunks_exact_mut(width).enumerate() {
            self.smooth.row(image, y, &mut self.smooth_row);
            match &mut self.surround {
                Surround::Gaussian(blur) => blur.row(image, y, &mut self.surround_row),
                Surround::Box(mean) => mean.row(image, y, &mut self.surround_row),
            }
            let (bright, dark) = match self.params.polarity {
                Polarity::Dark => (&self.surround_row, &self.smooth_row),
                Polarity::Bright => (&self.smooth_row, &self.surround_row),
            };
            for ((mask, &bright), &dark) in mask.iter_mut().zip(bright).zip(dark) {
                *mask = if bright.saturating_sub(dark) >= least { u8::MAX } else { 0 };
            }
        }
    }
}

/// Whether a component is whole, of a plausible size and round enough.
fn is_marker(blob: &Blob, params: &DetectParams, image: GrayView<'_>) -> bool {
    let whole = blob.left > 0
        && blob.top > 0
        && (blob.right as usize) < image.width() - 1
        && (blob.bottom as usize) < image.height() - 1;
    let box_area = f64::from(blob.right - blob.left + 1) * f64::from(blob.bottom - blob.top + 1);
    let ellipse_area = core::f64::consts::FRAC_PI_4 * box_area;
    whole
        && (params.min_area_px2..=params.max_area_px2).contains(&blob.area_px2)
        && f64::from(blob.area_px2) >= params.min_fill * ellipse_area
}
