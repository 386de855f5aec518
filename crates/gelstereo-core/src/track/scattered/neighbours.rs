//! Neighbours of scattered markers at rest.

use crate::math::{DVec2, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Nearest neighbours of a marker: as many as a marker of a hexagonal print has.
const NEAREST: usize = 6;

/// Neighbours of every marker: its nearest ones, and those of which it is one of the nearest.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbours {
    /// Start of each marker in `items`, and the end of the last one.
    starts: Vec<u32>,
    items: Vec<u32>,
    /// Distance from the nearest neighbour, pixels.
    nearest_px: Vec<f64>,
}

impl Neighbours {
    pub fn new(rest_px: &[DVec2]) -> Self {
        let mut grid = Grid::default();
        grid.build_evenly(rest_px.iter().copied(), 0.0);
        let (mut both, mut nearest_px) = (Vec::new(), Vec::with_capacity(rest_px.len()));
        for (n, &place) in rest_px.iter().enumerate() {
            let nearest = grid.nearest_others::<NEAREST>(n, place, |m| rest_px[m].distance_squared(place));
            nearest_px.push(sqrt(nearest[0].0));
            for &(_, m) in nearest.iter().filter(|(px2, _)| px2.is_finite()) {
                both.extend([(n as u32, m), (m, n as u32)]);
            }
        }
        both.sort_unstable();
        both.dedup();
        let mut starts: Vec<u32> = Vec::with_capacity(rest_px.len() + 1);
        starts.extend((0..=rest_px.len()).map(|n| both.partition_point(|&(m, _)| (m as usize) < n) as u32));
        Self { starts, items: both.into_iter().map(|(_, m)| m).collect(), nearest_px }
    }

    pub fn of(&self, n: usize) -> impl Iterator<Item = usize> + Clone + '_ {
        self.items[self.starts[n] as usize..self.starts[n + 1] as usize].iter().map(|&m| m as usize)
    }

    /// Distance of a marker from its nearest neighbour, pixels.
    pub fn nearest_px(&self, n: usize) -> f64 {
        self.nearest_px[n]
    }

    /// Median of the distances from the nearest neighbour, pixels.
    pub fn spacing_px(&self) -> f64 {
        let mut sorted = self.nearest_px.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    }
}
