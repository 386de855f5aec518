//! Finding markers in one image (section III-A): what differs from its surround by enough, in one piece, of a
//! plausible size, with its centre.

pub mod blocks;
pub mod blur;
pub mod centre;
pub mod components;
mod difference;
mod error;
pub mod fit;
pub mod morphology;
pub mod noise;
pub mod smooth;
pub mod threshold;

pub use error::DetectError;

use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::{Centre, DetectParams, Threshold};
use alloc::vec;
use alloc::vec::Vec;
use centre::GreyCentre;
use components::{Blob, Components};
use difference::Difference;
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

/// The detection stage and its scratch.
#[derive(Clone, Debug)]
pub struct Detector {
    params: DetectParams,
    difference: Difference,
    closing: Closing,
    components: Components,
    grey_centre: GreyCentre,
    disc_fit: DiscFit,
    size_px: (usize, usize),
    mask: Vec<u8>,
    areas_px2: Vec<u32>,
}

impl Detector {
    /// With these settings (already validated by `Params::validate`).
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            difference: Difference::new(params),
            closing: Closing::new(params.morphology_kernel_px),
            components: Components::default(),
            grey_centre: GreyCentre::default(),
            disc_fit: DiscFit::new(params),
            size_px: (0, 0),
            mask: Vec::new(),
            areas_px2: Vec::new(),
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
        self.find_components(image);
        let Self { params, components, grey_centre, disc_fit, mask, areas_px2, .. } = self;
        // No two markers share pixels, so that this many are the most there can be.
        let most = image.width() * image.height() / params.min_area_px2.max(4) as usize;
        out.centres_px.reserve(most);
        out.covariance_px2.reserve(most);
        out.area_px2.reserve(most);
        disc_fit.clear(if params.centre == Centre::Fit { most } else { 0 });
        areas_px2.clear();
        areas_px2.reserve(most);
        let markers = components.blobs().iter().filter(|blob| is_marker(blob, params, image));
        let (least_px2, most_px2) = match params.threshold {
            Threshold::Fixed => (0, u32::MAX),
            Threshold::Auto => {
                areas_px2.extend(markers.clone().map(|blob| blob.area_px2));
                area_range_px2(areas_px2)
            }
        };
        let variance = params.centre_sigma_px * params.centre_sigma_px;
        for blob in markers.filter(|blob| (least_px2..=most_px2).contains(&blob.area_px2)) {
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
        if params.centre == Centre::Fit {
            fill_mask(components, self.size_px, mask);
            disc_fit.finish(image, mask, components.blobs(), out);
        }
        Ok(())
    }

    /// Writes the mask of the last image, 255 where a pixel belongs to a component, row by row.
    pub fn mask(&self, out: &mut Vec<u8>) {
        fill_mask(&self.components, self.size_px, out);
    }

    fn check(&self, image: GrayView<'_>) -> Result<(), DetectError> {
        let (width, height) = (image.width(), image.height());
        let least = crate::math::ceil(crate::math::sqrt(f64::from(self.params.min_area_px2))) as usize + 2;
        if width.min(height) < least {
            return Err(DetectError::TooSmall { width, height, least });
        }
        let (low, high) = image.range();
        let threshold_levels = match self.params.threshold {
            Threshold::Fixed => self.params.threshold_levels,
            Threshold::Auto => threshold::LEAST_LEVELS,
        };
        if high - low < threshold_levels {
            return Err(DetectError::Flat { low, high, threshold_levels });
        }
        Ok(())
    }

    /// What differs from its surround, in pieces. Only closing needs the mask as an image.
    fn find_components(&mut self, image: GrayView<'_>) {
        let (width, height) = (image.width(), image.height());
        let closes = self.params.morphology_kernel_px > 1;
        self.size_px = (width, height);
        self.difference.survey(image);
        self.mask.clear();
        self.mask.resize(width * if closes { height } else { 1 }, 0);
        self.components.start(width, height);
        for y in 0..height {
            let row = &mut self.mask[if closes { y * width } else { 0 }..][..width];
            self.difference.row(image, y, row);
            if !closes {
                self.components.push(row);
            }
        }
        if closes {
            self.closing.run(&mut self.mask, width);
            self.components.run(&self.mask, width);
        } else {
            self.components.finish();
        }
    }
}

fn fill_mask(components: &Components, (width, height): (usize, usize), out: &mut Vec<u8>) {
    out.clear();
    out.resize(width * height, 0);
    for run in components.all_runs() {
        let first = run.y as usize * width;
        out[first + run.start as usize..first + run.end as usize].fill(u8::MAX);
    }
}

/// Shares of the usual marker's area beyond which a component is a speck of paint or noise, or the edge of something.
const SHARES_OF_AREA: (f64, f64) = (0.4, 2.0);

/// Least and largest area of a marker beside others of these areas: shares of the area below which half of all pixels of
/// markers lie. Specks may outnumber the markers, but they have few pixels.
fn area_range_px2(areas_px2: &mut [u32]) -> (u32, u32) {
    areas_px2.sort_unstable();
    let all: u64 = areas_px2.iter().map(|&area| u64::from(area)).sum();
    let mut below = 0;
    let usual = areas_px2.iter().find(|&&area| {
        below += u64::from(area);
        2 * below >= all
    });
    let usual = usual.map_or(0.0, |&area| f64::from(area));
    ((SHARES_OF_AREA.0 * usual) as u32, (SHARES_OF_AREA.1 * usual) as u32)
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
