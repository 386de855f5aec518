//! A pose in the running, and where its refinement ended.

use super::gel::rest::Rest;
use super::normal_system::Placement;

/// A pose in the running.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub placement: Placement,
    /// Of the gel, where it is asked.
    pub rest: Rest,
    /// Which of the kept predictions is its own, where the gel is asked.
    pub slot: usize,
    /// The lower the better; comparable within a round.
    pub cost: f64,
}

impl Candidate {
    pub fn at(placement: Placement) -> Self {
        Self { placement, rest: Rest::UNKNOWN, slot: 0, cost: f64::INFINITY }
    }
}

/// Where the refinement of a pose ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    pub converged: bool,
    pub iterations: u32,
    pub work: u64,
}
