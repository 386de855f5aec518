//! How far off the centre of a marker may be that something covers in part.

use super::Markers;
use super::sieve::usual_area_px2;
use crate::image::GrayView;
use crate::math::{DVec2, abs, ceil, sqrt};
use alloc::vec::Vec;
use core::f64::consts::FRAC_1_PI;

/// Grey level from which on a pixel shows a light's reflection: it saturates the sensor, and gel does not.
pub(super) const GLARE_LEVEL: u8 = 250;
/// Pixels that are that bright by chance.
const FEW: usize = 2;
/// Pixels beyond a marker's outline that its centre depends on.
const AROUND_PX: f64 = 3.0;
/// Markers differ in area by this share without anything over them: by the light, by their tilt on a pressed gel.
const AREA_SPREAD: f64 = 0.2;
/// Share of a marker that a reflection beside it hides at least, by where its light is spread.
const LEAST_HIDDEN: f64 = 0.1;

/// Whether a light's reflection is in the square around a marker of this radius.
pub(super) fn is_under_glare(image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> bool {
    let reach = ceil(radius_px + AROUND_PX);
    let range = |at: f64, size: usize| {
        let (first, end) =
            ((at - reach).max(0.0) as usize, (at + reach + 1.0).clamp(0.0, size as f64) as usize);
        first.min(end)..end
    };
    let (columns, rows) = (range(centre_px.x, image.width()), range(centre_px.y, image.height()));
    let bright =
        |y: usize| image.row(y)[columns.clone()].iter().filter(|&&level| level >= GLARE_LEVEL).count();
    rows.map(bright).sum::<usize>() > FEW
}

/// Tells markers beside a light's reflection that it may hide a part of them; `areas_px2` is scratch. Models of a marker
/// that take a share of its pixels' contrast do not see what is missing at its rim.
pub(super) fn doubt_under_glare(image: GrayView<'_>, areas_px2: &mut Vec<u32>, markers: &mut Markers) {
    if !image.reaches(GLARE_LEVEL) {
        return;
    }
    areas_px2.clear();
    areas_px2.extend_from_slice(&markers.area_px2);
    let usual_px2 = usual_area_px2(areas_px2);
    let radius_px = sqrt(usual_px2 * FRAC_1_PI);
    let places = markers.centres_px.iter().zip(&markers.area_px2);
    for ((&centre_px, &area_px2), [[xx, _], [_, yy]]) in places.zip(&mut markers.covariance_px2) {
        if usual_px2 > 0.0 && is_under_glare(image, centre_px, radius_px) {
            let least = variance_px2(image, centre_px, (f64::from(area_px2), usual_px2));
            (*xx, *yy) = (xx.max(least), yy.max(least));
        }
    }
}

/// Variance of a coordinate of a marker that no model fits, px²: what hides a part of it moves the centroid of the rest by
/// the radius times the hidden share, which is known by its area beside the usual one.
pub(super) fn variance_px2(image: GrayView<'_>, centre_px: DVec2, (area_px2, usual_px2): (f64, f64)) -> f64 {
    if !(usual_px2 > 0.0) {
        return 0.0;
    }
    let radius_px = sqrt(usual_px2 * FRAC_1_PI);
    let differs = abs(1.0 - area_px2 / usual_px2);
    let hidden = if is_under_glare(image, centre_px, radius_px) {
        differs.max(LEAST_HIDDEN)
    } else {
        (differs - AREA_SPREAD).max(0.0)
    };
    (radius_px * hidden) * (radius_px * hidden)
}

/// As [`variance_px2`], of a marker that something touches, so that it has no band; 0 of others.
pub(super) fn without_band_px2(
    band: u8,
    image: GrayView<'_>,
    centre_px: DVec2,
    (area_px2, usual_px2): (u32, f64),
) -> f64 {
    if band == 0 { variance_px2(image, centre_px, (f64::from(area_px2), usual_px2)) } else { 0.0 }
}
