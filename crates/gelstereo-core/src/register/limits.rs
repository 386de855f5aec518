//! What templates and contacts may hold.

/// Fewest points that can carry a pose.
pub(crate) const LEAST_POINTS: usize = 3;
/// Most points that a template holds: a 100 mm cube at 0.5 mm.
pub(crate) const MOST_POINTS: usize = 250_000;
/// Coordinates beyond this, a million kilometres, are taken for a mistake.
pub(crate) const REACH_MM: f64 = 1e12;
