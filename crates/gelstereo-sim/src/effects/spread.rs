//! Sideways motion under a normal load.

use super::check_decay;
use crate::lattice::Lattice;
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, sqrt};

/// Gel that a part displaces moves sideways, away from the contact.
///
/// Model: the frictionless, incompressible layer bonded to its plate, whose surface moves sideways by 2x² /
/// (sinh 2x - 2x) of its height at wave number k = x / t (thickness t). That ratio is replaced by (3/2) x /
/// ((x² + 1/decay²) (1 + 0.3 x²)): the same 3 / (2x) at long waves (the displaced volume flows below a free
/// surface) and within 8 % up to x = 2, cut off where the gel's compressibility takes the volume up. In space
/// these are two screened membranes and a gradient. Limits: no friction, which holds the surface back within
/// the contact (`strength` does so everywhere); small strain; free sides of the lattice do not bulge.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Spread {
    /// Share of the frictionless, incompressible layer's motion, 0 to 1. Default: `1`: whether the part sticks
    /// or not, the displaced volume has to pass beside it.
    pub strength: f64,
    /// Distance over which the volume is taken up, in gel thicknesses. Default: `2`.
    pub decay_thicknesses: f64,
}

impl Default for Spread {
    fn default() -> Self {
        Self { strength: 1.0, decay_thicknesses: 2.0 }
    }
}

impl Effect for Spread {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let strength = self.strength;
        SceneError::check((0.0..=1.0).contains(&strength), "effects.spread.strength", strength, "0 to 1")?;
        check_decay("effects.spread.decay_thicknesses", self.decay_thicknesses)
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let sideways_mm = self.sideways_mm(facts);
        facts.moved(sideways_mm, facts.height_mm(sideways_mm))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        facts.relaxation_ns(sqrt(0.3)) + facts.relaxation_ns(self.decay_thicknesses)
    }

    /// The gradient of p, which solves p / l² - Δp = s for heights s between 0 and the part's depth that fill no more than
    /// the pressed area times that depth. It is at most depth / (2 l) whatever the footprint, and
    /// depth √(2 A) / (π^1.5 l²) for an area A all on one side, the kernel K1(r / l) / (2 π l³) being below 1 / (2 π l² r).
    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        let (gel, touch) = (&facts.scene.gel, &facts.touch);
        let length_mm = self.decay_thicknesses * gel.thickness_mm;
        let reach = length_mm / gel.pitch_mm;
        // On the lattice depth / (2 l) is depth / (pitch √(1 + 4 l²)) along each axis.
        let anywhere = core::f64::consts::SQRT_2 / (gel.pitch_mm * sqrt(1.0 + 4.0 * reach * reach));
        let pi = core::f64::consts::PI;
        // Free borders mirror the heights: up to four copies at a corner.
        let small = sqrt(2.0 * 4.0 * facts.pressed_mm2()) / (pi * sqrt(pi) * length_mm * length_mm);
        let gradient = touch.depth_mm * anywhere.min(small);
        self.strength * 1.5 / gel.thickness_mm * length_mm * length_mm * gradient
    }
}

impl Spread {
    /// Adds the sideways motion under these heights; the two fields are scratch.
    pub(crate) fn push(
        &self,
        lattice: &Lattice,
        heights: &[f64],
        [smooth, potential]: [&mut Vec<f64>; 2],
        motion: &mut [DVec2],
    ) {
        smooth.clear();
        smooth.extend_from_slice(heights);
        lattice.relax(sqrt(0.3) * lattice.thickness_mm, smooth, |i| heights[i], |_, h| h);
        let length = self.decay_thicknesses * lattice.thickness_mm;
        potential.clear();
        potential.extend_from_slice(smooth);
        lattice.relax(length, potential, |i| smooth[i], |_, p| p);
        // p / l² - Δp = smooth is solved for p / l².
        let scale = -self.strength * 1.5 / lattice.thickness_mm * length * length;
        for (i, u) in motion.iter_mut().enumerate() {
            *u += lattice.gradient(potential, i) * scale;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Gel;
    use core::f64::consts::{E, PI};
    use gelstereo_core::math::{cos, pow};

    /// The whole chain on one cosine, which the lattice keeps: its transfer at wave number k against the
    /// layer's.
    #[test]
    fn a_cosine_spreads_as_on_the_incompressible_layer() {
        let gel = Gel { rows: 2, cols: 160, pitch_mm: 0.25, ..Gel::default() };
        let lattice = Lattice::new(&gel);
        // Half waves over 40 mm; x = k t is 0.79 to 1.96. The screen at 4 thicknesses takes 1/16 off x² = 0.6.
        let spread = Spread { strength: 1.0, decay_thicknesses: 4.0 };
        for half_waves in [2.0, 3.0, 5.0] {
            let k = half_waves * PI / 40.0;
            let heights: Vec<f64> = (0..320).map(|i| cos(k * 0.25 * ((i % 160) as f64 + 0.5))).collect();
            let mut motion = [DVec2::ZERO; 320];
            spread.push(&lattice, &heights, [&mut Vec::new(), &mut Vec::new()], &mut motion);
            let steepest = (0.5 * 40.0 / half_waves / 0.25) as usize;
            let x = k * 5.0;
            let layer = 2.0 * x * x / (0.5 * (pow(E, 2.0 * x) - pow(E, -2.0 * x)) - 2.0 * x);
            let screen = x * x / (x * x + 1.0 / 16.0);
            // 8 % for the rational function, 1 % for the lattice (k pitch is below 0.1).
            let ratio = motion[steepest].x / (layer * screen);
            assert!((ratio - 1.0).abs() < 0.09, "x = {x}: {ratio}");
            assert!(motion[steepest].y.abs() < 1e-4, "nothing spreads across");
        }
    }
}
