//! What a search works with, and what it has spent.

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
/// Finalists whose likelihood is less than that of the best by this, in logarithms, are not polished on.
pub(super) const HOPELESS: f64 = 12.0;

/// The steps of a pose that comes after the best one: on the field, the first on the exact surface, and to the end.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Field,
    First,
    Last,
}

/// What a search works with.
pub(super) struct Search<'a> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub press_direction: DVec3,
    pub field: Coarse<'a>,
    pub faces: Exact<'a>,
    pub prior: Prior,
    pub stop: Stop<'a>,
    pub work: u64,
    /// Work after which it stops: the budget, or a part's share of it.
    pub limit: u64,
    /// Whether the answer is that of the gel.
    pub is_settled: bool,
    /// Whether other answers may be missing among those that are left.
    pub is_cut: bool,
    /// Where readings are those of the answer, if that is not itself: the part looks the same there.
    pub read_at: Option<Placement>,
    /// Turns that are declared to make no other pose.
    pub symmetries: &'a [Symmetry],
    /// Turns after which the part looks the same, declared or not.
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
