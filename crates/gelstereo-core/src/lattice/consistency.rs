//! Consistency check of a lattice: drops markers that disagree with their neighbours.

use super::detection_grid::{DetectionGrid, STEPS};
use super::extrapolate::{neighbours, predict, predict_amid};
use super::found::Place;
use crate::math::{DVec2, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Largest distance of a marker from its prediction by its neighbours, in steps. A slip by one place
/// gives half a step or more.
const MAX_OFF: f64 = 0.33;

/// Rounds of dropping; each drops the locally worst markers.
const ROUNDS: usize = 16;

/// Markers within this distance of a detection without a place are doubtful, in neighbour distances.
const DOUBT: f64 = 2.1;

/// A neighbourhood is regular up to this distance from the prediction, in steps, and up to this slant of
/// a cell.
const REGULAR_OFF: f64 = 0.15;
const REGULAR_SLANT: f64 = 0.35;

/// Most repetitions of the check on what remains.
const EROSIONS: usize = 8;

/// Group labels: doubtful markers, markers not yet visited; higher labels are connected components.
const DOUBTED: u32 = 0;
const UNSEEN: u32 = 1;

/// Scratch of the checks.
#[derive(Clone, Debug, Default)]
pub(super) struct Consistency {
    /// Distance of each detection from its prediction by its neighbours, in steps.
    off: Vec<f64>,
    doomed: Doomed,
    /// Detections to check: all at first, then those around dropped ones.
    suspects: Vec<u32>,
    group: Vec<u32>,
    queue: Vec<u32>,
    /// Detections dropped.
    pub dropped: usize,
    /// Largest remaining distance.
    pub worst: f64,
    /// Slant of regular cells beyond `REGULAR_SLANT`, for a first look at a hexagonal lattice.
    pub more_slant: f64,
}

/// Detections that will lose their place, without duplicates, in order of insertion.
#[derive(Clone, Debug, Default)]
struct Doomed {
    list: Vec<u32>,
    listed: Vec<bool>,
}

impl Doomed {
    fn reserve(&mut self, most: usize) {
        self.start(0);
        self.list.reserve(most);
        self.listed.reserve(most);
    }

    fn start(&mut self, detections: usize) {
        self.list.clear();
        self.listed.clear();
        self.listed.resize(detections, false);
    }

    fn push(&mut self, detection: usize) {
        if !core::mem::replace(&mut self.listed[detection], true) {
            self.list.push(detection as u32);
        }
    }
}

impl Consistency {
    pub fn reserve(&mut self, most: usize) {
        for list in [&mut self.suspects, &mut self.group, &mut self.queue] {
            list.clear();
            list.reserve(most);
        }
        self.doomed.reserve(most);
        self.off.clear();
        self.off.reserve(most);
    }

    /// Drops markers until the rest are consistent, and keeps the largest connected part.
    ///
    /// Each remaining marker lies at its prediction by its neighbours, and no empty place is predicted
    /// where a marker with another place was detected. Corners of a cell that folds over fail the first
    /// condition.
    pub fn prune(&mut self, points: &[DVec2], grid: &Grid, near_px: f64, detection_grid: &mut DetectionGrid) {
        self.dropped = 0;
        self.off.clear();
        self.off.resize(points.len(), 0.0);
        self.suspects.clear();
        self.suspects.extend(placed(detection_grid).map(|(m, _)| m as u32));
        self.measure(points, detection_grid);
        for _ in 0..ROUNDS {
            self.doomed.start(points.len());
            self.find_worst(detection_grid);
            self.find_seams(points, grid, detection_grid);
            if self.doomed.list.is_empty() {
                break;
            }
            self.drop_doomed(points, detection_grid);
        }
        for _ in 0..EROSIONS {
            let before = self.dropped;
            self.keep_sure(points, grid, near_px, detection_grid);
            self.drop_doomed(points, detection_grid);
            if self.dropped == before {
                break;
            }
        }
        self.worst = self.off.iter().copied().fold(0.0, f64::max);
    }

    /// Drops the listed detections and measures those around them again.
    fn drop_doomed(&mut self, points: &[DVec2], detection_grid: &mut DetectionGrid) {
        self.suspects.clear();
        for &m in &self.doomed.list {
            let Some(place) = detection_grid.places[m as usize] else { continue };
            self.dropped += 1;
            self.off[m as usize] = 0.0;
            detection_grid.drop(m as usize);
            let Some(cell) = detection_grid.cell(place) else { continue };
            for (rows, cols) in (-3..=3).flat_map(|rows| (-3..=3).map(move |cols| (rows, cols))) {
                if let Some(n) = detection_grid.at_offset(cell, rows, cols)
                    && !self.off[n].is_nan()
                {
                    // NaN marks a detection as listed until it is measured.
                    self.off[n] = f64::NAN;
                    self.suspects.push(n as u32);
                }
            }
        }
        self.measure(points, detection_grid);
    }

    fn measure(&mut self, points: &[DVec2], detection_grid: &DetectionGrid) {
        for (m, place) in among(&self.suspects, detection_grid) {
            self.off[m] = off(points, detection_grid, m, place);
        }
    }

    /// A wrong marker also biases the predictions of its neighbours, so only the locally worst one is
    /// dropped.
    fn find_worst(&mut self, detection_grid: &DetectionGrid) {
        for (m, place) in among(&self.suspects, detection_grid) {
            let off = self.off[m];
            let worst_around = || {
                STEPS
                    .into_iter()
                    .filter_map(|step| detection_grid.at(place.step(step)))
                    .all(|n| self.off[n] <= off)
            };
            if !(off < MAX_OFF) && worst_around() {
                self.doomed.push(m);
            }
        }
    }

    /// Finds seams: two parts of the lattice that met with different labels.
    fn find_seams(&mut self, points: &[DVec2], grid: &Grid, detection_grid: &DetectionGrid) {
        for (m, place) in among(&self.suspects, detection_grid) {
            let Some(cell) = detection_grid.cell(place) else { continue };
            for step in STEPS {
                if detection_grid.at_offset(cell, step.0, step.1).is_some() {
                    continue;
                }
                let Some(predicted) = predict(detection_grid, points, place.step(step)) else { continue };
                let radius_px = MAX_OFF * predicted.at.distance(points[m]);
                let other =
                    grid.nearest(points, predicted.at, radius_px, |n| detection_grid.places[n].is_some());
                if let Some(n) = other {
                    [m, n].into_iter().for_each(|n| self.doomed.push(n));
                }
            }
        }
    }

    /// Lists for removal all but the largest part connected by markers beyond doubt, and the doubtful
    /// markers next to it.
    ///
    /// A detection without a place makes the markers around it doubtful, unless they are regular, as
    /// around a false detection. In a strongly sheared lattice the walk can slip by one place; one
    /// detection is then left over at each end of the slip. A part connected to the rest by doubtful
    /// markers alone may have slipped as a whole.
    fn keep_sure(&mut self, points: &[DVec2], grid: &Grid, near_px: f64, detection_grid: &DetectionGrid) {
        self.group.clear();
        self.group.resize(points.len(), UNSEEN);
        let mut left_over = false;
        let reach = DOUBT * near_px;
        for m in (0..points.len()).filter(|&m| detection_grid.places[m].is_none()) {
            left_over = true;
            let near = |n: usize| points[n].distance_squared(points[m]) < reach * reach;
            let mut regular = true;
            grid.visit(points[m], reach, |n| {
                regular &= !near(n)
                    || (self.off[n] < REGULAR_OFF
                        && slant(points, detection_grid, n) < REGULAR_SLANT + self.more_slant);
            });
            if !regular {
                grid.visit(points[m], reach, |n| {
                    if near(n) {
                        self.group[n] = DOUBTED;
                    }
                });
            }
        }
        self.doomed.start(points.len());
        if !left_over && self.dropped == 0 {
            return;
        }
        let (mut groups, mut largest) = (UNSEEN, (0, UNSEEN));
        for start in 0..points.len() {
            if detection_grid.places[start].is_some() && self.group[start] == UNSEEN {
                groups += 1;
                let size = self.flood(detection_grid, start, groups);
                if size > largest.0 {
                    largest = (size, groups);
                }
            }
        }
        for (m, place) in placed(detection_grid) {
            let sure = |n: usize| self.group[n] == largest.1;
            let beside =
                || STEPS.into_iter().filter_map(|step| detection_grid.at(place.step(step))).any(sure);
            if !sure(m) && (self.group[m] != DOUBTED || !beside()) {
                self.doomed.push(m);
            }
        }
    }

    fn flood(&mut self, detection_grid: &DetectionGrid, start: usize, group: u32) -> usize {
        self.queue.clear();
        self.queue.push(start as u32);
        self.group[start] = group;
        let mut next = 0;
        while let Some(&m) = self.queue.get(next) {
            next += 1;
            let Some(place) = detection_grid.places[m as usize] else { continue };
            for step in (-1..=1).flat_map(|dr| (-1..=1).map(move |dc| (dr, dc))) {
                if let Some(n) = detection_grid.at(place.step(step))
                    && self.group[n] == UNSEEN
                {
                    self.group[n] = group;
                    self.queue.push(n as u32);
                }
            }
        }
        self.queue.len()
    }
}

pub(super) fn placed(detection_grid: &DetectionGrid) -> impl Iterator<Item = (usize, Place)> {
    detection_grid.places.iter().enumerate().filter_map(|(m, place)| Some((m, (*place)?)))
}

/// Slant of the cells at a detection: 0.5 where another diagonal would serve equally well as a step; 0
/// without a place.
fn slant(points: &[DVec2], detection_grid: &DetectionGrid, m: usize) -> f64 {
    let Some(place) = detection_grid.places[m] else { return 0.0 };
    let [row, col] = detection_grid.steps_at(points, m, place);
    row.dot(col).abs() / row.length_squared().min(col.length_squared())
}

/// The listed detections that have a place.
fn among<'a>(
    list: &'a [u32],
    detection_grid: &'a DetectionGrid,
) -> impl Iterator<Item = (usize, Place)> + 'a {
    list.iter().filter_map(|&m| Some((m as usize, detection_grid.places[m as usize]?)))
}

/// Distance of a detection from its prediction by its neighbours, in units of the distance to the nearest
/// of them.
fn off(points: &[DVec2], detection_grid: &DetectionGrid, m: usize, place: Place) -> f64 {
    let Some(cell) = detection_grid.cell(place) else { return 0.0 };
    let near = neighbours(detection_grid, points, cell);
    let Some(predicted) = predict_amid(detection_grid, points, cell, near) else { return 0.0 };
    let step2 =
        near.iter().flatten().fold(f64::INFINITY, |step2, near| step2.min(near.distance_squared(points[m])));
    sqrt(predicted.at.distance_squared(points[m]) / step2)
}
