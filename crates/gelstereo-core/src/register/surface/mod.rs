//! Registration on the part's own surface: distances to the triangles of its mesh, many starts screened on a field of
//! distances, and every marker used, also those that nothing presses.
//!
//! A salient point touches the part or hangs beside it, and no marker is within it ([`mixture`]). The pose is the most
//! likely one under that mixture, with the guess as a weak prior that keeps the directions which the contact leaves free
//! where they were guessed. Where all markers are known, the full search ends on what the gel does between them
//! ([`gel::fit`]). One start finds it from close by; from farther off many are needed, since threads, teeth
//! and edges each have a minimum of their own.

mod assess;
mod candidate;
mod coarse;
mod consistency;
mod contact;
mod distances;
mod evidence_ratio;
mod gel;
mod halving;
mod markers;
mod mixture;
mod modes;
mod multi_start;
mod normal_system;
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
use crate::math::{DVec3, Pose};
use crate::params::{RegisterMethod, RegisterParams};
use crate::stop::{NEVER, Stop, ask_often};
use alloc::vec::Vec;
use candidate::Candidate;
use contact::{Extent, Samples};
use distances::{Coarse, Exact};
use gel::prediction::GelFitScratch;
use normal_system::{Placement, Prior};
use refine::RefineScratch;
use scan_order::Raster;
use state::Search;

/// What the surface rungs keep from run to run.
#[derive(Clone, Debug, Default)]
pub(super) struct SurfaceScratch {
    raster: Raster,
    samples: Samples,
    candidates: Vec<Candidate>,
    runners_up: Vec<Candidate>,
    polish: RefineScratch,
    settled: GelFitScratch,
}

/// Registers by one of the surface rungs.
pub(super) fn run(
    params: &RegisterParams,
    (contact, template): (&Contact<'_>, &Template),
    guess: &Pose,
    scratch: &mut SurfaceScratch,
    stop: Stop<'_>,
) -> Result<Registration, RegisterError> {
    let (solid, ..) = template.touchable().ok_or(RegisterError::NoSurface)?;
    contact.check()?;
    let SurfaceScratch { raster, samples, candidates, runners_up, polish, settled } = scratch;
    let extent = match params.method {
        RegisterMethod::SurfaceTrack => Extent::Salient,
        RegisterMethod::SurfaceClose => Extent::Near,
        // What gel meets first of a surface with holes is not known.
        RegisterMethod::SurfaceSearch if solid.is_closed() => Extent::Gel,
        _ => Extent::Around,
    };
    let unpressed_mm = if extent == Extent::Salient { &[] } else { contact.unpressed_mm };
    let ordered = raster.ordered(&Contact { unpressed_mm, ..*contact }, params.gel_scale);
    samples.fill(&ordered, params, extent);
    let mut search = searching(params, (contact.press_direction, samples), template, guess, stop)
        .ok_or(RegisterError::NoSurface)?;
    check_reach(&search, solid, params)?;
    polish.begin(samples);
    let end = match params.method {
        RegisterMethod::SurfaceTrack => search.track(candidates, polish),
        RegisterMethod::SurfaceClose => search.close(candidates, polish),
        _ => search.many(candidates, runners_up, polish, settled),
    };
    // To a search that is stopped all the budget is spent, and its answer is none.
    if stop() {
        return Err(RegisterError::Stopped);
    }
    let placement = search.read_at.unwrap_or(candidates[0].placement);
    let read = Candidate { placement, ..candidates[0] };
    let told = search.is_settled.then(|| search.told(&read, end.converged, settled));
    let readings = (&*polish, &*settled, told);
    let mut found = assess::registration(params, samples, (candidates, &read), readings, end);
    found.alternatives = assess::alternatives(samples, candidates, search.is_cut);
    found.gel_decay = search.is_settled.then(|| candidates[0].rest.decay(contact.decay_mm));
    Ok(found)
}

/// How far markers are from what the gel does at a pose, after as few steps as make it usual, or else after all; and
/// whether it is after all. `None` where the gel is not known.
pub(super) fn misfit(
    params: &RegisterParams,
    (contact, template): (&Contact<'_>, &Template),
    t_sensor_object: &Pose,
    usual: Option<&UsualResiduals>,
    scratch: &mut SurfaceScratch,
) -> Option<Misfit> {
    template.touchable().filter(|(solid, ..)| solid.is_closed())?;
    let SurfaceScratch { raster, samples, settled, .. } = scratch;
    samples.fill(&raster.ordered(contact, params.gel_scale), params, Extent::Gel);
    if !samples.gel.is_known() {
        return None;
    }
    let search = searching(params, (contact.press_direction, samples), template, t_sensor_object, NEVER)?;
    Some(search.misfit(usual, settled))
}

/// What a search begins with.
fn searching<'a>(
    params: &'a RegisterParams,
    (press_direction, samples): (DVec3, &'a Samples),
    template: &'a Template,
    guess: &Pose,
    stop: Stop<'a>,
) -> Option<Search<'a>> {
    let (solid, field, relief) = template.touchable()?;
    let field = Coarse { field, gel_scale: params.gel_scale };
    let centred = Pose { translation_mm: guess.translation_mm - samples.centre_mm, ..*guess };
    Some(Search {
        params,
        samples,
        press_direction,
        field,
        faces: Exact { solid, relief, field },
        prior: Prior {
            guess: Placement::new(centred),
            sigma_rad: params.start_sigma_deg.to_radians(),
            sigma_mm: params.start_sigma_mm,
        },
        stop,
        work: 0,
        limit: u64::from(params.budget),
        is_settled: false,
        is_cut: false,
        read_at: None,
        symmetries: template.symmetries(),
        alike: &template.alike,
    })
}

/// Refuses a patch of which nothing is near the part at the guess.
fn check_reach(
    search: &Search<'_>,
    solid: &crate::surface::Solid,
    params: &RegisterParams,
) -> Result<(), RegisterError> {
    let reach_mm = params.search_radius_mm + multi_start::REACH * params.start_sigma_mm;
    let placed = || search.samples.pressed.iter().map(|s| search.prior.guess.object_point(s.p_mm));
    // What the field knows is within its own reach, and a cell.
    let field = search.field.field;
    let is_known = field.reach_mm() + field.cell_mm() <= reach_mm;
    let within =
        |x| (is_known && field.distance(x).is_some()) || solid.closest_within(x, reach_mm, None).is_some();
    let mut found = 0;
    for (step, x) in placed().enumerate() {
        ask_often(search.stop, step)?;
        found += usize::from(within(x));
        if found == MIN_PATCH {
            return Ok(());
        }
    }
    let (mut nearest_mm, within) = (f64::INFINITY, found);
    for (step, x) in placed().enumerate() {
        ask_often(search.stop, step)?;
        nearest_mm = nearest_mm.min(solid.closest(x).distance_mm.abs());
    }
    Err(RegisterError::OutOfReach { within, least: MIN_PATCH, nearest_mm, reach_mm })
}
