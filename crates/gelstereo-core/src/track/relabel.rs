//! Labels afresh: the lattice found in a single frame, laid on the places that are expected.

use super::extended_lattice::{ExtendedLattice, NONE};
use crate::detect::Markers;
use crate::lattice::{self, AnchorEvidence, FoundLattice, LatticeFinder};
use crate::math::DVec2;

/// Up to so many pitches from where its neighbours say, a marker of a complete frame is where it belongs: one that slipped
/// is half a pitch off.
const REGULAR: f64 = 1.0 / 3.0;

/// Places beyond the lattice's ends, where specks may stand.
const SPECKS_BEYOND: usize = 8;

/// The lattice of a single frame.
///
/// Matching against a prediction fails where the gel has moved by half a pitch since; rows and columns within one frame
/// tell neighbours all the same. But a frame alone does not tell its border from a row that is hidden, and strong
/// drag may look like a slip: so what is found here is a proposal, checked as matches are.
#[derive(Clone, Debug, Default)]
pub(super) struct Relabel {
    finder: LatticeFinder,
    found: FoundLattice,
    /// The finder placed this frame.
    placed: bool,
}

impl Relabel {
    /// Makes room for frames with up to `most_detections`, of a lattice whose rows and columns have up to `longest` markers.
    pub fn reserve(&mut self, size_px: (usize, usize), most_detections: usize, longest: usize) {
        self.finder.reserve(size_px, most_detections, longest + SPECKS_BEYOND);
        self.found.places.reserve(most_detections);
    }

    /// Looks for the lattice of a frame; whether there is one.
    pub fn find(&mut self, detected: &Markers, size_px: (usize, usize)) -> bool {
        self.placed = self.finder.run_markers(detected, Some(size_px), &mut self.found).is_ok();
        self.placed
    }

    /// Lays what was found on a canvas that expects markers at `expected_px`; why it is known, up to a shift, which
    /// place is which, or `None` where it is not.
    pub fn lay(
        &self,
        detected_px: &[DVec2],
        expected_px: &[DVec2],
        canvas: &mut ExtendedLattice,
    ) -> Option<AnchorEvidence> {
        let (rows, cols, rings) = (canvas.rows, canvas.cols, canvas.rings as i32);
        let anchor = lattice::anchor(&self.found, detected_px, rows, cols, expected_px)?;
        let (height, width) = (rows as i32 + 2 * rings, cols as i32 + 2 * rings);
        for (m, place) in self.found.places.iter().enumerate() {
            let Some(place) = *place else { continue };
            let place = place.turned(anchor.quarter_turns);
            let (row, col) = (place.row + anchor.shift.0 + rings, place.col + anchor.shift.1 + rings);
            if (0..height).contains(&row) && (0..width).contains(&col) {
                let site = (row * width + col) as usize;
                canvas.found[site] = m as u32;
                canvas.residual_px[site] = detected_px[m] - canvas.predicted_px[site];
            }
        }
        Some(anchor.evidence)
    }

    /// Every marker of the print found, nothing left over, and all in their rows: no part can have slipped, since its place would
    /// be empty or taken twice.
    pub fn complete(&self, canvas: &ExtendedLattice) -> bool {
        let inside = (0..canvas.found.len()).filter(|&s| canvas.marker(s).is_some());
        let all = inside.filter(|&s| canvas.found[s] != NONE).count();
        all == canvas.rows * canvas.cols
            && self.found.places.len() == all
            && self.found.worst_pitches < REGULAR
    }
}
