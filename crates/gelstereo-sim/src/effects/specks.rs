//! Dirt on the gel.

use crate::plan::{Bound, Effect, Facts};
use crate::render::Dot;
use crate::scene::{Gel, SceneError};
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::{DVec2, DVec3, random::Stream};
use gelstereo_core::params::PrintLayout;

/// Round specks of dust between the dots, as dark as the dots. They are fixed to the gel and move with
/// it.
///
/// In a file: `[effects.specks] count = 8`. Each lies near the middle of a lattice cell, or of three markers
/// of a hexagonal print, so it touches no dot of ordinary size.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Specks {
    /// Number of specks. Default: `5`.
    pub count: usize,
    /// Smallest and largest radius; radii are uniformly distributed between them. Default: `[0.06, 0.2]` mm.
    pub radius_mm: [f64; 2],
}

impl Default for Specks {
    fn default() -> Self {
        Self { count: 5, radius_mm: [0.06, 0.2] }
    }
}

impl Effect for Specks {
    fn validate(&self, gel: &Gel) -> Result<(), SceneError> {
        let check = SceneError::check;
        let (count, [min_mm, max_mm]) = (self.count, self.radius_mm);
        check(count <= 10_000, "effects.specks.count", count as f64, "0 to 10000")?;
        let name = "effects.specks.radius_mm";
        check(min_mm > 0.0 && min_mm <= max_mm, name, min_mm, "above 0, the smaller one first")?;
        check(max_mm <= 0.5 * gel.least_pitch_mm(), name, max_mm, "at most half of gel.pitch_mm")
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        Bound::of_levels(if self.count > 0 { facts.contrast_levels() } else { 0.0 })
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        let _ = facts;
        3.0e3 * self.count as f64
    }
}

/// A speck's place on the gel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Speck {
    /// The marker at the upper left of its cell.
    corner: usize,
    /// Offset from that marker along the row and along the column, in pitches.
    within: DVec2,
    radius_mm: f64,
}

/// Largest distance of a speck from its cell's middle, in pitches along each axis.
const OFF_MIDDLE: f64 = 0.12;

impl Speck {
    pub(crate) fn all(specks: &Specks, seed: u64, gel: &Gel) -> Vec<Self> {
        let mut stream = Stream::new(Digest::new().u64(seed).value(), "specks");
        let speck = |_| {
            let (row, col) = (stream.below(gel.rows - 1), stream.below(gel.cols - 1));
            let (off_middle, aside) = between_three(gel, row).unwrap_or((OFF_MIDDLE, DVec2::ZERO));
            let mut within = || 0.5 + off_middle * (2.0 * stream.uniform() - 1.0);
            let within = DVec2::new(within(), within()) + aside;
            let [min_mm, max_mm] = specks.radius_mm;
            let radius_mm = min_mm + (max_mm - min_mm) * stream.uniform();
            Self { corner: row * gel.cols + col, within, radius_mm }
        };
        (0..specks.count).map(speck).collect()
    }

    /// The speck on the surface between the four markers of its cell.
    pub(crate) fn dot(&self, points_mm: &[DVec3], gel: &Gel) -> Dot {
        let at = |row: usize, col: usize| points_mm[self.corner + row * gel.cols + col];
        let (s, t) = (self.within.x, self.within.y);
        let (top, bottom) = (at(0, 1) - at(0, 0), at(1, 1) - at(1, 0));
        let (left, right) = (at(1, 0) - at(0, 0), at(1, 1) - at(0, 1));
        let [along, across] = gel.spacing_mm().map(|mm| self.radius_mm / mm);
        let (row_step, slanted) = (top.lerp(bottom, t), left.lerp(right, s));
        let down = match lean(gel, self.corner / gel.cols) {
            Some(lean) => slanted - row_step * lean,
            None => slanted,
        };
        Dot {
            centre: at(0, 0) + top * s + left * t + (bottom - top) * (s * t),
            along: row_step * along,
            across: down * across,
        }
    }
}

/// Pitches along a row to the same column of the next row, in a hexagonal print.
fn lean(gel: &Gel, row: usize) -> Option<f64> {
    let to_odd = if gel.odd_rows_forward { 0.5 } else { -0.5 };
    (gel.layout == PrintLayout::Hexagonal).then_some(if row.is_multiple_of(2) { to_odd } else { -to_odd })
}

/// In a hexagonal print, a speck lies between three markers: half as far from their middle, and this much
/// beside the middle of the cell, in pitches. Two of the markers are in the upper row; the third one is in
/// the left column where rows lean to the right.
fn between_three(gel: &Gel, row: usize) -> Option<(f64, DVec2)> {
    let sixth = 1.0 / 6.0;
    lean(gel, row).map(|lean| (0.5 * OFF_MIDDLE, DVec2::new(-2.0 * lean * sixth, -sixth)))
}
