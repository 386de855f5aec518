//! One step of the matched filter for one marker, and its uncertainty.

use super::correlate::Patch;
use super::tables::{Kind, PLACES, Tables};
use crate::detect::centre::noise::Noise;
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, round_even, sqrt};
use crate::params::{DetectParams, Polarity};

/// A pixel's own width and a little defocus.
pub(super) const FIRST_BLUR_PX: f64 = 0.8;
/// Initial contrast over the gel's level: the paint, or the gel for bright markers, absorbs 70 % of light.
pub(super) const DARK_PER_GROUND: f64 = -0.7;
pub(super) const BRIGHT_PER_GROUND: f64 = 2.3;
/// Largest number of steps. A binary centroid needs one, a prediction two to four.
const MAX_STEPS: usize = 6;
/// A step is the last if its displacement over the blur is below this; the remainder is then below 0.005 px.
const SETTLED: f64 = 0.27;
/// The same for later steps, in pixels; they start near a position of the weights.
const SETTLED_LATER_PX: f64 = 0.4;
/// Standard deviations of the noise residual that count as chance.
const CHANCE: f64 = 3.0;
/// Longest step.
const LONGEST_PX: f64 = 1.0;
/// Least contrast over the standard deviation of a pixel.
const MIN_CONTRAST: f64 = 1.0;
/// Rms residual of noise and model over the contrast, above which the patch is not a single whole disc.
pub const MAX_MISFIT: f64 = 0.12;

/// Centre of a marker from a matched filter step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    /// Centre, pixels.
    pub centre_px: DVec2,
    /// Its covariance, px², from the image's noise and grain.
    pub covariance_px2: Symmetric<2>,
    /// Level of the dot minus that of the gel, grey levels.
    pub contrast_levels: f64,
    /// Rms residual over the contrast, without noise and grain. It is below [`MAX_MISFIT`] for one whole
    /// marker; neighbours within the support, merged pairs, covered halves and smears have more.
    pub misfit: f64,
}

/// The weights computed so far, and what was last learned from an image.
#[derive(Clone, Debug)]
pub(super) struct MatchedFilter {
    pub given_blur_px: Option<f64>,
    pub bright: bool,
    pub noise: Noise,
    pub blur_px: f64,
    /// Variance of a coordinate due to sampling.
    pub sampling_px2: f64,
    /// Radius of discs minus that of components of the same area, for the usual one.
    pub radius_off_px: f64,
    /// Radius of the usual component, and the change of disc radius per pixel of component radius. The
    /// latter is below 1 if uneven light makes components grow with their contrast.
    pub usual_px: f64,
    pub radius_per_px: f64,
    /// Usual contrast, grey levels; 0 if unknown.
    pub contrast_levels: f64,
    /// Usual contrast over the gel's level.
    pub per_ground: f64,
    pub response: Response,
    pub tables: Tables,
    pub patch: Patch,
}

/// Position of the weights of one step, and its result.
pub(super) struct Step {
    pub set: usize,
    pub place: usize,
    pub at_px: DVec2,
    pub moved_px: DVec2,
    /// Displacement to first order.
    pub linear_px: DVec2,
    pub contrast: f64,
    pub variances: [f64; 2],
}

/// Step length per px of true displacement. The weights are designed for a nearby blur and radius and for
/// a circle. With a response s instead of 1, noise equivalent to one px moves the centre by 1 / s px.
#[derive(Clone, Copy, Debug)]
pub(super) struct Response {
    pub mean: f64,
    /// Mean of 1 / s² over markers. Noise varies s too, and the error grows with it in second order as in
    /// a fit.
    pub per_square: f64,
    /// Variance of s over markers that is not explained by noise, due to their radii and shapes.
    pub scatter: f64,
}

impl Default for Response {
    fn default() -> Self {
        Self { mean: 1.0, per_square: 1.0, scatter: 0.0 }
    }
}

impl MatchedFilter {
    /// Creates the filter from its settings.
    pub fn new(params: &DetectParams) -> Self {
        let bright = params.polarity == Polarity::Bright;
        Self {
            given_blur_px: params.fit.blur_px,
            bright,
            noise: Noise::default(),
            blur_px: params.fit.blur_px.unwrap_or(FIRST_BLUR_PX),
            sampling_px2: 0.0,
            radius_off_px: 0.0,
            usual_px: 0.0,
            radius_per_px: 1.0,
            contrast_levels: 0.0,
            per_ground: if bright { BRIGHT_PER_GROUND } else { DARK_PER_GROUND },
            response: Response::default(),
            tables: Tables::default(),
            patch: Patch::default(),
        }
    }

    /// Discards what was learned, but keeps the memory.
    pub fn forget(&mut self) {
        self.noise = Noise::default();
        self.blur_px = self.given_blur_px.unwrap_or(FIRST_BLUR_PX);
        (self.radius_off_px, self.contrast_levels, self.sampling_px2) = (0.0, 0.0, 0.0);
        (self.usual_px, self.radius_per_px) = (0.0, 1.0);
        self.per_ground = if self.bright { BRIGHT_PER_GROUND } else { DARK_PER_GROUND };
        self.response = Response::default();
        self.tables.forget();
    }

    /// Radius of a disc whose component has this area, in the last image learned.
    pub fn radius_px(&self, area_px2: u32) -> f64 {
        let larger_px = component_px(area_px2) - self.usual_px;
        self.usual_px + self.radius_off_px + self.radius_per_px * larger_px
    }

    /// Finds the disc of about this radius whose centre is within about a pixel of `near_px`. `None` if
    /// the support leaves the image, nothing of that polarity is there, or steps do not converge.
    #[inline]
    pub fn refine(&mut self, image: GrayView<'_>, near_px: DVec2, radius_px: f64) -> Option<Refined> {
        let (mut near, mut settled_px) = (near_px, SETTLED * self.tables.blur_px());
        for _ in 0..MAX_STEPS {
            let step = self.step(image, near, radius_px)?;
            near = step.at_px + step.moved_px;
            if step.moved_px.length_squared() <= settled_px * settled_px {
                return Some(self.judge(&step));
            }
            settled_px = SETTLED_LATER_PX;
        }
        None
    }

    #[inline]
    pub fn step(&mut self, image: GrayView<'_>, near_px: DVec2, radius_px: f64) -> Option<Step> {
        let (index, variances) = self.tables.find(radius_px)?;
        let set = self.tables.set(index);
        let (place, first, at_px) = locate(image, set.side, near_px)?;
        self.patch.load(image, first, set.side);
        let sum = |kind| f64::from(self.patch.correlate(self.tables.kernel(set, place, kind)));
        let contrast = sum(Kind::Contrast) * set.contrast_per_unit;
        let toward = if self.bright { contrast } else { -contrast };
        if !(toward > 0.0 && toward * toward > MIN_CONTRAST * MIN_CONTRAST * self.noise.variance_levels2()) {
            return None;
        }
        let px_per_unit = set.px_per_unit / (contrast * self.response.mean);
        let linear_px = DVec2::new(sum(Kind::X), sum(Kind::Y)) * px_per_unit;
        let long2 = linear_px.length_squared();
        let moved_px = if long2 < LONGEST_PX * LONGEST_PX {
            linear_px * (1.0 + set.bend_per_px2 * long2)
        } else {
            // Far away, only the direction of the step is useful.
            linear_px * (LONGEST_PX / sqrt(long2))
        };
        Some(Step { set: index, place, at_px, moved_px, linear_px, contrast, variances })
    }

    /// Level of the gel, and variance of the residuals after subtracting a step's disc.
    #[inline]
    pub fn rest(&mut self, step: &Step) -> (f64, f64) {
        let set = self.tables.set(step.set);
        let (share, mask) = (self.tables.kernel(set, step.place, Kind::Share), self.tables.mask(set));
        let whole = round_even(step.contrast).clamp(-255.0, 255.0) as i16;
        let (sum, square) = self.patch.residual(share, mask, whole);
        let (sum, square, pixels) = (f64::from(sum), f64::from(square), f64::from(set.pixels));
        (sum / pixels, (square - sum * sum / pixels) / (pixels - 1.0))
    }

    /// Covariance and misfit after the last step.
    #[inline]
    pub fn judge(&mut self, step: &Step) -> Refined {
        let (ground, rest2) = self.rest(step);
        let pixels = f64::from(self.tables.set(step.set).pixels);
        // Grain belongs to the surface: it grows with the light.
        let grain_share = self.noise.grain_share(ground);
        let noise2 = self.noise.white_levels2 + grain_share * self.noise.grain_levels2;
        let chance2 = noise2 * (1.0 + CHANCE * sqrt(2.0 / pixels));
        let per_contrast2 = 1.0 / (step.contrast * step.contrast);
        let noise_px2 = (step.variances[0] + grain_share * step.variances[1]) * per_contrast2;
        Refined {
            centre_px: step.at_px + step.moved_px,
            covariance_px2: self.covariance_px2(step, noise_px2),
            contrast_levels: step.contrast,
            misfit: sqrt((rest2 - chance2).max(0.0) * per_contrast2),
        }
    }

    /// Covariance of a centre, given its noise variance at unit response. It is divided by the squared
    /// response, and a step g (1 + κ g²) propagates the noise of g by its derivatives, (1 + κ g²) I + 2 κ
    /// g gᵀ. A marker's own deviation from the mean response adds that share of its step.
    fn covariance_px2(&self, step: &Step, noise_px2: f64) -> Symmetric<2> {
        let Response { per_square, scatter, .. } = self.response;
        let all_px2 = noise_px2 * per_square;
        let (g, bend) = (step.linear_px, self.tables.set(step.set).bend_per_px2);
        let bent = bend * g.length_squared();
        let even = all_px2 * (1.0 + bent) * (1.0 + bent);
        let along = all_px2 * 4.0 * bend * (1.0 + 2.0 * bent) + scatter * per_square;
        let entry = |one: f64, product: f64| (even + self.sampling_px2) * one + along * product;
        let xy = entry(0.0, g.x * g.y);
        [[entry(1.0, g.x * g.x), xy], [xy, entry(1.0, g.y * g.y)]]
    }
}

/// Radius of a circle of this area.
pub(super) fn component_px(area_px2: u32) -> f64 {
    sqrt(f64::from(area_px2) * core::f64::consts::FRAC_1_PI)
}

/// The nearest sub-pixel position, the support's first pixel, and the coordinates of that position;
/// `None` if the support leaves the image.
#[inline]
pub(super) fn locate(
    image: GrayView<'_>,
    side: usize,
    near_px: DVec2,
) -> Option<(usize, (usize, usize), DVec2)> {
    let half = side as i64 / 2;
    let axis = |at: f64, size: usize| {
        // Positions below -1 become negative all the same.
        let quarter = ((at + 1.5) * PLACES as f64) as i64 - PLACES as i64;
        let pixel = quarter.div_euclid(PLACES as i64);
        if !(pixel >= half && pixel + half < size as i64) {
            return None;
        }
        let middle = (quarter as f64 + 0.5) / PLACES as f64 - 0.5;
        Some((quarter.rem_euclid(PLACES as i64) as usize, (pixel - half) as usize, middle))
    };
    let ((column, x, at_x), (row, y, at_y)) =
        (axis(near_px.x, image.width())?, axis(near_px.y, image.height())?);
    Some((row * PLACES + column, (x, y), DVec2::new(at_x, at_y)))
}
