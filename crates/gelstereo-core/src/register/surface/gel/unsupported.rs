//! Salient markers beside the part that are not in contact, found from the gel alone.

use super::model::Gel;
use alloc::vec::Vec;
use core::mem::swap;

/// Smoothing passes, each the mean of a marker and its neighbours' mean. With a decay length of 2.5
/// pitches a pressure has 29 times the noise of a marker, after two passes 6 times: 0.2 mm for a marker
/// noise of 0.03 mm.
const PASSES: u32 = 2;
/// Pressure over height below which a marker is free. On a flat part both are equal; beside it the
/// pressure is zero.
const PRESSED: f64 = 0.5;

/// Buffers reused between runs.
#[derive(Clone, Debug, Default)]
pub(in crate::register::surface) struct Pressures {
    heights_mm: Vec<f64>,
    here_mm: Vec<f64>,
    there_mm: Vec<f64>,
}

impl Pressures {
    /// Passes the index of every marker without pressure to `tell`. The pressure, per stiffness, is
    /// p = h - l² Δh over springs joined by a shear layer (Pasternak 1954), with the nominal decay length.
    pub fn each_free(&mut self, gel: &Gel, radius_mm: f64, mut tell: impl FnMut(usize)) {
        let Self { heights_mm, here_mm, there_mm } = self;
        let stiffness = gel.stiffness(0.0);
        let [level, along_u, along_v] = gel.rest_plane(radius_mm);
        let over_rest = |node: &super::lattice::Node| {
            let [u, v] = (node.across_mm / radius_mm).to_array();
            node.along_mm - level - along_u * u - along_v * v
        };
        heights_mm.clear();
        heights_mm.extend(gel.nodes.iter().map(over_rest));
        here_mm.clear();
        here_mm.extend(heights_mm.iter().enumerate().map(|(k, &height)| {
            height - stiffness * gel.near(k).map(|j| heights_mm[j] - height).sum::<f64>()
        }));
        for _ in 0..PASSES {
            there_mm.clear();
            there_mm.extend(here_mm.iter().enumerate().map(|(k, &own)| {
                let (sum, count) =
                    gel.near(k).fold((0.0, 0.0), |(sum, count), j| (sum + here_mm[j], count + 1.0));
                if count > 0.0 { 0.5 * (own + sum / count) } else { own }
            }));
            swap(here_mm, there_mm);
        }
        for ((node, pressure_mm), height_mm) in gel.nodes.iter().zip(&*here_mm).zip(&*heights_mm) {
            if *pressure_mm < PRESSED * height_mm {
                tell(node.index);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use crate::math::random::Stream;
    use crate::register::surface::gel::lattice::Sweeps;
    use crate::register::surface::point::Sample;

    const SIDE: i32 = 21;
    const PITCH_MM: f64 = 0.9;
    const SIGMA_MM: f64 = 0.03;

    fn gel_of(heights_mm: &[f64]) -> Gel {
        let place = |k: usize| {
            let (row, col) = (k as i32 / SIDE - SIDE / 2, k as i32 % SIDE - SIDE / 2);
            DVec3::new(f64::from(col) * PITCH_MM, f64::from(row) * PITCH_MM, -heights_mm[k])
        };
        let markers = (0..heights_mm.len()).map(|k| Sample::new(place(k), [SIGMA_MM * SIGMA_MM; 6]));
        let mut gel = Gel::default();
        gel.fill(markers, heights_mm.len(), DVec3::NEG_Z, 2.5, 1.0);
        gel
    }

    /// A flat punch of 7 x 7 markers, 1 mm deep, and the gel beside it.
    #[test]
    fn the_shoulder_of_a_punch_hangs_and_what_lies_under_it_does_not() {
        let level = alloc::vec![0.0; (SIDE * SIDE) as usize];
        let off = |index: usize| {
            let (row, col) = (index as i32 / SIDE - SIDE / 2, index as i32 % SIDE - SIDE / 2);
            row.abs().max(col.abs()) - 3
        };
        let is_under = |index: usize| off(index) <= 0;
        let gel = gel_of(&level);
        let obstacle = |index: usize| if is_under(index) { 1.0 } else { f64::NEG_INFINITY };
        let obstacle_mm: Vec<f64> = gel.nodes.iter().map(|node| obstacle(node.index)).collect();
        let mut heights_mm = alloc::vec![0.0; obstacle_mm.len()];
        let mut sweeps = Sweeps::default();
        gel.lay_out(&mut sweeps);
        gel.settle(gel.stiffness(0.0), 500, &obstacle_mm, &mut heights_mm, &mut sweeps);
        let mut random = Stream::new(1, "hanging");
        let mut noisy = level;
        let mut is_salient = alloc::vec![false; noisy.len()];
        for (node, height_mm) in gel.nodes.iter().zip(&heights_mm) {
            noisy[node.index] = height_mm + SIGMA_MM * random.normal();
            is_salient[node.index] = *height_mm > 0.35;
        }
        let mut is_free = alloc::vec![false; noisy.len()];
        Pressures::default().each_free(&gel_of(&noisy), 3.0, |index| is_free[index] = true);
        let count = |wanted: &dyn Fn(usize) -> bool| (0..noisy.len()).filter(|&k| wanted(k)).count();
        let touching = count(&|k| is_under(k) && !is_free[k]);
        // The row next to the punch has a share of its pressure. Two rows off the gel is 0.45 mm high,
        // and 0.22 mm is 1.3 times the noise of a pressure: nine of ten are below it.
        let beside = count(&|k| is_salient[k] && off(k) > 1);
        let hanging = count(&|k| is_salient[k] && off(k) > 1 && is_free[k]);
        assert!(
            touching == 49 && beside > 20 && 3 * hanging > 2 * beside,
            "{touching}, {hanging} of {beside}"
        );
    }
}
