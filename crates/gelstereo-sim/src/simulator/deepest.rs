//! How deep a part is in a curved gel.

use super::Simulator;
use crate::lattice::Lattice;
use crate::scene::Relief;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, Pose};

/// Places of the first search along a side.
const PLACES: usize = 257;
/// The last places are 2^-24 of the first ones' distance apart. Below a smooth part, height is flat at its
/// highest, so that its error is below a nanometre.
const HALVINGS: usize = 24;
/// Steps to a neighbour at one distance.
const MAX_MOVES: usize = 64;

impl Simulator {
    /// Greatest height of a part above a curved skin at rest, over the lattice; `None` if it is beside it. At
    /// a sharp edge the search may end some micrometres below it.
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
        let mut step_mm = 2.0 * half_mm / (PLACES - 1) as f64;
        let first = |i: usize| DVec2::new((i % PLACES) as f64, (i / PLACES) as f64) * step_mm - half_mm;
        let mut best = highest(&mut (0..PLACES * PLACES).map(first))?;
        for _ in 0..HALVINGS {
            for _ in 0..MAX_MOVES {
                let beside = |i: usize| {
                    let to = DVec2::new((i % 5) as f64 - 2.0, (i / 5) as f64 - 2.0);
                    (best.0 + to * step_mm).clamp(-half_mm, half_mm)
                };
                match highest(&mut (0..25).map(beside)).filter(|next| next.1 > best.1) {
                    Some(next) => best = next,
                    None => break,
                }
            }
            step_mm *= 0.5;
        }
        (best.1 > f64::NEG_INFINITY).then_some(best.1)
    }
}
