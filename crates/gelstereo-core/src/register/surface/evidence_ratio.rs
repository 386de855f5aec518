//! Log evidence ratio of the part at the pose over something else there.

use super::candidate::Candidate;
use super::contact::Samples;
use super::gel::prediction::GelFitScratch;
use super::mixture::{Likelihood, MIN_OUTLIERS, STRAY_MM};
use super::refine::{Reading, RefineScratch};
use crate::math::{exp, ln, sqrt};
use crate::params::RegisterParams;
use crate::register::Observability;
use crate::register::observe::halves;
use core::f64::consts::TAU;

/// Extent of the gel's salient shoulder beside the part, in decay lengths: there it has sunk to a seventh.
const BESIDE: f64 = 2.0;
/// Iterations of the contact share, which is estimated from the points; it starts close and converges at
/// once.
const STEPS: u32 = 2;

/// Standard deviations over its rest height from which a marker is lifted.
const LIFTED: f64 = 3.0;
/// Standard deviations below the likelihood expected from noise at which the markers beside the part do
/// not follow the gel model.
const LAW_BROKEN: f64 = 3.0;

/// Readings at a pose: distances, and the gel's heights if its model was used.
pub(super) type Read<'a> = (&'a RefineScratch, Option<&'a GelFitScratch>);

/// Evidence of the markers for a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Odds {
    /// ln P(markers | part at the pose) - ln P(markers | something else), with equal priors. Points count
    /// as independent, so values far from 0 are overconfident.
    pub log: f64,
    /// Whether the gel beside the part follows its model.
    pub is_law_kept: bool,
}

/// The log evidence ratio at a pose, before the correction for the search.
pub(super) fn odds(params: &RegisterParams, samples: &Samples, (scratch, settled): Read<'_>) -> Odds {
    match settled {
        Some(settled) => by_heights(samples, settled, params.advanced.outlier_share),
        None => {
            Odds { log: by_distances(samples, scratch, params.advanced.outlier_share), is_law_kept: true }
        }
    }
}

/// Correction for the search over the guess's uncertainty: some pose always fits noise a little. The
/// evidence is the mean over all poses, i.e. the likelihood at a peak times the share of that volume that
/// the peak fills (Laplace's evidence; MacKay 1992), summed over all solutions, the best first.
pub(super) fn searched(params: &RegisterParams, seen: &Observability, answers: &[Candidate]) -> f64 {
    let turn_mm = params.start_sigma_deg.to_radians() * seen.radius_mm;
    let shift_mm = params.start_sigma_mm;
    // Free directions stay at the guess.
    let narrowed = |(u, value): (&[f64; 6], f64)| {
        let (omega, v) = halves(u);
        let guessed = turn_mm * turn_mm * omega.length_squared() + shift_mm * shift_mm * v.length_squared();
        0.5 * ln(1.0 + value * guessed)
    };
    let peaks: f64 = answers.iter().map(|one| exp(answers[0].cost - one.cost)).sum();
    seen.directions.iter().zip(seen.values).map(narrowed).sum::<f64>() - ln(peaks)
}

/// Log evidence ratio from the gel heights with the part in the gel.
///
/// Markers in contact or lifted are where the part puts them, or anywhere within the patch's height; this
/// does not depend on the gel model. The other markers test that model. Where they follow it they count
/// as evidence (noise makes a squared deviation of 1 on average, counted by its half); otherwise the
/// model is wrong.
fn by_heights(samples: &Samples, settled: &GelFitScratch, outliers: f64) -> Odds {
    let stray = outliers.max(MIN_OUTLIERS) / (STRAY_MM * samples.gel_scale);
    let gain = |with: f64, without: f64| {
        ln(((1.0 - outliers) * with + stray) / ((1.0 - outliers) * without + stray))
    };
    let (mut part, mut beside, mut count) = (0.0, 0.0, 0.0);
    for (sight, height_mm) in settled.here.sights.iter().zip(&settled.here.heights_mm) {
        let sigma_mm = sqrt(sight.variance_mm2);
        let peak = 1.0 / (sqrt(TAU) * sigma_mm);
        let half_squared = 0.5 * sight.residual_mm * sight.residual_mm / sight.variance_mm2;
        let measured_mm = sight.residual_mm + height_mm;
        if sight.touches || measured_mm > LIFTED * sigma_mm {
            part += gain(peak * exp(-half_squared), 1.0 / samples.height_mm);
        } else {
            beside += gain(peak * exp(0.5 - half_squared), peak);
            count += 1.0;
        }
    }
    // Half a squared normal deviation has a variance of 1/2.
    Odds { log: part + beside.max(0.0), is_law_kept: beside > -LAW_BROKEN * sqrt(0.5 * count) }
}

/// Log evidence ratio from distances. A salient point is in contact within its noise, or an outlier, or
/// free: up to the patch's height over the part, and as far beside it as the gel takes to sink. Any other
/// marker is not inside the part.
fn by_distances(samples: &Samples, scratch: &RefineScratch, outliers: f64) -> f64 {
    let (pressed, others) = scratch.here.all.split_at(samples.pressed.len());
    let good = 1.0 - outliers;
    let (stray, stray_mm) = (outliers.max(MIN_OUTLIERS), STRAY_MM * samples.gel_scale);
    let count = pressed.len() as f64;
    let mut share = (scratch.touches.iter().take(pressed.len()).sum::<f64>() + 1.0) / (count + 2.0);
    let beside_mm = BESIDE * samples.decay_mm;
    let hangs_mm = 0.0..sqrt(samples.height_mm * samples.height_mm + beside_mm * beside_mm);
    let densities = |r: &Reading, share: f64| {
        let touch = share * good * r.bell.density;
        let hangs = hangs_mm.contains(&r.distance_mm);
        let free = if hangs { (1.0 - share) * good / samples.height_mm } else { 0.0 };
        (touch, touch + free + stray / stray_mm)
    };
    for _ in 0..STEPS {
        let believed = |r| {
            let (touch, all) = densities(r, share);
            touch / all
        };
        share = (pressed.iter().map(believed).sum::<f64>() + 1.0) / (count + 2.0);
    }
    let mut salient = Likelihood::after(0.0);
    pressed.iter().for_each(|r| salient.times(densities(r, share).1 * samples.height_mm));
    let within = others.iter().filter(|r| r.distance_mm < 0.0);
    let deviations = |r: &Reading| r.distance_mm / r.sigma_mm;
    -salient.cost()
        + within.map(|r| ln(good * exp(-0.5 * deviations(r) * deviations(r)) + stray)).sum::<f64>()
}
