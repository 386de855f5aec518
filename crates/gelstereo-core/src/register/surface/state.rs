//! State of a search, and the work that it has spent.

use super::coarse::View;
use super::contact::Samples;
use super::distances::{Coarse, Distances, Exact};
use super::normal_system::{Placement, Prior};
use super::refine::{OUT_OF_REACH_MM, Refinement};
use crate::math::DVec3;
use crate::params::RegisterParams;
use crate::register::Symmetry;
use crate::stop::Stop;

/// Halvings of a step on the exact surface.
const HALVINGS: u32 = 4;
/// Finalists whose log-likelihood is lower than the best one's by this are dropped.
pub(super) const HOPELESS: f64 = 12.0;

/// Refinement stages of a pose after the best one: on the field, first steps on the exact surface, and to
/// convergence.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Field,
    First,
    Last,
}

/// Inputs and progress of a search.
pub(super) struct Search<'a> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub press_direction: DVec3,
    pub field: Coarse<'a>,
    pub faces: Exact<'a>,
    pub prior: Prior,
    pub stop: Stop<'a>,
    pub work: u64,
    /// Work after which it stops: the budget, or a share of it for one phase.
    pub limit: u64,
    /// Whether the result is that of the gel model.
    pub is_settled: bool,
    /// Whether alternatives may be missing from the result.
    pub is_cut: bool,
    /// Pose of the readings, if not that of the result: the part looks the same there.
    pub read_at: Option<Placement>,
    /// Declared symmetries: rotations that do not change the pose.
    pub symmetries: &'a [Symmetry],
    /// Rotations after which the part looks the same, declared or not.
    pub alike: &'a [Symmetry],
}

impl Search<'_> {
    /// All points.
    pub fn whole(&self) -> View<'_> {
        View::of(self.samples, usize::MAX, usize::MAX, self.press_direction)
    }

    pub fn has_spent(&self) -> bool {
        self.work >= self.limit || (self.stop)()
    }

    pub fn left(&self) -> u64 {
        if (self.stop)() { 0 } else { self.limit.saturating_sub(self.work) }
    }

    pub fn refine<D: Distances>(&self, part: D) -> Refinement<'_, D> {
        Refinement {
            params: self.params,
            samples: self.samples,
            view: self.whole(),
            field: self.field,
            part,
            prior: self.prior,
            stop: self.stop,
            reach_mm: self.params.scaled(OUT_OF_REACH_MM),
            halvings: HALVINGS,
            pushes_bluntly: false,
        }
    }
}
