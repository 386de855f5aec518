//! Labels a rest frame of which the views show a part: gels wider than the view, covered borders.
//!
//! Rows of both views are matched by the epipolar constraint. Columns are not: one column off, the points lie
//! nearer or farther, and so they stand closer or wider than they are printed. With a baseline of 8 mm, the
//! pitch of a print of 0.9 mm would be 10 % off. So `lattice.pitch_mm` decides.

use super::error::{PipelineError, View};
use super::view::ViewStages;
use crate::lattice::{LatticeFinder, RestLattice, SharedCell, Shift, TwoViews, ViewLattice};
use crate::math::{DVec2, abs, ln, median};
use crate::params::Params;
use crate::triangulate::{Centre, Ready};
use alloc::vec::Vec;

/// Most cells that are triangulated for a shift: the median of their sides has a fifth of a side's noise.
const MAX_CELLS: usize = 24;

/// Largest difference of a marker's rectified rows, in pitches. Refraction and calibration move rows by a
/// pixel or two, and markers are some 20 px apart.
const MAX_ROWS: f64 = 0.25;

/// Smallest ratio of the second best shift's error of the pitch to the best one's, on a logarithmic scale.
/// The print's scale and the rig's may then be off by a sixth of what a column changes, 1.6 % with the
/// figures above.
const CLEARLY: f64 = 5.0;

/// Largest error of the pitch, on a logarithmic scale: half of what a column changes with the figures above.
const MAX_ERROR: f64 = 0.05;

/// The same of two lattices that are whole, each for itself: a factor of three. Settings with a wrong pitch
/// are far more frequent than wider prints whose views are whole, and another shift often fits them by
/// chance: a print of 0.65 mm with a setting of 0.9 mm fits within 2 % four columns off.
const MAX_WHOLE_ERROR: f64 = 1.1;

/// What is needed to compare the two views.
pub(super) struct Views<'a> {
    pub params: &'a Params,
    pub ready: Ready<'a>,
}

/// A shift of the right view's places, with the pitch that follows.
struct Candidate {
    shift: Shift,
    pitch_mm: [f64; 2],
    error: f64,
}

impl Views<'_> {
    /// Whether two whole lattices may be different parts of one that is wider than the views: they reach the
    /// border of an image, and cannot be triangulated or are far from the print's pitch.
    pub fn may_be_others(&self, stages: [&ViewStages; 2], rests: &[RestLattice; 2]) -> bool {
        let reaches = rests.iter().zip(stages).any(|(rest, stages)| {
            let (low, high) = stages.searched_px();
            let margin = DVec2::splat(rest.pitch_px);
            let is_inside = |at: &DVec2| (*at - margin).cmpge(low).all() && (*at + margin).cmple(high).all();
            !rest.positions_px.iter().all(is_inside)
        });
        if !reaches {
            return false;
        }
        let [left, right] = rests;
        let cols = left.cols;
        let cells: Vec<SharedCell> = (0..left.positions_px.len().saturating_sub(cols))
            .filter(|i| i % cols + 1 < cols)
            .map(|i| [[i, i], [i + 1, i + 1], [i + cols, i + cols]])
            .collect();
        let step = cells.len().div_ceil(MAX_CELLS).max(1);
        let cells: Vec<SharedCell> = cells.into_iter().step_by(step).collect();
        let pitch_mm = self.pitch_mm(&cells, [&left.positions_px, &right.positions_px]);
        pitch_mm.is_none_or(|pitch_mm| self.error(&pitch_mm) > MAX_WHOLE_ERROR)
    }

    /// Labels both views alike.
    pub fn label(
        &self,
        finder: &mut LatticeFinder,
        [left, right]: [&ViewStages; 2],
    ) -> Result<[RestLattice; 2], PipelineError> {
        let lattice = &self.params.lattice;
        let max_off_pitches = self.params.label.tolerance_pitches;
        let mut find = |stages: &ViewStages, view, row_px| {
            let centres_px = stages.centres_px().to_vec();
            let count = centres_px.len();
            ViewLattice::find(finder, centres_px, count, lattice.layout, max_off_pitches, row_px)
                .map_err(|error| PipelineError::Label { view, error })
        };
        let left = find(left, View::Left, None)?;
        let right = find(right, View::Right, left.hexagonal_row_px())?;
        let rectified = [
            self.rectified(View::Left, left.detected_px()),
            self.rectified(View::Right, right.detected_px()),
        ];
        let (left_px, right_px) = (left.detected_px().to_vec(), right.detected_px().to_vec());
        let max_rows_px = MAX_ROWS * left.pitch_px();
        let views = TwoViews::new(&left, right);
        let mut candidates: Vec<Candidate> = views
            .shifts()
            .into_iter()
            .filter_map(|shift| {
                let cells = views.cells(shift, MAX_CELLS);
                let is_level = self.is_level(&cells, &rectified, max_rows_px);
                let pitch_mm = is_level.then(|| self.pitch_mm(&cells, [&left_px, &right_px]))??;
                Some(Candidate { shift, pitch_mm, error: self.error(&pitch_mm) })
            })
            .collect();
        candidates.sort_by(|one, other| one.error.total_cmp(&other.error));
        let best = candidates.first().filter(|best| {
            let is_clear = candidates.get(1).is_none_or(|second| second.error >= CLEARLY * best.error);
            is_clear && best.error <= MAX_ERROR
        });
        let Some(best) = best else {
            let nearest = |k: usize| candidates.get(k).map(|candidate| candidate.pitch_mm);
            return Err(PipelineError::Views {
                nearest_mm: [nearest(0), nearest(1)],
                expected: lattice.pitch_mm,
            });
        };
        // Both views have the same places, so that an error is not one of a single view.
        views
            .label(best.shift, lattice, max_off_pitches)
            .map_err(|error| PipelineError::Label { view: View::Left, error })
    }

    /// Error of a pitch on a logarithmic scale, of the worse axis.
    fn error(&self, pitch_mm: &[f64; 2]) -> f64 {
        let axes = pitch_mm.iter().zip(self.params.lattice.pitch_mm.axes_mm());
        axes.map(|(found, expected)| abs(ln(found / expected))).fold(0.0, f64::max)
    }

    /// Positions in the row-aligned view.
    fn rectified(&self, view: View, detected_px: &[DVec2]) -> Vec<Option<DVec2>> {
        let (rig, aligned) = (self.ready.rig(), self.ready.rectification());
        let (camera, turn) = match view {
            View::Left => (&rig.left, &aligned.r_left),
            View::Right => (&rig.right, &aligned.r_right),
        };
        let one = |&at: &DVec2| aligned.rectify(turn, camera.undistort(at).ok()?);
        detected_px.iter().map(one).collect()
    }

    /// Whether both views have these markers in the same rows, at a possible disparity.
    fn is_level(&self, cells: &[SharedCell], rectified: &[Vec<Option<DVec2>>; 2], max_px: f64) -> bool {
        let corners = cells.iter().filter_map(|&[[left, right], ..]| {
            Some(rectified[0].get(left).copied()?? - rectified[1].get(right).copied()??)
        });
        let (mut disparities, mut rows): (Vec<f64>, Vec<f64>) =
            corners.map(|off| (off.x, abs(off.y))).unzip();
        median(&mut disparities).is_some_and(|px| px >= self.params.triangulate.min_disparity_px)
            && median(&mut rows).is_some_and(|px| px <= max_px)
    }

    /// Median sides of the cells along rows and along columns.
    fn pitch_mm(&self, cells: &[SharedCell], [left_px, right_px]: [&[DVec2]; 2]) -> Option<[f64; 2]> {
        let unit = [[1.0, 0.0], [0.0, 1.0]];
        let point = |[left, right]: [usize; 2]| {
            let centre = |at_px: DVec2| Centre { at_px, covariance_px2: unit };
            let (left, right) = (centre(*left_px.get(left)?), centre(*right_px.get(right)?));
            Some(self.ready.point(0, &left, &right).ok()?.point_mm)
        };
        let sides = cells.iter().filter_map(|&[here, right, below]| {
            let here = point(here)?;
            Some((here.distance(point(right)?), here.distance(point(below)?)))
        });
        let (mut along, mut down): (Vec<f64>, Vec<f64>) = sides.unzip();
        Some([median(&mut along)?, median(&mut down)?])
    }
}
