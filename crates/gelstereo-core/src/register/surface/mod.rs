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

/// Buffers of the surface rungs, reused between runs.
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
        // On a surface with holes it is unknown what the gel meets first.
        RegisterMethod::SurfaceSearch if solid.is_closed() => Extent::Gel,
        _ => Extent::Around,
    };
    let unpressed_mm = if extent == Extent::Salient { &[] } else { contact.unpressed_mm };
    let ordered = raster.ordered(&Contact { unpressed_mm, ..*contact }, params.advanced.gel_scale);
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
    // A stopped search counts its budget as spent, and its result is not valid.
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

/// Deviation of the markers from the gel model at a pose, after the first step at which it is usual, or
/// after all steps. `None` where the gel is not known.
pub(super) fn misfit(
    params: &RegisterParams,
    (contact, template): (&Contact<'_>, &Template),
    t_sensor_object: &Pose,
    usual: Option<&UsualResiduals>,
    scratch: &mut SurfaceScratch,
) -> Option<Misfit> {
    template.touchable().filter(|(solid, ..)| solid.is_closed())?;
    let SurfaceScratch { raster, samples, settled, .. } = scratch;
    samples.fill(&raster.ordered(contact, params.advanced.gel_scale), params, Extent::Gel);
    if !samples.gel.is_known() {
        return None;
    }
    let search = searching(params, (contact.press_direction, samples), template, t_sensor_object, NEVER)?;
    Some(search.misfit(usual, settled))
}

/// Initial state of a search.
fn searching<'a>(
    params: &'a RegisterParams,
    (press_direction, samples): (DVec3, &'a Samples),
    template: &'a Template,
    guess: &Pose,
    stop: Stop<'a>,
) -> Option<Search<'a>> {
    let (solid, field, relief) = template.touchable()?;
    let field = Coarse { field, gel_scale: params.advanced.gel_scale };
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
        limit: u64::from(params.surface_search.budget),
        is_settled: false,
        is_cut: false,
        read_at: None,
        symmetries: template.symmetries(),
        alike: &template.alike,
    })
}

/// Refuses a patch with too few points near the part at the guess.
fn check_reach(
    search: &Search<'_>,
    solid: &crate::surface::Solid,
    params: &RegisterParams,
) -> Result<(), RegisterError> {
    let reach_mm = params.advanced.search_radius_mm + multi_start::REACH * params.start_sigma_mm;
    let placed = || search.samples.pressed.iter().map(|s| search.prior.guess.object_point(s.p_mm));
    // The field covers its own reach and one cell.
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
