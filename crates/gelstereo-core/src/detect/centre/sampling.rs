//! What sampling does to centres by a smooth model of the blurred outline.

use crate::math::{exp, sqrt};
use core::f64::consts::PI;

/// Standard deviation of a coordinate for a disc of 1 px in radius whose outline is not blurred at all. A Gaussian blur σ
/// leaves exp(-2 π² σ²) of a contrast that repeats with the pixels; the errors of as many pixels as an outline has,
/// independent, fall with the root of the radius. Of discs of 2.5 to 6.5 px in radius whose pixels are exact areas, under a
/// total blur of 0.29 to 0.45 px, it gives the error of [`Centre::Matched`](crate::params::Centre::Matched) to 20 % and
/// that of [`Centre::Fit`](crate::params::Centre::Fit), which takes no blur below 0.35 px, to 50 %.
const SHARP_PX: f64 = 0.065;
/// A pixel's own width, 1 / √12 px: no image is sharper.
const PIXEL_BLUR_PX: f64 = 0.288_675;

/// Variance of a coordinate, px², by an outline so sharp that its pixels do not tell all of its shape.
pub(in crate::detect) fn error_px2(blur_px: f64, radius_px: f64) -> f64 {
    let blur_px = blur_px.max(PIXEL_BLUR_PX);
    let sigma_px = SHARP_PX * exp(-2.0 * PI * PI * blur_px * blur_px) / sqrt(radius_px.max(1.0));
    sigma_px * sigma_px
}
