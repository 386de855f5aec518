//! Centre error due to pixel sampling, from a smooth model of the blurred outline.

use crate::math::{exp, sqrt};
use core::f64::consts::PI;

/// Standard deviation of a coordinate for a disc of 1 px radius with an unblurred outline. A Gaussian
/// blur σ leaves exp(-2 π² σ²) of a contrast that repeats with the pixels. The errors of an outline's
/// pixels are independent and fall with the root of the radius. For discs of 2.5 to 6.5 px radius with
/// exact pixel areas, under a total blur of 0.29 to 0.45 px, it gives the error of
/// [`Centre::Fit`](crate::params::Centre::Fit), which assumes at least 0.35 px blur, to 50 %.
const SHARP_PX: f64 = 0.065;
/// A pixel's own width, 1 / √12 px: no image is sharper.
const PIXEL_BLUR_PX: f64 = 0.288_675;

/// Variance of a coordinate, px², for an outline too sharp for its pixels to determine its shape.
pub(in crate::detect) fn error_px2(blur_px: f64, radius_px: f64) -> f64 {
    let blur_px = blur_px.max(PIXEL_BLUR_PX);
    let sigma_px = SHARP_PX * exp(-2.0 * PI * PI * blur_px * blur_px) / sqrt(radius_px.max(1.0));
    sigma_px * sigma_px
}
