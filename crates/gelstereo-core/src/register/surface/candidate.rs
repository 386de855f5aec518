//! A candidate pose, and the outcome of its refinement.

use super::gel::rest::Rest;
use super::normal_system::Placement;

/// A candidate pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub placement: Placement,
    /// Gel parameters, if the gel model is used.
    pub rest: Rest,
    /// Slot of its kept prediction, if the gel model is used.
    pub slot: usize,
    /// Lower is better; comparable within a round.
    pub cost: f64,
}

impl Candidate {
    pub fn at(placement: Placement) -> Self {
        Self { placement, rest: Rest::UNKNOWN, slot: 0, cost: f64::INFINITY }
    }
}

/// Outcome of the refinement of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    pub converged: bool,
    pub iterations: u32,
    pub work: u64,
}

impl End {
    /// Before the first step.
    pub const NONE: Self = Self { converged: false, iterations: 0, work: 0 };
}
