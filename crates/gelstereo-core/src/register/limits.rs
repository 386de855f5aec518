//! What templates and contacts may hold.

/// Fewest points that can carry a pose.
pub(crate) const MIN_POINTS: usize = 3;
/// Most points that a template holds: a 100 mm cube at 0.5 mm.
pub(crate) const MAX_POINTS: usize = 250_000;
/// Coordinates beyond this, a million kilometres, are taken for a mistake.
pub(crate) const REACH_MM: f64 = 1e12;
/// Least spacing as a share of the extent: no template that can be held is finer, and squares do not underflow.
pub(crate) const MIN_SPACING: f64 = 1e-6;
