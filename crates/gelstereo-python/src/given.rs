//! A contact as passed from Python, and what a registration can use of it.

use crate::arrays::Numbers;
use crate::errors::{RegisterError, raise};
use crate::frame::Frame;
use crate::interrupt::stoppable;
use crate::register::Gel;
use gelstereo_core::math::DVec3;
use gelstereo_core::params::RegisterMethod;
use gelstereo_core::pipeline::Touch;
use gelstereo_core::register as core;
use gelstereo_core::stop::Stop;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use serde::{Deserialize, Serialize};

/// Largest number of points, registered in seconds. A density above the template's adds no information.
const MAX_POINTS: usize = 20_000;

/// A contact as passed from Python.
#[derive(Clone, Copy)]
pub struct Given<'a, 'py> {
    /// A frame, or points of the contact.
    pub contact: &'a Bound<'py, PyAny>,
    pub all_points_mm: Option<&'a Bound<'py, PyAny>>,
    pub covariance_mm2: Option<&'a Bound<'py, PyAny>>,
}

impl Given<'_, '_> {
    /// Runs work on the contact with the interpreter's lock released, until a signal stops it; says what the
    /// method could use.
    pub fn register<T: Send>(
        self,
        py: Python<'_>,
        method: RegisterMethod,
        gel: Gel,
        run: impl FnOnce(&core::Contact<'_>, Stop<'_>) -> Result<T, core::RegisterError> + Send,
    ) -> PyResult<(T, Model)> {
        match self.contact.cast::<Frame>() {
            Ok(frame) => self.frame(py, frame.get(), method, gel, run),
            Err(_) => self.points(py, method, gel, run),
        }
    }

    fn frame<T: Send>(
        self,
        py: Python<'_>,
        frame: &Frame,
        method: RegisterMethod,
        gel: Gel,
        run: impl FnOnce(&core::Contact<'_>, Stop<'_>) -> Result<T, core::RegisterError> + Send,
    ) -> PyResult<(T, Model)> {
        if self.all_points_mm.is_some() || self.covariance_mm2.is_some() {
            return Err(PyTypeError::new_err(
                "all_points_mm and covariance_mm2 come with points; a Frame has both: leave them out",
            ));
        }
        let found = stoppable(py, |stop| {
            let mut touch = Touch::default();
            let contact = core::Contact { press_direction: gel.press_direction, ..touch.of(frame.core()) };
            run(&contact, stop)
        })?;
        Ok((found.map_err(raise)?, Model::of(method, true)))
    }

    fn points<T: Send>(
        self,
        py: Python<'_>,
        method: RegisterMethod,
        gel: Gel,
        run: impl FnOnce(&core::Contact<'_>, Stop<'_>) -> Result<T, core::RegisterError> + Send,
    ) -> PyResult<(T, Model)> {
        let points = Numbers::new(self.contact, "contact")?;
        let points = points.rows::<DVec3, 3>()?;
        if points.len() > MAX_POINTS {
            return Err(RegisterError::new_err(format!(
                "there are {} points; valid is up to {MAX_POINTS}: hand over the contact patch alone, \
                 thinned to about the spacing of the template",
                points.len()
            )));
        }
        let all = self.all_points_mm.map(|all| Numbers::new(all, "all_points_mm")).transpose()?;
        let all = all.as_ref().map(Numbers::rows::<DVec3, 3>).transpose()?;
        let covariances = self.covariance_mm2.map(|c| Numbers::new(c, "covariance_mm2")).transpose()?;
        let covariances = covariances.as_ref().map(Numbers::matrices).transpose()?;
        let found = stoppable(py, |stop| {
            if let Some(all) = all {
                core::check_among(all, points)?;
            }
            let unpressed_mm = core::unpressed_for(method, all.unwrap_or_default(), points);
            let contact = core::Contact {
                covariance_mm2: covariances,
                unpressed_mm: &unpressed_mm,
                decay_mm: gel.decay_mm,
                offset_sigma_mm: gel.offset_sigma_mm,
                press_direction: gel.press_direction,
                ..core::Contact::new(points)
            };
            run(&contact, stop)
        })?;
        Ok((found.map_err(raise)?, Model::of(method, all.is_some())))
    }
}

/// What a registration could use, by its method and the markers that were given.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Model {
    /// Points on the part's surface, by its samples.
    Samples,
    /// The part's exact surface.
    Surface,
    /// The part's exact surface, and the gel beside it where that explains the markers better.
    Gel,
}

impl Model {
    const fn of(method: RegisterMethod, has_all_markers: bool) -> Self {
        match method {
            RegisterMethod::SurfaceSearch if has_all_markers => Self::Gel,
            RegisterMethod::SurfaceSearch | RegisterMethod::SurfaceClose => Self::Surface,
            _ => Self::Samples,
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Surface => "surface",
            Self::Gel => "gel",
        }
    }
}
