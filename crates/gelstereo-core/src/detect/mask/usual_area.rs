//! Usual area of the markers of an image, from the areas and places of its components.

use super::components::Blob;
use crate::params::Threshold;
use crate::spatial::rows::{MIN_SHARE, share_in_rows};

/// Least and largest marker area, as shares of the usual area. Smaller are specks of paint or noise,
/// larger are edges of other objects. A least share of 0.36 finds 98 instead of 95 % of drawn dots whose
/// radii differ by 20 %, but in little light beside a tray it takes two pieces of one marker for markers.
pub(in crate::detect) const SHARES_OF_AREA: (f64, f64) = (0.4, 2.0);

/// Largest number of components examined per population. It bounds the work.
const MAX_SAMPLED: usize = 32;
/// Ratio of areas from one population to the next. Each spans a factor of five, so they overlap.
const STEP: f64 = 1.5;

/// Least and largest marker area for a given usual area.
pub(in crate::detect) fn area_range_px2(threshold: Threshold, usual_px2: f64) -> (u32, u32) {
    match threshold {
        Threshold::Auto if usual_px2 > 0.0 => {
            ((SHARES_OF_AREA.0 * usual_px2) as u32, (SHARES_OF_AREA.1 * usual_px2) as u32)
        }
        Threshold::Fixed | Threshold::Auto => (0, u32::MAX),
    }
}

/// Area at the median pixel of all markers (pixel-weighted median); 0 for none. Specks may outnumber the
/// markers but have few pixels.
pub(in crate::detect) fn usual_area_px2(areas_px2: &mut [u32]) -> f64 {
    areas_px2.sort_unstable();
    let all: u64 = areas_px2.iter().map(|&area| u64::from(area)).sum();
    let mut below = 0;
    let usual = areas_px2.iter().find(|&&area| {
        below += u64::from(area);
        2 * below >= all
    });
    usual.map_or(0.0, |&area| f64::from(area))
}

/// Usual area of the population with most members in rows; `None` if no population looks like a print.
///
/// `areas_px2` are the areas of the components, in ascending order.
pub(super) fn regular_area_px2<'a, I: Iterator<Item = &'a Blob>>(
    blobs: &impl Fn() -> I,
    areas_px2: &mut [u32],
) -> Option<f64> {
    let (mut best, mut least_px2) = (None, 0.0);
    for n in 0..areas_px2.len() {
        if f64::from(areas_px2[n]) < least_px2 {
            continue;
        }
        least_px2 = STEP * f64::from(areas_px2[n]);
        let range_px2 = area_range_px2(Threshold::Auto, f64::from(areas_px2[n]));
        let first = areas_px2.partition_point(|&area| area < range_px2.0);
        let last = areas_px2.partition_point(|&area| area <= range_px2.1);
        let usual_px2 = usual_area_px2(&mut areas_px2[first..last]);
        let in_rows = in_rows(blobs, area_range_px2(Threshold::Auto, usual_px2));
        if in_rows > best.map_or(0.0, |(most, _)| most) {
            best = Some((in_rows, usual_px2));
        }
    }
    best.map(|(_, usual_px2)| usual_px2)
}

/// Number of components with these areas that stand in rows; 0 if too few do for a print.
fn in_rows<'a, I: Iterator<Item = &'a Blob>>(blobs: &impl Fn() -> I, range_px2: (u32, u32)) -> f64 {
    let centres = || {
        let members = blobs().filter(move |blob| (range_px2.0..=range_px2.1).contains(&blob.area_px2));
        members.map(Blob::mean_px)
    };
    let share = share_in_rows(&centres, MAX_SAMPLED).filter(|&share| share >= MIN_SHARE);
    share.map_or(0.0, |share| share * centres().count() as f64)
}
