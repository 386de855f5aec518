//! Registration of a contact patch to a part's template (Eq. 5 to 7).
//!
//! The source is the patch of salient points, the target the template at the guess. The result maps the
//! object's frame to the sensor's, so it is already the inverse of Eq. 7.

mod alternatives;
mod blocks;
mod codec;
mod copies;
mod error;
mod free;
mod fusion;
mod half_turns;
mod held;
mod limits;
mod localizer;
mod observe;
mod paper;
mod registrar;
mod registration;
mod rigid;
mod sample;
mod surface;
mod surfels;
mod symmetry;
mod symmetry_axes;
mod template;
mod verdict;

pub use crate::params::GuessSigma;
pub use alternatives::{Alternative, Alternatives};
pub use codec::TemplateBytesError;
pub use error::{RegisterError, TemplateError};
pub use free::{FreeDirection, FreeDirections, Motion};
pub use fusion::{FusedPose, FusionError, PlaneContact, PoseEstimate, fuse_plane, fuse_poses};
pub use localizer::{Localizer, Located, TrackingStatus};
pub use observe::Observability;
pub use paper::{SoftMatch, soft_match};
pub use registrar::Registrar;
pub use registration::Registration;
pub use rigid::{RigidFit, RigidFitError, rigid_fit};
pub use surface::{Contact, GelDecay, Misfit, check_among, unpressed, unpressed_for};
pub use symmetry::Symmetry;
pub use template::Template;
pub use verdict::Verdict;
