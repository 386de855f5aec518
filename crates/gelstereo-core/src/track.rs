//! Identity of markers from frame to frame (Eq. 1 and 2).

use crate::math::DVec2;
use crate::params::TrackParams;
use alloc::vec::Vec;

/// What is known of a marker in the present frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum MarkerState {
    /// Measured in this frame.
    Seen = 0,
    /// Not measured; its position is carried over, or filled in from its neighbours if it was never printed.
    Held = 1,
    /// Not measured for longer than `track.max_held_frames`; its position is the last one known.
    Lost = 2,
}

/// Every marker's position and state, in the order of the lattice: row by row, `row * cols + col`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracks {
    /// Positions, pixels.
    pub positions_px: Vec<DVec2>,
    /// States.
    pub state: Vec<MarkerState>,
}

/// Follows the markers of one view.
#[derive(Clone, Debug)]
pub struct Tracker {
    params: TrackParams,
}

impl Tracker {
    /// Not yet initialised.
    #[must_use]
    pub fn new(params: &TrackParams) -> Self {
        Self { params: params.clone() }
    }
}

impl Tracker {
    /// Starts from a labelled rest frame: seen where detected, held where filled in (a filled-in marker is held for
    /// ever, moving with its lattice neighbours, until it is seen).
    pub fn initialise(&mut self, rest: &crate::label::RestLattice, cols: usize, out: &mut Tracks) {
        let _ = (&self.params, rest, cols, out);
        unimplemented!()
    }

    /// Updates the tracks by the detections of the next frame (Eq. 2): gate, mutual nearest, states.
    pub fn run(&mut self, detected_px: &[DVec2], out: &mut Tracks) {
        let _ = (detected_px, out);
        unimplemented!()
    }
}
