//! Fit of one marker: start, steps and result.

use super::disc::{Levels, Outline};
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, sqrt};

/// Longest step.
const MAX_PX: f64 = 0.6;

/// Start of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Approximate centre, pixels.
    pub centre_px: DVec2,
    /// Matrix whose eigenvalues are the squares of the semi-axes, px²: r² on the diagonal for a circle.
    pub spread_px2: Symmetric<2>,
    /// Distance to the nearest other marker's centre, pixels, or infinity.
    pub neighbour_px: f64,
}

impl Start {
    /// Radius of the circle of the same area, pixels.
    #[must_use]
    pub fn radius_px(&self) -> f64 {
        let [[xx, xy], [_, yy]] = self.spread_px2;
        sqrt(sqrt((xx * yy - xy * xy).max(0.0)))
    }
}

/// A fitted marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// Centre of the ellipse, pixels.
    pub centre_px: DVec2,
    /// Its covariance, px².
    pub covariance_px2: Symmetric<2>,
    /// Matrix whose eigenvalues are the squares of the semi-axes, px².
    pub spread_px2: Symmetric<2>,
    /// Level of the dot minus that of the gel, grey levels.
    pub contrast_levels: f64,
}

/// Solves for the outline's step.
pub(super) fn step(factor: &Factor<5>, right: &[f64; 5], levels: &Levels) -> Option<[f64; 5]> {
    let step = factor.solve(right).map(|s| s / levels.contrast);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

/// Applies the step, shortened to the range where the model's slopes are valid; returns the outline's
/// shift, px.
pub(super) fn apply(outline: &mut Outline, step: &[f64; 5]) -> f64 {
    let [x, y, form @ ..] = *step;
    let moved_px = sqrt(x * x + y * y) + reshaped_px(outline, step);
    let share = (MAX_PX / moved_px).min(1.0);
    outline.centre += DVec2::new(x, y) * share;
    for (entry, change) in outline.form.iter_mut().zip(form) {
        *entry += change * share;
    }
    moved_px * share
}

/// How far a step's change of the form moves the outline.
pub(super) fn reshaped_px(outline: &Outline, &[_, _, xx, xy, yy]: &[f64; 5]) -> f64 {
    let changed = sqrt(xx * xx + 2.0 * xy * xy + yy * yy);
    let [xx, xy, yy] = outline.form;
    // r moves by r/2 per relative change of A, and r² is 2 / trace A for a circle.
    let part = changed / sqrt(xx * xx + 2.0 * xy * xy + yy * yy);
    0.5 * part * sqrt(2.0 / (xx + yy))
}

/// Whether the outline is still near its starting position and size.
pub(super) fn plausible(start: &Start, moved: DVec2, spread_px2: Option<Symmetric<2>>) -> bool {
    let Some([[xx, xy], [_, yy]]) = spread_px2 else { return false };
    let (area, trace) = (sqrt(xx * yy - xy * xy), xx + yy);
    let began = start.radius_px();
    // Half as wide to twice as wide; the longer axis at most four times the shorter.
    moved.length() <= 0.5 * began.max(2.0)
        && (0.25..=4.0).contains(&(area / (began * began)))
        && trace <= 4.25 * area
}

/// Inverse information of the centre, with the outline's other parameters unknown.
pub(super) fn covariance(factor: &Factor<5>, levels: &Levels, inflation: f64) -> Option<Symmetric<2>> {
    let scale = inflation / (levels.contrast * levels.contrast);
    let column = |k: usize| factor.solve(&core::array::from_fn(|i| f64::from(u8::from(i == k))));
    let (x, y) = (column(0), column(1));
    let xy = 0.5 * (x[1] + y[0]) * scale;
    let covariance = [[x[0] * scale, xy], [xy, y[1] * scale]];
    (covariance[0][0] > 0.0 && covariance[1][1] > 0.0).then_some(covariance)
}
