//! Finding markers in one image (section III-A): what differs from its surround by enough, in one piece, of a
//! plausible size, with its centre.

mod band;
pub mod blocks;
pub mod blur;
pub mod centre;
pub mod components;
mod difference;
mod error;
pub mod fit;
pub mod glance;
pub mod matched;
pub mod morphology;
pub mod near;
pub mod noise;
pub mod pieces;
pub mod smooth;
pub mod threshold;
mod windows;

pub use error::DetectError;

use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use crate::params::{Centre, DetectParams, Threshold};
use alloc::vec;
use alloc::vec::Vec;
use band::BandNoise;
use centre::GreyCentre;
use components::{Blob, Components, Most};
use difference::Difference;
use fit::{CLEARANCE_PX, DiscFit, NoiseMeter};
use glance::{Eye, Kind};
use matched::Matched;
use morphology::Closing;
use near::Search;
use windows::Glances;

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
    /// Markers of which the image's border cuts off a part; none of the lists above has them.
    pub cut: Vec<CutMarker>,
}

/// A marker that reaches the outermost pixels of the image: good enough for a label, not for a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutMarker {
    /// Mean position of its visible pixels, pixels; the centre lies farther out.
    pub centre_px: DVec2,
    /// Covariance about the whole marker's centre, px²: across each border that it reaches, the share of a radius that its
    /// area lacks.
    pub covariance_px2: Symmetric<2>,
    /// Visible area, square pixels.
    pub area_px2: u32,
}

impl Markers {
    /// Markers at known places, with one standard deviation per axis for all.
    #[must_use]
    pub fn at(centres_px: Vec<DVec2>, sigma_px: f64) -> Self {
        let variance = sigma_px * sigma_px;
        let (covariance_px2, area_px2) =
            (vec![[[variance, 0.0], [0.0, variance]]; centres_px.len()], vec![1; centres_px.len()]);
        Self { centres_px, covariance_px2, area_px2, cut: Vec::new(), unfitted: 0 }
    }

    fn clear(&mut self) {
        self.centres_px.clear();
        self.covariance_px2.clear();
        self.area_px2.clear();
        self.cut.clear();
        self.unfitted = 0;
    }

    fn reserve(&mut self, markers: usize, cut: usize) {
        self.centres_px.reserve(markers);
        self.covariance_px2.reserve(markers);
        self.area_px2.reserve(markers);
        self.cut.reserve(cut);
    }

    fn push(&mut self, centre_px: DVec2, covariance_px2: Symmetric<2>, area_px2: u32) {
        self.centres_px.push(centre_px);
        self.covariance_px2.push(covariance_px2);
        self.area_px2.push(area_px2);
    }
}

/// Most markers of an image, those that the border cuts included: 90 x 90 and a few.
pub const MOST_MARKERS: usize = 8192;

/// Pixels of an image for each of the markers that it may have.
pub const PIXELS_PER_MARKER: usize = 50;

/// Smaller pieces take no pixels from a marker beside them.
const LEAST_NEIGHBOUR_PX2: u32 = 3;

/// The detection stage and its scratch.
#[derive(Clone, Debug)]
pub struct Detector {
    params: DetectParams,
    difference: Difference,
    closing: Closing,
    components: Components,
    grey_centre: GreyCentre,
    disc_fit: Option<DiscFit>,
    matched: Matched,
    band_noise: Option<BandNoise>,
    /// Of each marker that was seen at a glance, [`Spot::band`](glance::Spot::band); else 0.
    bands: Vec<u8>,
    meter: NoiseMeter,
    size_px: (usize, usize),
    mask: Vec<u8>,
    areas_px2: Vec<u32>,
    near: Search,
    glances: Glances,
}

impl Detector {
    /// With these settings (already validated by `Params::validate`).
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        Self {
            params: params.clone(),
            difference: Difference::new(params),
            closing: Closing::new(params.morphology_kernel_px),
            components: Components::keeping(params.min_area_px2.min(LEAST_NEIGHBOUR_PX2)),
            grey_centre: GreyCentre::default(),
            disc_fit: (params.centre == Centre::Fit).then(|| DiscFit::new(params)),
            matched: Matched::new(params),
            band_noise: (params.centre == Centre::Band).then(BandNoise::new),
            bands: Vec::new(),
            meter: NoiseMeter::default(),
            size_px: (0, 0),
            mask: Vec::new(),
            areas_px2: Vec::new(),
            near: Search::default(),
            glances: Glances::default(),
        }
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
        self.check(image)?;
        self.find_components(image)?;
        let flip = self.flip();
        let Self {
            params,
            difference,
            components,
            grey_centre,
            disc_fit,
            matched,
            band_noise,
            bands,
            meter,
            areas_px2,
            ..
        } = self;
        let most = most_markers(params, (image.width(), image.height()));
        // Along the border every second pixel at most begins a marker.
        out.reserve(most, most.min(image.width() + image.height()));
        if let Some(fit) = disc_fit.as_mut() {
            fit.clear(most);
        }
        areas_px2.clear();
        areas_px2.reserve(most);
        let size_px = (image.width(), image.height());
        let markers = components.blobs().iter().filter(|blob| is_marker(blob, params));
        let found = markers.clone().count();
        if found > most {
            return Err(DetectError::TooMany { found, most });
        }
        let whole = markers.clone().filter(|blob| blob.sides_reached(size_px) == (false, false));
        areas_px2.extend(whole.clone().map(|blob| blob.area_px2));
        let usual_px2 = usual_area_px2(areas_px2);
        let (least_px2, most_px2) = area_range_px2(params.threshold, usual_px2);
        let variance = params.centre_sigma_px * params.centre_sigma_px;
        let in_range = |blob: &&Blob| (least_px2..=most_px2).contains(&blob.area_px2);
        let kind = Kind::of(usual_px2).filter(|_| params.centre == Centre::Band);
        let at_a_glance = |at_px| match kind? {
            kind if kind.is_small() => Eye::<16>::new(kind, flip).centre(image, at_px),
            kind => Eye::<32>::new(kind, flip).centre(image, at_px),
        };
        bands.clear();
        if kind.is_some() {
            bands.reserve(most);
        }
        for blob in whole.clone().filter(in_range) {
            let mut grey = || grey_centre.run(image, blob, components.runs(blob), params.polarity);
            let (centre_px, band) = match params.centre {
                Centre::Binary | Centre::Matched | Centre::Fit => (centre::binary(blob), 0),
                Centre::Band => at_a_glance(centre::binary(blob)).unwrap_or_else(|| (grey(), 0)),
                Centre::Grey => (grey(), 0),
            };
            if kind.is_some() {
                bands.push(band);
            }
            out.push(centre_px, [[variance, 0.0], [0.0, variance]], blob.area_px2);
            if let Some(fit) = disc_fit.as_mut() {
                fit.add(centre_px, blob.spread_px2(components.runs(blob)));
            }
        }
        if let (Some(band_noise), Some(kind)) = (band_noise, kind) {
            let every = SPARSER * rows_between(size_px.1);
            let noise = meter.run_rows(image, every, CLEARANCE_PX, |rows, near| components.cover(rows, near));
            let noise = noise.unwrap_or_default();
            if kind.is_small() {
                band_noise.learn(image, &Eye::<16>::new(kind, flip), &noise, &out.centres_px);
            } else {
                band_noise.learn(image, &Eye::<32>::new(kind, flip), &noise, &out.centres_px);
            }
            for (covariance, &band) in out.covariance_px2.iter_mut().zip(&*bands) {
                if let Some(variance) = band_noise.variance_px2(band) {
                    *covariance = [[variance, 0.0], [0.0, variance]];
                }
            }
        }
        if let Some(fit) = disc_fit {
            let mask = difference.spare();
            fill_mask(components, self.size_px, mask);
            let others = components.blobs().iter().filter(|blob| blob.area_px2 >= LEAST_NEIGHBOUR_PX2);
            fit.finish(image, mask, others.map(centre::binary), out);
            grey_centre.reserve(image.height());
            let mut unfitted = fit.unfitted().peekable();
            for (k, blob) in whole.clone().filter(in_range).enumerate() {
                if unfitted.next_if_eq(&k).is_some() {
                    out.centres_px[k] = grey_centre.run(image, blob, components.runs(blob), params.polarity);
                }
            }
        }
        if params.centre == Centre::Matched {
            let every = rows_between(size_px.1);
            let noise = meter.run_rows(image, every, CLEARANCE_PX, |rows, near| components.cover(rows, near));
            matched.prepare(image, noise.unwrap_or_default(), out);
            grey_centre.reserve(image.height());
            for (k, blob) in whole.filter(in_range).enumerate() {
                if !matched.replace(image, k, out) {
                    out.centres_px[k] = grey_centre.run(image, blob, components.runs(blob), params.polarity);
                }
            }
        }
        for blob in markers.filter(in_range) {
            let reached = blob.sides_reached(size_px);
            if reached != (false, false) && is_as_long_as_a_marker(blob, usual_px2) {
                out.cut.push(cut_marker(blob, reached, usual_px2, variance));
            }
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

    /// What differs from its surround, in pieces. Only closing needs the mask as an image.
    fn find_components(&mut self, image: GrayView<'_>) -> Result<(), DetectError> {
        let (width, height) = (image.width(), image.height());
        self.size_px = (width, height);
        self.difference.survey(image);
        let closes = self.closes();
        if closes {
            self.threshold_all(image);
        } else {
            self.mask.resize(width, 0);
        }
        let most = Most::of(width, height);
        self.components.start(width, height);
        for y in 0..height {
            if closes {
                self.components.push(&self.mask[y * width..(y + 1) * width]);
            } else {
                self.difference.row(image, y, &mut self.mask);
                self.components.push(&self.mask);
            }
            // Joins below may still make fewer pieces; an image of markers never comes near.
            let counts =
                [(self.components.all_runs().len(), most.runs), (self.components.pieces(), most.components)];
            if let Some((found, most)) = counts.into_iter().find(|(found, most)| found > most) {
                return Err(DetectError::TooMany { found, most });
            }
        }
        self.components.finish();
        let found = self.components.kept();
        if found > most.kept { Err(DetectError::TooMany { found, most: most.kept }) } else { Ok(()) }
    }

    const fn closes(&self) -> bool {
        self.params.morphology_kernel_px > 1
    }

    fn threshold_all(&mut self, image: GrayView<'_>) {
        let width = image.width();
        self.mask.resize(width * image.height(), 0);
        for (y, row) in self.mask.chunks_exact_mut(width).enumerate() {
            self.difference.row(image, y, row);
        }
        self.closing.run(&mut self.mask, width);
    }
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

/// Rows from which noise is measured, for the matched step.
const NOISE_ROWS: usize = 80;

/// Rows between those from which it is measured for the covariance of [`Centre::Band`], over that: weights do not follow it.
const SPARSER: usize = 2;

const fn rows_between(height: usize) -> usize {
    if height < 2 * NOISE_ROWS { 1 } else { height / NOISE_ROWS }
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

/// Least and largest area of a marker beside others of a usual area.
fn area_range_px2(threshold: Threshold, usual_px2: f64) -> (u32, u32) {
    match threshold {
        Threshold::Auto if usual_px2 > 0.0 => {
            ((SHARES_OF_AREA.0 * usual_px2) as u32, (SHARES_OF_AREA.1 * usual_px2) as u32)
        }
        Threshold::Fixed | Threshold::Auto => (0, u32::MAX),
    }
}

/// The area below which half of all pixels of markers of these areas lie; 0 for none. Specks may outnumber the markers, but
/// they have few pixels.
fn usual_area_px2(areas_px2: &mut [u32]) -> f64 {
    areas_px2.sort_unstable();
    let all: u64 = areas_px2.iter().map(|&area| u64::from(area)).sum();
    let mut below = 0;
    let usual = areas_px2.iter().find(|&&area| {
        below += u64::from(area);
        2 * below >= all
    });
    usual.map_or(0.0, |&area| f64::from(area))
}

/// Markers differ in area: one that shows all of the usual one may still lack this share of its own.
const AREA_SPREAD: f64 = 0.2;

/// Whether what reaches the border may be a part of a marker, not a strip along the border. Without whole markers to compare
/// with, nothing may.
fn is_as_long_as_a_marker(blob: &Blob, usual_px2: f64) -> bool {
    let (width, height) = blob.size();
    let side = f64::from(width.max(height));
    // Twice the diameter, since markers need not be round.
    side * side <= 4.0 * 4.0 * core::f64::consts::FRAC_1_PI * usual_px2
}

/// What is known of a marker whose component reaches the image's borders across (x, y).
fn cut_marker(blob: &Blob, reached: (bool, bool), usual_px2: f64, variance: f64) -> CutMarker {
    let area = f64::from(blob.area_px2);
    let full = (1.0 + AREA_SPREAD) * usual_px2.max(area);
    // As long as the border cuts straight, the visible centroid is less than the radius times the hidden share away.
    let hidden_px = crate::math::sqrt(full * core::f64::consts::FRAC_1_PI) * (1.0 - area / full);
    let of = |reached: bool| variance + if reached { hidden_px * hidden_px } else { 0.0 };
    CutMarker {
        centre_px: centre::binary(blob),
        covariance_px2: [[of(reached.0), 0.0], [0.0, of(reached.1)]],
        area_px2: blob.area_px2,
    }
}

/// Whether a component is of a plausible size and round enough.
fn is_marker(blob: &Blob, params: &DetectParams) -> bool {
    (params.min_area_px2..=params.max_area_px2).contains(&blob.area_px2) && in_shape(blob, params)
}

/// Whether a component is round enough.
fn in_shape(blob: &Blob, params: &DetectParams) -> bool {
    let (width, height) = blob.size();
    let ellipse_area = core::f64::consts::FRAC_PI_4 * f64::from(width) * f64::from(height);
    f64::from(blob.area_px2) >= params.min_fill * ellipse_area
}
