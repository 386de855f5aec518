//! Result of a search near expected positions.

use super::markers::Markers;
use alloc::vec::Vec;

/// Content of the window around one expected position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WindowObservation {
    /// One whole marker, at this index of [`Found::markers`]. No two positions share a marker.
    Marker(u32),
    /// Gel and specks smaller than any marker: no marker here.
    #[default]
    Nothing,
    /// Several whole markers.
    Several,
    /// Undecided: parts of markers only, something that is not a marker, a marker nearer to another
    /// position, or a window outside the image.
    Unclear,
}

/// Markers found near expected positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Each marker once, in the order of the positions.
    pub markers: Markers,
    /// Observation at each position.
    pub sights: Vec<WindowObservation>,
    /// Guaranteed least distance between two of the markers; 0 if the search gives no guarantee.
    pub apart_px: f64,
}

impl Found {
    pub(super) fn clear(&mut self) {
        self.markers.clear();
        self.sights.clear();
        self.apart_px = 0.0;
    }
}
