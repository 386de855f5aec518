//! The registration stage.

use super::error::{MIN_PATCH, RegisterError};
use super::registration::Registration;
use super::surface::{self, Contact, Misfit, Rung};
use super::template::Template;
use super::{copies, half_turns, limits, paper};
use crate::math::{DVec3, Pose};
use crate::params::{RegisterMethod, RegisterParams};
use crate::stop::{NEVER, Stop};

/// The registration stage and its scratch memory.
#[derive(Clone, Debug)]
pub struct Registrar {
    params: RegisterParams,
    scratch: paper::Scratch,
    surface: surface::SurfaceScratch,
}

impl Registrar {
    /// With these settings.
    #[must_use]
    pub fn new(params: &RegisterParams) -> Self {
        Self {
            params: params.clone(),
            scratch: paper::Scratch::default(),
            surface: surface::SurfaceScratch::default(),
        }
    }

    /// The settings.
    #[must_use]
    pub const fn params(&self) -> &RegisterParams {
        &self.params
    }

    /// Changes the settings and keeps the memory; results are those of a new stage.
    pub fn set_params(&mut self, params: &RegisterParams) {
        self.params.clone_from(params);
    }

    /// Registers a patch of salient points (sensor frame) to the template, from a guess.
    ///
    /// Does not allocate once a patch as large has been seen. The same input gives the same bits.
    ///
    /// # Errors
    /// [`RegisterError`].
    pub fn run(
        &mut self,
        points_mm: &[DVec3],
        template: &Template,
        guess: &Pose,
    ) -> Result<Registration, RegisterError> {
        self.register(&Contact::new(points_mm), template, guess)
    }

    /// As [`Self::run`], with all measurements of the contact.
    ///
    /// # Errors
    /// [`RegisterError`].
    pub fn register(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        guess: &Pose,
    ) -> Result<Registration, RegisterError> {
        self.register_unless(contact, template, guess, NEVER)
    }

    /// As [`Self::register`], unless it is stopped.
    ///
    /// # Errors
    /// [`RegisterError`]; [`RegisterError::Stopped`] leaves no side effects.
    pub fn register_unless(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        guess: &Pose,
        stop: Stop<'_>,
    ) -> Result<Registration, RegisterError> {
        let rung = match self.params.method {
            RegisterMethod::FilterregPoint | RegisterMethod::RansacIcp => None,
            RegisterMethod::SurfaceClose => Some(Rung::Close),
            RegisterMethod::SurfaceSearch => Some(Rung::Search),
        };
        self.register_by(rung, contact, template, guess, stop)
    }

    /// As [`Self::register_unless`], by a rung on the surface, or by the configured method on samples.
    pub(super) fn register_by(
        &mut self,
        rung: Option<Rung>,
        contact: &Contact<'_>,
        template: &Template,
        guess: &Pose,
        stop: Stop<'_>,
    ) -> Result<Registration, RegisterError> {
        self.params.validate()?;
        let points_mm = contact.points_mm;
        let guess = check(points_mm, guess)?;
        let offset_sigma_mm = contact.offset_sigma_mm;
        if !(0.0..=limits::REACH_MM).contains(&offset_sigma_mm) {
            return Err(RegisterError::Offset { found_mm: offset_sigma_mm });
        }
        let Self { params, scratch, surface } = self;
        // Normals are read at samples, hence up to half a spacing away.
        let by_samples_mm = params.point_sigma_mm.max(0.5 * template.spacing_mm());
        let (mut found, resolution_mm) = match rung {
            None => {
                let problem = &paper::Problem { params, points_mm, template, stop };
                (paper::run(problem, scratch, &guess)?, by_samples_mm)
            }
            Some(rung) => {
                let input = surface::Input { params, contact, template, guess: &guess, stop };
                let mut found = surface::run(&input, rung, surface)?;
                if rung == Rung::Search {
                    half_turns::check(&input, &mut found, surface)?;
                }
                (found, params.point_sigma_mm)
            }
        };
        copies::honour(&mut found, template.symmetries(), &guess, resolution_mm);
        if offset_sigma_mm > 0.0 {
            found.observability = found.observability.with_offset(contact.press_direction, offset_sigma_mm);
        }
        Ok(found)
    }

    /// Deviation of the markers from the gel model at a pose of a registered contact. Stops as soon as it
    /// is typical, otherwise takes all steps. `None` if unknown: not all markers are given, the part has
    /// holes, or the gel returns to rest within a pitch.
    pub(super) fn misfit(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        t_sensor_object: &Pose,
        usual: Option<&surface::UsualResiduals>,
    ) -> Option<Misfit> {
        let params = &self.params;
        let input = surface::Input { params, contact, template, guess: t_sensor_object, stop: NEVER };
        surface::misfit(&input, usual, &mut self.surface)
    }
}

/// Rejects invalid input; returns the normalised guess.
fn check(points_mm: &[DVec3], guess: &Pose) -> Result<Pose, RegisterError> {
    let far = |v: &DVec3| !v.is_finite() || v.abs().max_element() > limits::REACH_MM;
    if let Some(index) = points_mm.iter().position(far) {
        return Err(RegisterError::PointNotFinite { index });
    }
    if points_mm.len() < MIN_PATCH {
        return Err(RegisterError::TooFewPoints { found: points_mm.len(), min_points: MIN_PATCH });
    }
    if far(&guess.translation_mm) {
        return Err(RegisterError::BadGuess);
    }
    guess.normalized().map_err(|_| RegisterError::BadGuess)
}
