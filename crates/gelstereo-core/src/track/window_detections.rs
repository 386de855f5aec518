//! What windows know of the nearest detections.

use crate::detect::{Found, WindowObservation};

/// Nearer to one of two points than so much of their distance is nearer to it than to the other; less than half, for round-off.
const NEARER: f64 = 0.499;

/// What was seen near the markers' expected positions, if that is known.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WindowDetections<'a> {
    of_markers: &'a [WindowObservation],
    /// A detection closer than the root of this is nearer than all others.
    pub nearest_px2: f64,
}

impl<'a> WindowDetections<'a> {
    /// Near the first positions that were searched.
    pub fn of(found: &'a Found) -> Self {
        let nearest_px = NEARER * found.apart_px;
        Self { of_markers: &found.sights, nearest_px2: nearest_px * nearest_px }
    }

    /// What was seen of a marker.
    pub fn detection(&self, marker: usize) -> Option<usize> {
        match self.of_markers.get(marker)? {
            WindowObservation::Marker(m) => Some(*m as usize),
            WindowObservation::Nothing | WindowObservation::Several | WindowObservation::Unclear => None,
        }
    }
}
