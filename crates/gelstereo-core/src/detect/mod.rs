//! Marker detection in one image (section III-A): connected components that differ enough from the
//! background and have a plausible size, each with its centre.

// Public only for this crate's tests.
#[doc(hidden)]
pub mod centre;
mod detector;
mod error;
pub(crate) mod fold_law;
mod folds;
mod found;
mod markers;
#[doc(hidden)]
pub mod mask;
mod outline;
mod search;
mod window;
mod workload;

pub(crate) use centre::soft_threshold::MAX_PROFILE_MARKERS;
pub use detector::Detector;
pub use error::DetectError;
pub use folds::Folds;
pub use found::{Found, WindowObservation};
pub use markers::{CutMarker, MAX_MARKERS, Markers, PIXELS_PER_MARKER, max_markers};
pub use window::size::MarkerSize;
pub use workload::Workload;
