//! Triangulation: from two views of a marker to a point in millimetres, with its covariance.

mod chebyshev;
mod error;
mod fitting;
mod point;
mod polynomial;
mod q;
mod rays;
mod root;
mod tiles;

pub use error::TriangulateError;
pub use point::{Centre, Centres, StereoPoint};

use crate::camera::CameraError;
use crate::math::{DQuat, DVec2, DVec3};
use crate::params::{TriangulateMethod, TriangulateParams};
use crate::rig::{Rectification, Rig, RigView, View};
use alloc::boxed::Box;
use alloc::vec::Vec;
use fitting::{Fitting, Progress};
use point::{Pair, finite};
use polynomial::Map;
use root::Root;

/// Triangulation, with everything that depends on the rig alone precomputed.
#[derive(Clone, Debug)]
pub struct Triangulator {
    rig: Rig,
    rectification: Rectification,
    to_sensor: DQuat,
    params: TriangulateParams,
    map: Option<Map>,
    fitting: Option<Box<Fitting>>,
}

impl Triangulator {
    /// For this rig.
    ///
    /// # Errors
    /// [`TriangulateError::Rig`].
    pub fn new(rig: &Rig, params: &TriangulateParams) -> Result<Self, TriangulateError> {
        let rectification = rig.rectification().map_err(TriangulateError::Rig)?;
        let to_sensor = DQuat::from_mat3(&rectification.r_left).conjugate().normalize();
        Ok(Self {
            rig: rig.clone(),
            rectification,
            to_sensor,
            params: params.clone(),
            map: None,
            fitting: None,
        })
    }

    /// The rig in use.
    #[must_use]
    pub const fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Fits the polynomial map around the points of the rest surface (sensor frame), when the method is
    /// [`TriangulateMethod::Polynomial`]. Before that, and where no polynomial is accurate to 1 um,
    /// points equal those of [`TriangulateMethod::Rays`] to less than 0.1 um.
    pub fn fit_map(&mut self, rest_mm: &[DVec3]) {
        self.begin_map(rest_mm);
        while self.continue_map() {}
    }

    /// The first step of [`Self::fit_map`]: with one step per frame, no frame takes much longer than
    /// others.
    pub fn begin_map(&mut self, rest_mm: &[DVec3]) {
        self.clear_map();
        if self.params.method == TriangulateMethod::Polynomial {
            let begun = Fitting::begin(&self.views(), rest_mm, self.params.map_reach_mm);
            self.fitting = begun.map(Box::new);
        }
    }

    /// The next step of a map in progress, if any; returns whether there is another one. No allocation.
    pub fn continue_map(&mut self) -> bool {
        let Some(mut fitting) = self.fitting.take() else { return false };
        match fitting.step(&self.views()) {
            Progress::More => self.fitting = Some(fitting),
            Progress::Done(map) => self.map = map,
        }
        self.fitting.is_some()
    }

    /// Clears the map, finished or not: points are computed from rays until the next [`Self::fit_map`].
    pub fn clear_map(&mut self) {
        (self.map, self.fitting) = (None, None);
    }

    /// Largest distance between polynomial and exact points on a grid over the map's volume, millimetres;
    /// `None` without a map.
    #[must_use]
    pub fn map_error_mm(&self) -> Option<f64> {
        self.map.as_ref().map(Map::error_mm)
    }

    /// Points of corresponding centres, in order; `out` is cleared first.
    ///
    /// # Errors
    /// [`TriangulateError`] for the first faulty marker; `out` then holds the points before it.
    pub fn run(
        &self,
        left: Centres<'_>,
        right: Centres<'_>,
        out: &mut Vec<StereoPoint>,
    ) -> Result<(), TriangulateError> {
        out.clear();
        let of = left.positions_px.len();
        if of != right.positions_px.len() {
            return Err(TriangulateError::LengthMismatch { left: of, right: right.positions_px.len() });
        }
        for (view, centres) in [(View::Left, left), (View::Right, right)] {
            let covariances = centres.covariance_px2.len();
            if covariances != of {
                return Err(TriangulateError::CovarianceCount { view, markers: of, covariances });
            }
        }
        let ready = self.ready();
        for index in 0..of {
            match ready.point(index, &left.at(index), &right.at(index)) {
                Ok(point) => out.push(point),
                Err(TriangulateError::Disparity { disparity_px, min_px, .. }) => {
                    let bad = |&i: &usize| {
                        let (left, right) = (left.at(i), right.at(i));
                        let pair = roots(i, &left, &right).and_then(|r| self.pair(i, [&left, &right], r));
                        matches!(pair, Err(TriangulateError::Disparity { .. }))
                    };
                    let affected = (0..of).filter(bad).count();
                    return Err(TriangulateError::Disparity { index, disparity_px, min_px, affected, of });
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Sets up both views, for many pairs of centres.
    #[must_use]
    pub fn ready(&self) -> Ready<'_> {
        Ready { stage: self, views: self.views() }
    }

    /// The point of one pair of centres; `index` is only used in errors. For many pairs use
    /// [`Self::ready`].
    ///
    /// # Errors
    /// [`TriangulateError`], except the two variants about numbers of markers.
    pub fn point(
        &self,
        index: usize,
        left: &Centre,
        right: &Centre,
    ) -> Result<StereoPoint, TriangulateError> {
        self.ready().point(index, left, right)
    }

    fn views(&self) -> [RigView<'_>; 2] {
        [self.rig.view(View::Left), self.rig.view(View::Right)]
    }

    /// Rays of both centres. Their disparity in the rectified views must be large enough: rays that are
    /// parallel in air are parallel in the gel too.
    fn pair<'a>(
        &self,
        index: usize,
        centres: [&'a Centre; 2],
        roots: [Root; 2],
    ) -> Result<Pair<'a>, TriangulateError> {
        let r = &self.rectification;
        let one = |view, camera: &crate::camera::Camera, rotation, pixel_px: DVec2| {
            let fail = |error| TriangulateError::Ray { index, view, error };
            let normalised = camera.undistort(pixel_px).map_err(fail)?;
            let rectified = r.rectify(rotation, normalised);
            Ok((normalised, rectified.ok_or(fail(CameraError::BeyondDistortion { pixel_px }))?))
        };
        let (left_ray, left_px) = one(View::Left, &self.rig.left, &r.r_left, centres[0].at_px)?;
        let (right_ray, right_px) = one(View::Right, &self.rig.right, &r.r_right, centres[1].at_px)?;
        let (disparity_px, min_px) = (left_px.x - right_px.x, self.params.min_disparity_px);
        if !(disparity_px >= min_px) {
            return Err(TriangulateError::Disparity { index, disparity_px, min_px, affected: 1, of: 1 });
        }
        Ok(Pair { centres, roots, normalised: [left_ray, right_ray], rectified: [left_px, right_px] })
    }
}

/// A [`Triangulator`] with both views set up.
#[derive(Clone, Copy, Debug)]
pub struct Ready<'a> {
    stage: &'a Triangulator,
    views: [RigView<'a>; 2],
}

impl<'a> Ready<'a> {
    /// The rig.
    #[must_use]
    pub const fn rig(&self) -> &'a Rig {
        &self.stage.rig
    }

    /// The row-aligned virtual cameras.
    #[must_use]
    pub const fn rectification(&self) -> &'a Rectification {
        &self.stage.rectification
    }

    /// One view of the rig.
    #[must_use]
    pub const fn view(&self, view: View) -> &RigView<'a> {
        match view {
            View::Left => &self.views[0],
            View::Right => &self.views[1],
        }
    }

    /// The point of one pair of centres; `index` is only used in errors.
    ///
    /// # Errors
    /// [`TriangulateError`], except the two variants about numbers of markers.
    pub fn point(
        &self,
        index: usize,
        left: &Centre,
        right: &Centre,
    ) -> Result<StereoPoint, TriangulateError> {
        let Self { stage, views } = self;
        let roots = roots(index, left, right)?;
        if let Some(found) = stage.map.as_ref().and_then(|map| map.point([left.at_px, right.at_px], &roots)) {
            return finite(index, found);
        }
        let pair = stage.pair(index, [left, right], roots)?;
        match stage.params.method {
            TriangulateMethod::Q => q::point(&stage.rectification, stage.to_sensor, index, &pair),
            TriangulateMethod::Polynomial => rays::point(views, index, &pair, rays::NEAR_AS_MAPPED),
            TriangulateMethod::Rays => rays::point(views, index, &pair, rays::NEAR),
        }
    }
}

fn roots(index: usize, left: &Centre, right: &Centre) -> Result<[Root; 2], TriangulateError> {
    let root = |view, centre: &Centre| {
        Root::new(&centre.covariance_px2).ok_or(TriangulateError::Covariance { index, view })
    };
    Ok([root(View::Left, left)?, root(View::Right, right)?])
}
