//! Errors of templates and patches, with messages that state the remedy.

use super::limits::{MAX_POINTS, MIN_POINTS, REACH_MM};
use crate::params::ParamsError;
use crate::stop::Stopped;
use crate::surface::SolidError;

/// Why points or a mesh are not a template.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TemplateError {
    /// Too few points, or a mesh that gives too few at this spacing.
    TooFew {
        /// Points found.
        found: usize,
        /// Points needed.
        min_points: usize,
    },
    /// More points than a template may hold.
    TooMany {
        /// Points found, or expected from the mesh's area.
        found: f64,
        /// The spacing.
        spacing_mm: f64,
    },
    /// The numbers of points and normals differ.
    Lengths {
        /// Points found.
        points: usize,
        /// Normals found.
        normals: usize,
    },
    /// A point or normal is NaN, infinite or beyond 1e12 mm.
    NotFinite {
        /// Which one.
        index: usize,
    },
    /// A normal has no direction.
    ZeroNormal {
        /// Which one.
        index: usize,
    },
    /// The mesh is not a valid exact surface.
    Solid(SolidError),
    /// The spacing is not positive, or does not fit the extent of the points.
    Spacing {
        /// The spacing found.
        found_mm: f64,
        /// Largest extent of the points along an axis.
        extent_mm: f64,
    },
    /// The caller stopped the work ([`crate::stop`]).
    Stopped,
}

impl core::fmt::Display for TemplateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooFew { found, min_points } => {
                write!(f, "{found} template points; at least {min_points} are needed: reduce the spacing")
            }
            Self::TooMany { found, spacing_mm } => write!(
                f,
                "a spacing of {spacing_mm} mm gives {found:.0} template points; at most {MAX_POINTS} are \
                 held: increase the spacing, or check the units of the part (millimetres)"
            ),
            Self::Lengths { points, normals } => {
                write!(f, "{points} points but {normals} normals; every point needs one normal")
            }
            Self::NotFinite { index } => write!(
                f,
                "template point or normal {index} is NaN, infinite or beyond {REACH_MM:e} mm; remove it"
            ),
            Self::ZeroNormal { index } => {
                write!(f, "normal {index} has length zero; every point needs an outward normal")
            }
            Self::Solid(error) => error.fmt(f),
            Self::Stopped => Stopped.fmt(f),
            Self::Spacing { found_mm, extent_mm } => write!(
                f,
                "the spacing is {found_mm} mm for points that extend over {extent_mm} mm; valid is a \
                 positive spacing from {:e} times the extent to the extent itself (are both in millimetres?)",
                super::limits::MIN_SPACING
            ),
        }
    }
}

impl core::error::Error for TemplateError {}

impl From<Stopped> for TemplateError {
    fn from(Stopped: Stopped) -> Self {
        Self::Stopped
    }
}

impl From<SolidError> for TemplateError {
    fn from(error: SolidError) -> Self {
        match error {
            SolidError::Stopped => Self::Stopped,
            error => Self::Solid(error),
        }
    }
}

/// Why a registration failed.
#[derive(Clone, Debug, PartialEq)]
pub enum RegisterError {
    /// A setting is invalid.
    Params(ParamsError),
    /// Too few salient points.
    TooFewPoints {
        /// Points found.
        found: usize,
        /// Points needed.
        min_points: usize,
    },
    /// A salient point is NaN, infinite or beyond 1e12 mm.
    PointNotFinite {
        /// Which one.
        index: usize,
    },
    /// The guess has a component that is NaN, infinite or beyond 1e12 mm, or its quaternion has no direction.
    BadGuess,
    /// The rung needs the part's surface, but the template was made from points only, or its grid was
    /// removed.
    NoSurface,
    /// A marker that is not salient is NaN, infinite or beyond 1e12 mm.
    MarkerNotFinite {
        /// Which one.
        index: usize,
    },
    /// Salient points that are not among all markers.
    NotAmong {
        /// How many are not.
        missing: usize,
        /// Salient points.
        points: usize,
        /// The first that is not.
        index: usize,
        /// All markers.
        all: usize,
    },
    /// The press direction is not a unit vector.
    PressDirection,
    /// The patch is too oblique to the press direction; no part pressed in that direction leaves it.
    PatchAside {
        /// Angle between the patch's normal and the press direction.
        angle_deg: f64,
        /// The largest valid angle.
        max_deg: f64,
        /// The press direction.
        press_direction: [f64; 3],
    },
    /// An invalid standard deviation of the points' common error.
    Offset {
        /// The value found.
        found_mm: f64,
    },
    /// An invalid decay length of the gel.
    Decay {
        /// The length found.
        found_mm: f64,
    },
    /// The numbers of points and covariances differ.
    Covariances {
        /// Points found.
        points: usize,
        /// Covariances found.
        covariances: usize,
    },
    /// A covariance is not finite, all zero, or has an eigenvalue below 0.
    BadCovariance {
        /// Of which point.
        index: usize,
    },
    /// Fewer points than needed lie within reach of the template.
    OutOfReach {
        /// Points within reach.
        within: usize,
        /// Points needed.
        min_points: usize,
        /// Distance of the nearest point to the template.
        nearest_mm: f64,
        /// The reach.
        reach_mm: f64,
    },
    /// The caller stopped the work ([`crate::stop`]).
    Stopped,
}

impl core::fmt::Display for RegisterError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Params(error) => error.fmt(f),
            Self::Stopped => Stopped.fmt(f),
            Self::TooFewPoints { found, min_points } => write!(
                f,
                "{found} salient points; at least {min_points} are needed: press harder, or lower \
                contact.saliency_mm"
            ),
            Self::PointNotFinite { index } => write!(
                f,
                "salient point {index} is NaN, infinite or beyond {REACH_MM:e} mm; leave lost markers out"
            ),
            Self::BadGuess => write!(
                f,
                "the guess t_sensor_object is no rigid motion of finite size (below {REACH_MM:e} mm); give a \
                 rotation and a translation in millimetres"
            ),
            Self::NoSurface => write!(
                f,
                "the template has no surface with a grid of distances; make it from a mesh, give a scan its \
                 surface (Template::with_surfels), or choose another register.method"
            ),
            Self::MarkerNotFinite { index } => write!(
                f,
                "marker {index} of those not pressed is NaN, infinite or beyond {REACH_MM:e} mm; leave lost \
                markers out"
            ),
            Self::NotAmong { missing, points, index, all } => write!(
                f,
                "{missing} of {points} salient points are not among the {all} markers, the first of them \
                 point {index}; give all markers of the same frame, the salient ones among them and \
                 unchanged (not rounded, filtered or transformed), or leave them out"
            ),
            Self::PressDirection => {
                write!(f, "the press direction is no unit vector; give the way from the part into the gel")
            }
            Self::PatchAside { angle_deg, max_deg, press_direction: [x, y, z] } => write!(
                f,
                "the patch's normal is {angle_deg:.0} degrees from the way of the press, ({x:.2}, {y:.2}, \
                 {z:.2}); valid is up to {max_deg:.0}: hand over press_direction, the way from the part into \
                 the gel, if the part was not pressed toward the camera, or check the frame of the points"
            ),
            Self::Offset { found_mm } => {
                write!(f, "the standard deviation of the offset is {found_mm} mm; valid is a length from 0")
            }
            Self::Decay { found_mm } => {
                write!(
                    f,
                    "the gel's decay length is {found_mm} mm; valid is a length above 0: contact.decay_mm"
                )
            }
            Self::Covariances { points, covariances } => {
                write!(
                    f,
                    "{points} points but {covariances} covariances; every point needs one, or none has any"
                )
            }
            Self::BadCovariance { index } => write!(
                f,
                "the covariance of point {index} is not finite, is zero, or has a negative eigenvalue; give \
                 mm², positive semidefinite"
            ),
            Self::OutOfReach { within, min_points, nearest_mm, reach_mm } => write!(
                f,
                "{within} salient points lie within {reach_mm} mm of the template, {min_points} are needed; \
                 the nearest is {nearest_mm:.3} mm away: give a better guess, or check frames and units"
            ),
        }
    }
}

impl core::error::Error for RegisterError {}

impl From<Stopped> for RegisterError {
    fn from(Stopped: Stopped) -> Self {
        Self::Stopped
    }
}

impl From<ParamsError> for RegisterError {
    fn from(error: ParamsError) -> Self {
        Self::Params(error)
    }
}

/// Points needed for a rigid motion in space.
pub(crate) const MIN_PATCH: usize = MIN_POINTS;
