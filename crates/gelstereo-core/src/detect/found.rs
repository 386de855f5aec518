//! What a search near expected positions found.

use super::markers::Markers;
use alloc::vec::Vec;

/// What the window around one expected position shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WindowObservation {
    /// One whole marker: that of this index in [`Found::markers`]. No two positions are given the same one.
    Marker(u32),
    /// Gel, and specks smaller than any marker: there is no marker.
    #[default]
    Nothing,
    /// Several whole markers.
    Several,
    /// Not decided: only parts of markers, something that is no marker, a marker that is nearer to another position, or a
    /// window outside the image.
    Unclear,
}

/// Markers found near expected positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Each once, in the order of the positions.
    pub markers: Markers,
    /// What was seen at each position.
    pub sights: Vec<WindowObservation>,
    /// No two of the markers are closer to each other than this, as far as the search tells; 0 where it does not.
    pub apart_px: f64,
}

impl Found {
    pub(super) fn clear(&mut self) {
        self.markers.clear();
        self.sights.clear();
        self.apart_px = 0.0;
    }
}
