//! Sideways motion under a normal load.

use super::check_decay;
use crate::lattice::Lattice;
use crate::membrane::Membranes;
use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, exp};

/// Gel displaced by a part moves sideways, away from the contact.
///
/// Model: the frictionless, incompressible layer bonded to its plate, whose surface moves sideways by
/// 2x² / (sinh 2x - 2x) of its height at wave number k = x / t (thickness t). That ratio is replaced by
/// (3/2) x / ((x² + 1/decay²) (1 + 0.3 x²)). Both are 3 / (2x) at long waves (the displaced volume flows
/// below a free surface), and they agree within 8 % up to x = 2. The cut-off models the volume taken up
/// by the gel's compressibility. In space these are two screened membranes and a gradient. Limits: no
/// friction, which would hold the surface back within the contact (`strength` does so everywhere); small
/// strain; free sides of the lattice do not bulge.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Spread {
    /// Share of the frictionless, incompressible layer's motion. Valid: 0 to 1. Default: `1`: whether the
    /// part sticks or not, the displaced volume has to pass beside it. Lower it for a gel that is held at its
    /// sides.
    pub strength: f64,
    /// Distance over which the volume is taken up, in gel thicknesses. Valid: 0.01 to 4 thicknesses. Default:
    /// `2`. Lower it for a more compressible gel.
    pub decay_thicknesses: f64,
}

/// Membrane length for the factor (1 + 0.3 x²), in gel thicknesses: sqrt(0.3).
const SMOOTHING: f64 = 0.547_722_557_505_166_1;

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
        // Four matrix products, two numbers at once.
        let gel = &facts.scene.gel;
        facts.markers() * (60.0 + 1.7 * (gel.rows + gel.cols) as f64)
    }

    /// The gradient of p under heights between 0 and the part's depth. Integrated across its direction,
    /// the two membranes' kernel is g(x) = (l e^(-x/l) - s e^(-x/s)) / (2 (l² - s²)). Heights all on one
    /// side, over a width w, give depth (g(0) - g(w)). A free border mirrors them, which doubles the
    /// width. A tenth is added for the lattice's directions.
    fn sideways_mm(&self, facts: &Facts<'_>) -> f64 {
        let thickness_mm = facts.scene.gel.thickness_mm;
        let (long, short) = (self.decay_thicknesses * thickness_mm, SMOOTHING * thickness_mm);
        // Avoids a division by 0 for equal lengths; a longer one only widens the bound.
        let long = if (long - short).abs() < 0.01 * short { 1.01 * short } else { long };
        let kernel = |x: f64| {
            let tails = long * exp(-x / long) - short * exp(-x / short);
            tails / (2.0 * (long * long - short * short))
        };
        let gradient = facts.touch.depth_mm * (kernel(0.0) - kernel(2.0 * facts.pressed_mm()));
        1.1 * self.strength * 1.5 / thickness_mm * long * long * gradient
    }

    /// With p / l² - Δp = s, Δp lies between -s and p / l²; a second derivative may be twice that where
    /// s is smooth.
    fn stretch(&self, facts: &Facts<'_>) -> f64 {
        let steps = 2.0 * self.sideways_mm(facts) / facts.least_pitch_mm();
        steps.min(2.0 * self.strength * 1.5 / facts.scene.gel.thickness_mm * facts.touch.depth_mm)
    }
}

/// The effect on a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Spreading {
    membranes: Membranes,
    /// Sideways motion per gradient of the smoothed heights, mm².
    scale: f64,
}

impl Spreading {
    pub(crate) fn new(spread: &Spread, lattice: &Lattice) -> Self {
        let thickness_mm = lattice.thickness_mm;
        let length_mm = spread.decay_thicknesses * thickness_mm;
        let squares = [SMOOTHING * thickness_mm, length_mm].map(|mm| lattice.squared_pitches(mm));
        // The membranes solve p / l² - Δp = smooth for p / l².
        let scale = -spread.strength * 1.5 / thickness_mm * length_mm * length_mm;
        Self { membranes: Membranes::new([lattice.rows, lattice.cols], &squares), scale }
    }

    /// Adds the sideways motion under these heights; the two vectors are scratch.
    pub(crate) fn push(
        &self,
        lattice: &Lattice,
        heights: &[f64],
        [potential, scratch]: [&mut Vec<f64>; 2],
        motion: &mut [DVec2],
    ) {
        potential.clear();
        potential.extend_from_slice(heights);
        self.membranes.settle(potential, scratch);
        for (i, u) in motion.iter_mut().enumerate() {
            *u += lattice.gradient(potential, i) * self.scale;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Gel;
    use core::f64::consts::{E, PI};
    use gelstereo_core::math::{cos, pow};

    /// The whole chain on one cosine, an eigenfunction of the lattice: its transfer at wave number k
    /// against the layer's.
    #[test]
    fn a_cosine_spreads_as_on_the_incompressible_layer() {
        let gel = Gel { rows: 2, cols: 160, pitch_mm: 0.25.into(), ..Gel::default() };
        let lattice = Lattice::new(&gel);
        // Half waves over 40 mm; x = k t is 0.79 to 1.96. The screening at 4 thicknesses adds 1/16 to x²
        // = 0.6.
        let spread = Spread { strength: 1.0, decay_thicknesses: 4.0 };
        for half_waves in [2.0, 3.0, 5.0] {
            let k = half_waves * PI / 40.0;
            let heights: Vec<f64> = (0..320).map(|i| cos(k * 0.25 * ((i % 160) as f64 + 0.5))).collect();
            let mut motion = [DVec2::ZERO; 320];
            Spreading::new(&spread, &lattice).push(
                &lattice,
                &heights,
                [&mut Vec::new(), &mut Vec::new()],
                &mut motion,
            );
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
