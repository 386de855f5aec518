//! What a pose is refined and judged by.
//!
//! Two implementations: distances from the part ([`super::distance_objective`]), and the gel that a pose
//! predicts ([`super::gel::objective`]). Search, alternatives and assessment are the same for both.

use super::candidate::{Candidate, End};
use super::refine::RefineScratch;
use super::state::{Problem, Search};
use crate::register::Observability;
use crate::register::surface::gel::rest::GelDecay;
use crate::register::verdict::MeanSquare;

/// Poses whose log-likelihood is lower than the best one's by this are dropped.
pub(super) const HOPELESS: f64 = 12.0;
/// Number of candidates that are refined to convergence.
pub(super) const FINALISTS: usize = 3;

/// Refinement stages of a pose after the best one: on the field, first steps on the exact surface, and to
/// convergence.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Field,
    First,
    Last,
}

/// Evidence of the markers for a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Odds {
    /// ln P(markers | part at the pose) - ln P(markers | something else), with equal priors. Points count
    /// as independent, so values far from 0 are overconfident.
    pub log: f64,
    /// Whether the gel beside the part follows its model.
    pub is_law_kept: bool,
}

/// A model of the contact. "The pose read last" is that of [`Self::read`], or the best one after a ranking.
pub(super) trait Objective {
    /// Takes a pose through a stage.
    fn refine(&mut self, search: &mut Search<'_>, one: &mut Candidate, stage: Stage) -> End;

    /// Reads a pose, and sets its cost.
    fn read(&mut self, search: &mut Search<'_>, one: &mut Candidate);

    /// Distances at the pose read last.
    fn distances(&self) -> &RefineScratch;

    /// The log evidence ratio at the pose read last, before the correction for the search.
    fn odds(&self, problem: &Problem<'_>) -> Odds;

    /// Determined and free directions at the pose read last, in the object's frame. `converged` is whether
    /// its steps did.
    fn observe(&mut self, problem: &Problem<'_>, read: &Candidate, converged: bool) -> Observability;

    /// Ratio of the pose's variances to those of independent noise.
    fn excess(&self, problem: &Problem<'_>) -> f64;

    /// Residuals of the markers that should be in contact, if the model tests them.
    fn misfit(&self, problem: &Problem<'_>) -> Option<MeanSquare>;

    /// The decay length that explains the contact best, if the model has one.
    fn gel_decay(&self, problem: &Problem<'_>, best: &Candidate) -> Option<GelDecay>;
}
