//! Tractions and the wrench of a contact, from the motion of the markers.
//!
//! The gel is an elastic layer ([`crate::layer`]): linear elasticity, bonded to its plate, unbounded
//! sideways. The unknowns are uniform tractions on the cells of the contact, which are the squares around
//! its markers. [`ForceEstimator`] finds the most probable ones, given the motion of the markers in and
//! around the contact with their covariances, and states the [`Wrench`] with its covariance.
//!
//! A [`Compliance`], which finite elements give, replaces the layer where the gel is narrow for its
//! thickness.
//!
//! Without a layer, known loads tell how stiff the gel is, and the wrench is a sum over the markers.
//!
//! The weights of the prior come from the data: the evidence is maximised over the variances of pressures,
//! shears and noise (MacKay 1992, "Bayesian interpolation"). If the layer does not explain the motion to
//! within the noise, the covariance widens.

mod cells;
mod compliance;
mod compliance_bytes;
mod cone;
mod equations;
mod error;
mod estimator;
mod evidence;
mod fit;
mod gel_error;
mod grid;
mod moved;
mod resultant;
mod strain;
mod uneven;
mod work;
mod wrench;

pub use compliance::{Compliance, ComplianceError, ComplianceGel};
pub use error::ForceError;
pub use estimator::ForceEstimator;
pub use moved::MovedMarkers;
pub use wrench::Wrench;
