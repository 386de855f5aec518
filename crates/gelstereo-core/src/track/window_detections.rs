//! Nearest detections known from the window classifier.

use crate::detect::{Found, WindowObservation};

/// A point closer to one of two detections than this share of their distance is nearer to it than to the
/// other; below half to allow for rounding.
const NEARER: f64 = 0.499;

/// Detections near the predicted marker positions, if known.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WindowDetections<'a> {
    of_markers: &'a [WindowObservation],
    /// A detection with a smaller squared distance is the nearest.
    pub nearest_px2: f64,
}

impl<'a> WindowDetections<'a> {
    /// Detections near the first positions searched.
    pub fn of(found: &'a Found) -> Self {
        let nearest_px = NEARER * found.apart_px;
        Self { of_markers: &found.sights, nearest_px2: nearest_px * nearest_px }
    }

    /// Detection of a marker, if its window shows exactly one.
    pub fn detection(&self, marker: usize) -> Option<usize> {
        match self.of_markers.get(marker)? {
            WindowObservation::Marker(m) => Some(*m as usize),
            WindowObservation::Nothing | WindowObservation::Several | WindowObservation::Unclear => None,
        }
    }
}
