//! Detects labels of the two views that have slipped relative to each other.
//!
//! Each view is labelled on its own. Where one of them is a column off, the rows still agree and the rays
//! still meet. Only the depth is wrong, by the effect of one pitch along the baseline (a slip), the unit
//! of heights here. Heights of consistent neighbours differ by less than 0.7 slips: more would take a
//! cliff of more than 2 mm between two markers on sensors of this kind. And most of the gel stays near
//! its rest height.

use super::RestSurface;
use crate::math::{DVec2, median};
use crate::track::MarkerState;
use crate::triangulate::{Centre, Centres, Triangulator};
use alloc::vec::Vec;

/// Upper bound of the height difference of neighbours and of the height of untouched markers above rest,
/// in slips.
const APART: f64 = 0.7;

/// At least one marker in this many is near its rest height, and at most one in this many lies deeper by
/// that amount: a press raises some of the gel towards the camera, and nothing sinks.
const SHARE: usize = 10;

/// Markers sampled to estimate a slip.
const MARKERS_TO_LEARN: usize = 16;

/// Finds slips; scratch is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct StereoMismatch {
    cols: usize,
    slip_mm: f64,
    /// An earlier marker of the same part, or itself.
    parent: Vec<u32>,
    parts: Vec<Part>,
    /// Height of the last seen marker of each column; NaN if none so far.
    above_mm: Vec<f64>,
}

/// Counts of the markers of a connected part, stored at its first one.
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    size: u32,
    free: u32,
    sunk: u32,
}

impl Part {
    fn add(&mut self, height_mm: f64, near_mm: f64) {
        self.size += 1;
        self.free += u32::from(height_mm.abs() < near_mm);
        self.sunk += u32::from(height_mm <= -near_mm);
    }

    const fn is_plausible(self) -> bool {
        let share = SHARE as u32;
        share * self.free >= self.size && share * self.sunk <= self.size
    }
}

impl StereoMismatch {
    /// Estimates from the rest frame the height error of a slip by one pitch. `left` and `right` are the
    /// centres from which the rest surface was made; the lattice has `cols` columns, `pitch_px` pixels
    /// apart.
    pub fn learn(
        &mut self,
        triangulator: &Triangulator,
        rest: &RestSurface,
        [left, right]: [Centres<'_>; 2],
        cols: usize,
        pitch_px: f64,
    ) {
        let ready = triangulator.ready();
        let height = |i: usize, step_px: f64| {
            let moved = Centre { at_px: right.at(i).at_px + DVec2::new(step_px, 0.0), ..right.at(i) };
            let point = ready.point(i, &left.at(i), &moved).ok()?;
            Some((point.point_mm - rest.points_mm()[i]).dot(rest.normal()).abs())
        };
        // Away from the camera, a slip is larger than towards it.
        let lowest = |i: usize| Some(height(i, -pitch_px)?.min(height(i, pitch_px).unwrap_or(f64::INFINITY)));
        let markers = rest.points_mm().len();
        // It hardly varies over the gel, so the median of a few markers suffices.
        let few = (0..markers).step_by((markers / MARKERS_TO_LEARN).max(1));
        let mut heights: Vec<f64> = few.filter_map(lowest).collect();
        self.cols = cols.max(1);
        self.slip_mm = median(&mut heights).filter(|mm| *mm > 0.0).unwrap_or(f64::INFINITY);
        self.parent.reserve(markers);
        self.parts.reserve(markers);
        self.above_mm.reserve(self.cols);
    }

    /// Height error of a slip by one pitch, millimetres, median over the markers; infinite if unknown.
    #[must_use]
    pub const fn slip_mm(&self) -> f64 {
        self.slip_mm
    }

    /// Holds the seen markers whose two views do not show the same marker, given all heights above rest,
    /// and calls `put_back` for each. Returns their number.
    ///
    /// `heights_mm` ([`RestSurface::indentation_mm`]) and `state` have the markers of the rest surface,
    /// row by row; states other than seen are left unchanged.
    ///
    /// Of the parts with consistent neighbours, the largest one at a plausible height is correct; all
    /// others have slipped relative to it.
    pub fn hold(
        &mut self,
        heights_mm: &[f64],
        state: &mut [MarkerState],
        mut put_back: impl FnMut(usize),
    ) -> usize {
        if self.is_one_part(heights_mm, state) && self.whole(heights_mm, state).is_plausible() {
            return 0;
        }
        self.join(heights_mm, state);
        self.count(heights_mm, state);
        let plausible =
            self.parts.iter().enumerate().filter(|(_, part)| part.size > 0 && part.is_plausible());
        // The first of equal ones.
        let right =
            plausible.max_by_key(|&(root, part)| (part.size, core::cmp::Reverse(root))).map(|(root, _)| root);
        let mut held = 0;
        for (i, state) in state.iter_mut().enumerate() {
            if *state == MarkerState::Seen && Some(self.parent[i] as usize) != right {
                *state = MarkerState::Held;
                put_back(i);
                held += 1;
            }
        }
        held
    }

    /// Whether everything that [`Self::join`] would join agrees and is connected: the usual case, checked
    /// faster.
    fn is_one_part(&mut self, heights_mm: &[f64], state: &[MarkerState]) -> bool {
        self.above_mm.clear();
        self.above_mm.resize(self.cols, f64::NAN);
        let apart = |a: f64, b: f64| (a - b).abs() >= APART * self.slip_mm;
        let mut rows = 0;
        for (heights, states) in heights_mm.chunks(self.cols).zip(state.chunks(self.cols)) {
            let (mut before, mut linked) = (f64::NAN, rows == 0);
            for ((&height, above), _) in
                heights.iter().zip(&mut self.above_mm).zip(states).filter(|(_, s)| **s == MarkerState::Seen)
            {
                if apart(height, before) || apart(height, *above) {
                    return false;
                }
                linked |= !above.is_nan();
                (before, *above) = (height, height);
            }
            if !before.is_nan() {
                if !linked {
                    return false;
                }
                rows += 1;
            }
        }
        true
    }

    /// All seen markers as one part.
    fn whole(&self, heights_mm: &[f64], state: &[MarkerState]) -> Part {
        let mut part = Part::default();
        for (&height, _) in heights_mm.iter().zip(state).filter(|(_, s)| **s == MarkerState::Seen) {
            part.add(height, APART * self.slip_mm);
        }
        part
    }

    /// Joins each seen marker to the next seen one of its row and of its column where their heights agree.
    fn join(&mut self, heights_mm: &[f64], state: &[MarkerState]) {
        self.parent.clear();
        self.parent.extend(0..heights_mm.len() as u32);
        let max_mm = APART * self.slip_mm;
        for i in (0..heights_mm.len()).filter(|&i| state[i] == MarkerState::Seen) {
            let row_end = (i / self.cols + 1) * self.cols;
            let right = (i + 1..row_end).find(|&j| state[j] == MarkerState::Seen);
            let below = (i + self.cols..heights_mm.len()).step_by(self.cols);
            let below = below.into_iter().find(|&j| state[j] == MarkerState::Seen);
            for j in [right, below].into_iter().flatten() {
                if (heights_mm[i] - heights_mm[j]).abs() < max_mm {
                    let (a, b) = (self.root(i as u32), self.root(j as u32));
                    self.parent[a.max(b) as usize] = a.min(b);
                }
            }
        }
        for i in 0..heights_mm.len() {
            self.parent[i] = self.root(i as u32);
        }
    }

    fn count(&mut self, heights_mm: &[f64], state: &[MarkerState]) {
        self.parts.clear();
        self.parts.resize(heights_mm.len(), Part::default());
        let near_mm = APART * self.slip_mm;
        for (i, &height) in heights_mm.iter().enumerate().filter(|&(i, _)| state[i] == MarkerState::Seen) {
            self.parts[self.parent[i] as usize].add(height, near_mm);
        }
    }

    /// The first marker of a part; paths are halved on the way.
    fn root(&mut self, mut marker: u32) -> u32 {
        loop {
            let parent = self.parent[marker as usize];
            if parent == marker {
                return marker;
            }
            let grandparent = self.parent[parent as usize];
            self.parent[marker as usize] = grandparent;
            marker = grandparent;
        }
    }
}
