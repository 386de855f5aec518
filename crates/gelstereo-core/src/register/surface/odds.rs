//! Whether the part is where it is said to be: the odds of that over no part being there.

use super::contact::Samples;
use super::polish::{Reading, Readings};
use crate::math::{exp, ln, sqrt};

/// Outliers are spread over this much, as for the pose.
const STRAY_MM: f64 = 3.0;
/// The gel's shoulder is salient as far beside the part as this many decay lengths: there it has sunk to a seventh.
const BESIDE: f64 = 2.0;
/// The share of points that touch is what the points themselves say; it starts close and settles at once.
const STEPS: u32 = 2;

/// ln P(points | part at the pose) - ln P(points | no part), the prior odds even.
///
/// With the part there a salient point touches it, within its noise, or hangs up to as high over it as the patch is
/// and as far beside it as the gel takes to sink, or is an outlier; any other marker is not in it. Without it the
/// salient points are anywhere within that height. Points count as independent: far from even odds the figure is too
/// sure of itself, its sign is not.
pub(super) fn log_odds(samples: &Samples, readings: &Readings, touches: &[f64], outliers: f64) -> f64 {
    let (pressed, others) = readings.all.split_at(samples.pressed.len());
    let good = 1.0 - outliers;
    let stray = outliers.max(1e-4);
    let count = pressed.len() as f64;
    let mut share = (touches.iter().take(pressed.len()).sum::<f64>() + 1.0) / (count + 2.0);
    let beside_mm = BESIDE * samples.decay_mm;
    let hangs_mm = 0.0..sqrt(samples.height_mm * samples.height_mm + beside_mm * beside_mm);
    let densities = |r: &Reading, share: f64| {
        let touch = share * good * normal(r);
        let hangs = hangs_mm.contains(&r.distance_mm);
        let free = if hangs { (1.0 - share) * good / samples.height_mm } else { 0.0 };
        (touch, touch + free + stray / STRAY_MM)
    };
    for _ in 0..STEPS {
        let believed = |r| {
            let (touch, all) = densities(r, share);
            touch / all
        };
        share = (pressed.iter().map(believed).sum::<f64>() + 1.0) / (count + 2.0);
    }
    let salient: f64 = pressed.iter().map(|r| ln(densities(r, share).1 * samples.height_mm)).sum();
    let within = others.iter().filter(|r| r.distance_mm < 0.0);
    let deviations = |r: &Reading| r.distance_mm / r.sigma_mm;
    salient + within.map(|r| ln(good * exp(-0.5 * deviations(r) * deviations(r)) + stray)).sum::<f64>()
}

/// Density of a point that touches, per mm.
fn normal(r: &Reading) -> f64 {
    exp(-0.5 * r.distance_mm * r.distance_mm / r.variance_mm2) / sqrt(core::f64::consts::TAU * r.variance_mm2)
}
