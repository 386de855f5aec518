//! How deep a part is in a curved gel.

use super::Simulator;
use crate::lattice::Lattice;
use crate::scene::Relief;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, Pose};

/// Places of the first search along a side, at most.
const MAX_PLACES: usize = 257;
/// The first places are a quarter of the pitch apart, and the last ones 2^-24 of that. Height is flat at its
/// highest, so that its error is below a nanometre.
const HALVINGS: usize = 24;
/// Steps to a neighbour at one distance.
const MAX_MOVES: usize = 64;

impl Simulator {
    /// Greatest height of a part above a curved skin at rest, over the lattice; `None` if it is beside it.
    pub(super) fn deepest_mm(&self, part: usize, t_sensor_object: &Pose, relief: &Relief) -> Option<f64> {
        let (lattice, gel) = (Lattice::new(&self.gel), &self.gel);
        let (centre_mm, mut parts) = (DVec2::from_array(gel.centre_mm), self.parts.clone());
        let (mut places, mut skin_mm, mut heights) = (Vec::new(), Vec::new(), Vec::new());
        let mut highest = |around: &mut dyn Iterator<Item = DVec2>| {
            places.clear();
            skin_mm.clear();
            let all: Vec<DVec2> = around.collect();
            places.extend(all.iter().map(|at| centre_mm + lattice.axes[0] * at.x + lattice.axes[1] * at.y));
            skin_mm.extend(all.iter().map(|&at| gel.surface_mm + relief.height_mm(at)));
            parts.heights(part, t_sensor_object, (&places, &skin_mm), &mut heights);
            let found = all.into_iter().zip(heights.iter().copied());
            found.reduce(|best, next| if next.1 > best.1 { next } else { best })
        };
        let half_mm = gel.half_mm();
        let [cols, rows] = [gel.cols, gel.rows].map(|count| (4 * (count - 1) + 1).min(MAX_PLACES));
        let mut step_mm = 2.0 * half_mm / DVec2::new((cols - 1) as f64, (rows - 1) as f64);
        let first = |i: usize| DVec2::new((i % cols) as f64, (i / cols) as f64) * step_mm - half_mm;
        let mut best = highest(&mut (0..rows * cols).map(first))?;
        for _ in 0..HALVINGS {
            for _ in 0..MAX_MOVES {
                let beside = |i: usize| {
                    let to = DVec2::new((i % 3) as f64 - 1.0, (i / 3) as f64 - 1.0);
                    (best.0 + to * step_mm).clamp(-half_mm, half_mm)
                };
                match highest(&mut (0..9).map(beside)).filter(|next| next.1 > best.1) {
                    Some(next) => best = next,
                    None => break,
                }
            }
            step_mm *= 0.5;
        }
        (best.1 > f64::NEG_INFINITY).then_some(best.1)
    }
}
