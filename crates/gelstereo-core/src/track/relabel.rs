//! Relabelling: fits the lattice found in a single frame to the expected places.

use super::extended_lattice::{ExtendedLattice, NONE};
use crate::detect::Markers;
use crate::lattice::{self, AnchorEvidence, FoundLattice, LatticeFinder};
use crate::math::DVec2;

/// A marker of a complete frame within this distance of its prediction by its neighbours, in pitches, is
/// labelled correctly; a slip gives half a pitch.
const REGULAR: f64 = 1.0 / 3.0;

/// Places beyond the ends of the lattice that allow for false detections.
const SPECKS_BEYOND: usize = 8;

/// The lattice of a single frame.
///
/// Matching to a prediction fails if the gel has moved by half a pitch since; neighbourhood within one
/// frame remains valid. But a single frame cannot distinguish its border from a hidden row, and strong
/// shear may look like a slip. The result is therefore a proposal, verified like other matches.
#[derive(Clone, Debug, Default)]
pub(super) struct Relabel {
    finder: LatticeFinder,
    found: FoundLattice,
    /// Whether the finder placed this frame.
    placed: bool,
}

impl Relabel {
    /// Reserves memory for frames with up to `most_detections`, of a lattice whose rows and columns have
    /// up to `longest` markers.
    pub fn reserve(&mut self, size_px: (usize, usize), most_detections: usize, longest: usize) {
        self.finder.reserve(size_px, most_detections, longest + SPECKS_BEYOND);
        self.found.places.reserve(most_detections);
    }

    /// Searches a frame for the lattice; returns whether there is one.
    pub fn find(&mut self, detected: &Markers, size_px: (usize, usize)) -> bool {
        self.placed = self.finder.run_markers(detected, Some(size_px), &mut self.found).is_ok();
        self.placed
    }

    /// Transfers the found lattice to a canvas with predictions `expected_px`. Returns the evidence for
    /// its labels, which hold up to a shift, or `None` where they are ambiguous.
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

    /// Whether every printed marker was found, with no detection left over and all rows regular. Then no
    /// part can have slipped: its place would be empty or taken twice.
    pub fn complete(&self, canvas: &ExtendedLattice) -> bool {
        let inside = (0..canvas.found.len()).filter(|&s| canvas.marker(s).is_some());
        let all = inside.filter(|&s| canvas.found[s] != NONE).count();
        all == canvas.rows * canvas.cols
            && self.found.places.len() == all
            && self.found.worst_pitches < REGULAR
    }
}
