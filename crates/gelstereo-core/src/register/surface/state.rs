//! Input of a search, and the work that it has spent.

use super::candidate::{Candidate, End};
use super::coarse::View;
use super::contact::Samples;
use super::distances::{Coarse, Exact};
use super::normal_system::Prior;
use crate::math::DVec3;
use crate::params::RegisterParams;
use crate::register::Symmetry;
use crate::stop::Stop;

/// Largest number of steps of a pose on the exact surface.
const MAX_STEPS: u32 = 15;

/// A contact, a part and a guess.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub params: &'a RegisterParams,
    pub samples: &'a Samples,
    pub press_direction: DVec3,
    pub field: Coarse<'a>,
    pub faces: Exact<'a>,
    pub prior: Prior,
    pub stop: Stop<'a>,
    /// Declared symmetries: rotations that do not change the pose.
    pub symmetries: &'a [Symmetry],
    /// Rotations after which the part looks the same, declared or not.
    pub alike: &'a [Symmetry],
}

impl<'a> Problem<'a> {
    /// All points.
    pub fn whole(&self) -> View<'a> {
        View::of(self.samples, usize::MAX, usize::MAX, self.press_direction)
    }

    /// Largest number of steps of a pose to convergence.
    pub fn max_steps(&self) -> u32 {
        self.params.advanced.max_iterations.min(MAX_STEPS)
    }
}

/// Limits of a refinement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub max_steps: u32,
    /// No step is taken once this work is spent, in lookups of the field.
    pub max_work: u64,
}

/// A problem, and the work that has been spent on it.
pub(super) struct Search<'a> {
    pub problem: &'a Problem<'a>,
    pub work: u64,
    /// Work after which it stops: the budget, or a share of it for one phase.
    pub limit: u64,
}

impl<'a> Search<'a> {
    pub fn new(problem: &'a Problem<'a>) -> Self {
        Self { problem, work: 0, limit: u64::from(problem.params.surface_search.budget) }
    }

    pub fn has_spent(&self) -> bool {
        self.work >= self.limit || (self.problem.stop)()
    }

    pub fn left(&self) -> u64 {
        if (self.problem.stop)() { 0 } else { self.limit.saturating_sub(self.work) }
    }

    /// At most so many steps with the work that is left.
    pub fn limits(&self, max_steps: u32) -> Limits {
        Limits { max_steps, max_work: self.left() }
    }

    /// Takes candidates through a stage until the budget is spent; the first one always. Returns how many
    /// it took, and how the best of them ended.
    pub fn refine_each(
        &mut self,
        candidates: &mut [Candidate],
        mut refine: impl FnMut(&mut Self, &mut Candidate) -> End,
    ) -> (usize, End) {
        let mut best = (f64::INFINITY, End::NONE);
        for (k, one) in candidates.iter_mut().enumerate() {
            if k > 0 && self.has_spent() {
                return (k, best.1);
            }
            let end = refine(self, one);
            self.work += end.work;
            if one.cost < best.0 {
                best = (one.cost, end);
            }
        }
        (candidates.len(), best.1)
    }
}
