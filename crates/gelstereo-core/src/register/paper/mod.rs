//! The paper's rungs, on the template's samples: FilterReg and, for comparison, RANSAC with ICP
//! (section III-D).

mod assess;
mod facet;
mod filterreg;
mod icp;
mod problem;
mod ransac;
mod soft;

pub(super) use problem::{Problem, Scratch};
pub use soft::{SoftMatch, soft_match};

use super::error::RegisterError;
use super::registration::Registration;
use crate::math::Pose;
use crate::params::RegisterMethod;

/// Registers from the guess.
pub(super) fn run(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    guess: &Pose,
) -> Result<Registration, RegisterError> {
    let outcome = match problem.params.method {
        RegisterMethod::RansacIcp => {
            let start = ransac::search(problem, scratch, guess)?;
            icp::run(problem, scratch, &start)
        }
        _ => filterreg::run(problem, scratch, guess),
    }?;
    assess::registration(problem, scratch, &outcome)
}
