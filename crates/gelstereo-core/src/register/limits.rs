//! Limits of templates and contacts.

/// Smallest number of points that determines a pose.
pub(crate) const MIN_POINTS: usize = 3;
/// Largest number of points in a template: a 100 mm cube at 0.5 mm.
pub(crate) const MAX_POINTS: usize = 250_000;
/// Coordinates beyond this, a million kilometres, are treated as errors.
pub(crate) const REACH_MM: f64 = 1e12;
/// Smallest spacing as a share of the extent: finer templates exceed the point limit, and squares do not
/// underflow.
pub(crate) const MIN_SPACING: f64 = 1e-6;
