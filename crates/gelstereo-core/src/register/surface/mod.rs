//! Registration on the part's own surface.

mod contact;
mod fit;
mod noise;
mod part;
mod polish;
mod relief;
mod search;
mod starts;
mod step;

pub use contact::Contact;
pub(super) use relief::Relief;

use super::{Outcome, RegisterError, Template};
use crate::math::Pose;
use crate::params::RegisterParams;
use alloc::vec::Vec;
use contact::Samples;
use search::{Candidate, Search};
use step::{Placement, Prior};

/// What the surface rungs keep from run to run.
#[derive(Clone, Debug, Default)]
pub(super) struct SurfaceScratch {
    samples: Samples,
    candidates: Vec<Candidate>,
    readings: [polish::Readings; 3],
    pub work: u64,
}

pub(super) fn run(
    params: &RegisterParams,
    contact: &Contact<'_>,
    template: &Template,
    guess: &Pose,
    scratch: &mut SurfaceScratch,
) -> Result<Outcome, RegisterError> {
    scratch.samples.fill(contact, params.point_sigma_mm);
    let centre = Pose::from_translation_mm(-scratch.samples.centre_mm);
    let prior = Prior {
        guess: Placement::new(centre * *guess),
        sigma_rad: params.start_sigma_deg.to_radians(),
        sigma_mm: params.start_sigma_mm,
    };
    let (solid, field, relief) = (template.solid().unwrap(), template.field().unwrap(), template.relief().unwrap());
    let mut search = Search {
        params,
        samples: &scratch.samples,
        press_direction: contact.press_direction,
        field,
        solid,
        relief,
        prior,
        work: 0,
    };
    let (converged, iterations) = search.run(&mut scratch.candidates, &mut scratch.readings);
    scratch.work = search.work;
    let best = scratch.candidates[0];
    let mut pose = best.placement.pose;
    pose.translation_mm += scratch.samples.centre_mm;
    Ok(Outcome { t_sensor_object: pose, converged, iterations })
}
