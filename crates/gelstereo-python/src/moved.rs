//! The markers of one frame as passed from Python.

use crate::arrays::Numbers;
use gelstereo_core::force::MovedMarkers;
use gelstereo_core::math::DVec3;
use gelstereo_core::track::MarkerState;
use pyo3::prelude::*;

/// Points, covariances and patch of the markers of one frame. A point that is not finite is not seen.
pub struct GivenMarkers<'py> {
    points_mm: Numbers<'py>,
    covariance_mm2: Numbers<'py>,
    state: Vec<MarkerState>,
    patch: Vec<bool>,
}

impl<'py> GivenMarkers<'py> {
    pub fn new(
        points_mm: &Bound<'py, PyAny>,
        covariance_mm2: &Bound<'py, PyAny>,
        patch: Vec<bool>,
    ) -> PyResult<Self> {
        let points_mm = Numbers::new(points_mm, "points_mm")?;
        let seen = |point: &DVec3| if point.is_finite() { MarkerState::Seen } else { MarkerState::Lost };
        let state = points_mm.rows::<DVec3, 3>()?.iter().map(seen).collect();
        Ok(Self { points_mm, covariance_mm2: Numbers::new(covariance_mm2, "covariance_mm2")?, state, patch })
    }

    pub fn moved(&self) -> PyResult<MovedMarkers<'_>> {
        let Self { points_mm, covariance_mm2, state, patch } = self;
        let (points_mm, covariance_mm2) = (points_mm.rows::<DVec3, 3>()?, covariance_mm2.matrices()?);
        Ok(MovedMarkers { points_mm, covariance_mm2, state, patch })
    }
}
