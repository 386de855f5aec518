//! Registration on the part's surface: distances to the triangles of its mesh, multi-start screening on a
//! distance field, and use of all markers, including unpressed ones.
//!
//! A salient point is in contact with the part or free beside it, and no marker is inside the part
//! ([`mixture`]). The pose is the most likely one under that mixture; the guess is a weak prior that
//! keeps the free directions where they were guessed. Where all markers are known, the full search ends
//! with a fit of the gel model ([`gel::fit`]). One start suffices close to the solution. Farther off many
//! are needed, since threads, teeth and edges each have a local minimum.

mod assess;
mod candidate;
mod coarse;
mod consistency;
mod contact;
mod distance_objective;
mod distances;
mod gel;
mod halving;
mod markers;
mod mixture;
mod modes;
mod multi_start;
mod normal_system;
mod objective;
mod point;
mod refine;
mod scan_order;
mod search;
mod single_start;
mod smooth_normals;
mod state;

pub use consistency::Misfit;
pub(super) use consistency::UsualResiduals;
pub use contact::Contact;
pub use gel::rest::GelDecay;
pub use markers::{check_among, unpressed, unpressed_for};
pub(super) use smooth_normals::Relief;

use super::error::MIN_PATCH;
use super::{RegisterError, Registration, Template};
use crate::math::Pose;
use crate::params::RegisterParams;
use crate::stop::{Stop, ask_often};
use crate::surface::Solid;
use candidate::Candidate;
use contact::{Extent, Samples};
use distance_objective::DistanceObjective;
use distances::{Coarse, Exact};
use gel::prediction::GelFitScratch;
use normal_system::{Placement, Prior};
use objective::Objective;
use refine::RefineScratch;
use scan_order::Raster;
use search::{Candidates, Outcome};
use state::{Problem, Search};

/// How a pose is found on the part's surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rung {
    /// One start on the exact surface.
    Close,
    /// Many starts, with the gel's model.
    Search,
}

impl Rung {
    fn extent(self, solid: &Solid) -> Extent {
        match self {
            Self::Close => Extent::Near,
            // On a surface with holes it is unknown what the gel meets first.
            Self::Search if solid.is_closed() => Extent::Gel,
            Self::Search => Extent::Around,
        }
    }
}

/// A contact and a part, with a guess of its pose.
#[derive(Clone, Copy)]
pub(super) struct Input<'a> {
    pub params: &'a RegisterParams,
    pub contact: &'a Contact<'a>,
    pub template: &'a Template,
    pub guess: &'a Pose,
    pub stop: Stop<'a>,
}

/// Buffers of the surface rungs, reused between runs.
#[derive(Clone, Debug, Default)]
pub(super) struct SurfaceScratch {
    raster: Raster,
    samples: Samples,
    candidates: Candidates,
    distances: RefineScratch,
    gel: GelFitScratch,
}

/// Registers by one of the surface rungs.
pub(super) fn run(
    input: &Input<'_>,
    rung: Rung,
    scratch: &mut SurfaceScratch,
) -> Result<Registration, RegisterError> {
    let SurfaceScratch { raster, samples, candidates, distances, gel } = scratch;
    let problem = input.checked(rung, raster, samples)?;
    distances.begin(problem.samples);
    let mut search = Search::new(&problem);
    match rung {
        Rung::Search => {
            search.screen(candidates);
            search.rank(candidates, distances, gel, |search, objective, candidates, end| {
                let outcome = search.alternatives(objective, candidates, end);
                concluded(&problem, objective, &candidates.best, outcome)
            })
        }
        Rung::Close => {
            let outcome = search.close(&mut candidates.best, distances);
            let objective = &mut DistanceObjective { scratch: distances };
            concluded(&problem, objective, &candidates.best, outcome)
        }
    }
}

/// Cost of the best start of a search after screening, and its work. Costs are comparable between guesses
/// for the same contact and part.
pub(super) fn screen(input: &Input<'_>, scratch: &mut SurfaceScratch) -> Result<(f64, u64), RegisterError> {
    let SurfaceScratch { raster, samples, candidates, .. } = scratch;
    let problem = input.checked(Rung::Search, raster, samples)?;
    let mut search = Search::new(&problem);
    let cost = search.screen(candidates);
    if (problem.stop)() { Err(RegisterError::Stopped) } else { Ok((cost, search.work)) }
}

/// The work of a search, and its best pose without alternatives. No pose if the cost of the best start
/// after screening exceeds a limit.
pub(super) fn run_promising(
    input: &Input<'_>,
    max_screened_cost: f64,
    scratch: &mut SurfaceScratch,
) -> Result<(u64, Option<Registration>), RegisterError> {
    let SurfaceScratch { raster, samples, candidates, distances, gel } = scratch;
    let problem = input.checked(Rung::Search, raster, samples)?;
    let mut search = Search::new(&problem);
    if search.screen(candidates) > max_screened_cost {
        return Ok((search.work, None));
    }
    distances.begin(problem.samples);
    let found = search.rank(candidates, distances, gel, |search, objective, candidates, end| {
        let outcome = search.best_only(candidates, end);
        concluded(&problem, objective, &candidates.best[..1], outcome)
    })?;
    Ok((found.work, Some(found)))
}

/// The result, unless the search was stopped: it then counts its budget as spent, and its result is not
/// valid.
fn concluded(
    problem: &Problem<'_>,
    objective: &mut dyn Objective,
    found: &[Candidate],
    outcome: Outcome,
) -> Result<Registration, RegisterError> {
    if (problem.stop)() {
        return Err(RegisterError::Stopped);
    }
    Ok(assess::registration(problem, objective, found, outcome))
}

/// Deviation of the markers from the gel model at a pose, after the first step at which it is usual, or
/// after all steps. `None` where the gel is not known.
pub(super) fn misfit(
    input: &Input<'_>,
    usual: Option<&UsualResiduals>,
    scratch: &mut SurfaceScratch,
) -> Option<Misfit> {
    let Input { params, contact, template, .. } = *input;
    template.touchable().filter(|(solid, ..)| solid.is_closed())?;
    let SurfaceScratch { raster, samples, gel, .. } = scratch;
    samples.fill(&raster.ordered(contact, params.usual_pitch_mm()), params, Extent::Gel);
    if !samples.gel.is_known() {
        return None;
    }
    Some(consistency::misfit(&input.problem(samples)?, usual, gel))
}

impl<'a> Input<'a> {
    /// With the samples of its contact, if it can be registered.
    fn checked(
        &self,
        rung: Rung,
        raster: &mut Raster,
        samples: &'a mut Samples,
    ) -> Result<Problem<'a>, RegisterError> {
        let (solid, ..) = self.template.touchable().ok_or(RegisterError::NoSurface)?;
        self.contact.check()?;
        let usual_pitch_mm = self.params.usual_pitch_mm();
        samples.fill(&raster.ordered(self.contact, usual_pitch_mm), self.params, rung.extent(solid));
        let problem = self.problem(samples).ok_or(RegisterError::NoSurface)?;
        check_reach(&problem)?;
        Ok(problem)
    }

    /// With the samples of its contact. `None` without a surface.
    fn problem(&self, samples: &'a Samples) -> Option<Problem<'a>> {
        let Self { params, contact, template, guess, stop } = *self;
        let (solid, field, relief) = template.touchable()?;
        let field = Coarse { field, gel_scale: params.advanced.gel_scale };
        let centred = Pose { translation_mm: guess.translation_mm - samples.centre_mm, ..*guess };
        Some(Problem {
            params,
            samples,
            press_direction: contact.press_direction,
            field,
            faces: Exact { solid, relief, field },
            prior: Prior {
                guess: Placement::new(centred),
                sigma_rad: params.start_sigma_deg.to_radians(),
                sigma_mm: params.start_sigma_mm,
            },
            stop,
            symmetries: template.symmetries(),
            alike: &template.alike,
        })
    }
}

/// Refuses a patch with too few points near the part at the guess.
fn check_reach(problem: &Problem<'_>) -> Result<(), RegisterError> {
    let (params, solid) = (problem.params, problem.faces.solid);
    let reach_mm = params.advanced.search_radius_mm + multi_start::REACH * params.start_sigma_mm;
    let placed = || problem.samples.pressed.iter().map(|s| problem.prior.guess.object_point(s.p_mm));
    // The field covers its own reach and one cell.
    let field = problem.field.field;
    let is_known = field.reach_mm() + field.cell_mm() <= reach_mm;
    let within =
        |x| (is_known && field.distance(x).is_some()) || solid.closest_within(x, reach_mm, None).is_some();
    let mut found = 0;
    for (step, x) in placed().enumerate() {
        ask_often(problem.stop, step)?;
        found += usize::from(within(x));
        if found == MIN_PATCH {
            return Ok(());
        }
    }
    let (mut nearest_mm, within) = (f64::INFINITY, found);
    for (step, x) in placed().enumerate() {
        ask_often(problem.stop, step)?;
        nearest_mm = nearest_mm.min(solid.closest(x).distance_mm.abs());
    }
    Err(RegisterError::OutOfReach { within, min_points: MIN_PATCH, nearest_mm, reach_mm })
}
