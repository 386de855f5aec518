//! Finding markers in one image (section III-A): what differs from its surround by enough, in one piece, of a
//! plausible size, with its centre.

// Public for this crate's tests alone.
#[doc(hidden)]
pub mod centre;
mod detector;
mod error;
mod found;
mod markers;
#[doc(hidden)]
pub mod mask;
mod search;
mod window;

pub use detector::Detector;
pub use error::DetectError;
pub use found::{Found, WindowObservation};
pub use markers::{CutMarker, MAX_MARKERS, Markers, PIXELS_PER_MARKER, most_markers};
pub use window::size::MarkerSize;
