//! Triggers in multiples of the sensor's measured noise.

use super::TaskError;
use super::cell::Cell;
use super::error::Halt;
use crate::config::Config;
use crate::rest_noise::{FRAMES, RestNoise};
use serde::Serialize;

/// Lowest trigger in sigmas. On normal noise, one false alarm in 1e7 frames (four days of guarded moves
/// at 30 Hz) is at 5.2 sigmas. The scale may be two standard errors too small: 5.2 * (1 + 2 * 0.2) = 7.3.
/// Over all measured levels and scales that is 0.2 false alarms per hour of guarded moves on average, most
/// of them after the one rest in a hundred whose scale is below 0.6 of the true one.
pub const MIN_SIGMAS: f64 = 7.3;

/// The triggers of a task, in pixels of mean marker motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Triggers {
    pub(super) grasp_px: f64,
    pub(super) insertion_px: f64,
}

impl Triggers {
    pub(super) const fn in_pixels(config: &Config) -> Self {
        let contact = &config.params.contact;
        Self { grasp_px: contact.grasp_trigger_px, insertion_px: contact.insertion_trigger_px }
    }

    fn in_sigmas(config: &Config, noise: &RestNoise) -> Self {
        let (task, pixels) = (&config.task, Self::in_pixels(config));
        let of = |sigmas: Option<f64>, px: f64| sigmas.map_or(px, |sigmas| noise.at(sigmas));
        Self {
            grasp_px: of(task.grasp_trigger_sigmas, pixels.grasp_px),
            insertion_px: of(task.insertion_trigger_sigmas, pixels.insertion_px),
        }
    }

    /// Rejects triggers that noise alone would reach, stopping moves without contact.
    fn check(&self, noise: &RestNoise) -> Result<(), TaskError> {
        let bound_px = noise.at(MIN_SIGMAS);
        for (name, found_px) in [("grasp", self.grasp_px), ("insertion", self.insertion_px)] {
            // Repeated images have no noise to measure.
            if !(found_px >= bound_px && noise.sigma_px > 0.0) {
                let RestNoise { level_px, sigma_px, frames } = *noise;
                return Err(TaskError::TriggerInNoise {
                    name,
                    found_px,
                    bound_px,
                    level_px,
                    sigma_px,
                    frames,
                });
            }
        }
        Ok(())
    }
}

/// Measures the noise if triggers are given in sigmas, and sets the triggers; returns the noise.
pub(super) fn measure(cell: &mut Cell) -> Result<Option<RestNoise>, Halt> {
    let task = &cell.config.task;
    if task.grasp_trigger_sigmas.is_none() && task.insertion_trigger_sigmas.is_none() {
        return Ok(None);
    }
    let mut motions_px = Vec::with_capacity(FRAMES);
    while motions_px.len() < FRAMES {
        motions_px.push(cell.frame()?);
    }
    let noise = RestNoise::of(motions_px);
    cell.triggers = Triggers::in_sigmas(cell.config, &noise);
    let stage = cell.log.stage();
    cell.log.note(&serde_json::json!({ "stage": stage, "noise": noise, "triggers": cell.triggers }));
    cell.triggers.check(&noise)?;
    Ok(Some(noise))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::erfc;
    use gelstereo_core::math::random::Stream;
    use proptest::prelude::*;

    proptest! {
        /// One frame in ten may be any outlier: the scale of the rest is found within a factor of three.
        #[test]
        fn the_scale_is_robust(
            noise in prop::collection::vec(-1.0..1.0_f64, 31),
            outliers in prop::collection::vec(-100.0..100.0_f64, 3),
        ) {
            let clean = RestNoise::of(noise.iter().map(|n| 5.0 + n).collect());
            let mixed = RestNoise::of(noise.iter().chain(&outliers).map(|n| 5.0 + n).collect());
            prop_assume!(clean.sigma_px > 0.2);
            let ratio = mixed.sigma_px / clean.sigma_px;
            prop_assert!((1.0 / 3.0..3.0).contains(&ratio), "{clean:?} {mixed:?}");
            prop_assert!((mixed.level_px - clean.level_px).abs() <= 1.0);
        }

        #[test]
        fn triggers_below_the_bound_are_refused(sigmas in 0.0..20.0_f64, sigma_px in 0.001..1.0_f64) {
            let noise = RestNoise { level_px: 0.3, sigma_px, frames: FRAMES };
            let triggers = Triggers { grasp_px: 1e9, insertion_px: noise.at(sigmas) };
            let bound = (sigmas - MIN_SIGMAS).abs() > 1e-9;
            prop_assume!(bound);
            prop_assert_eq!(triggers.check(&noise).is_ok(), sigmas > MIN_SIGMAS);
        }
    }

    #[test]
    fn images_without_noise_give_no_trigger() {
        let noise = RestNoise::of(vec![0.0; FRAMES]);
        assert!(Triggers { grasp_px: 10.0, insertion_px: 5.0 }.check(&noise).is_err());
    }

    /// Rates that the settings state, per hour at 30 Hz, of normal noise. Each is the mean over rest stages.
    #[test]
    fn the_stated_false_alarm_rates_hold() {
        let (rests, mut stream) = (20_000, Stream::new(7, "rest"));
        let stated = [(7.3, 0.17), (8.0, 0.055), (10.0, 0.0025)];
        let mut found = [0.0; 3];
        for _ in 0..rests {
            let noise = RestNoise::of((0..FRAMES).map(|_| 1.0 + 0.01 * stream.normal()).collect());
            for (sum, (sigmas, _)) in found.iter_mut().zip(stated) {
                let z = (noise.at(sigmas) - 1.0) / 0.01;
                *sum += 30.0 * 3600.0 * 0.5 * erfc(z * core::f64::consts::FRAC_1_SQRT_2) / f64::from(rests);
            }
        }
        for (found, (sigmas, per_hour)) in found.into_iter().zip(stated) {
            // Few rests with small scales give most of the mean: its relative error is a third.
            let ratio = found / per_hour;
            assert!((0.5..2.0).contains(&ratio), "{sigmas} sigmas: {found} per hour, stated {per_hour}");
        }
    }
}
