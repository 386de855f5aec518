//! Whether all neighbours in a lattice agree, and what is dropped where they do not.

use super::canvas::{Canvas, STEPS};
use super::found::Place;
use super::predict::predict;
use crate::math::{DVec2, sqrt};
use crate::track::grid::Grid;
use alloc::vec::Vec;

/// Farthest that a marker may lie from where its neighbours say, in steps. One that slipped by a place is off by half a step
/// or more.
const MOST_OFF: f64 = 0.33;

/// Rounds of dropping; each drops what is worst around.
const ROUNDS: usize = 16;

/// Scratch of the checks.
#[derive(Clone, Debug, Default)]
pub(super) struct Agreement {
    /// Distance of each detection from where its neighbours say, in steps.
    off: Vec<f64>,
    doomed: Vec<u32>,
    group: Vec<u32>,
    queue: Vec<u32>,
    /// Detections dropped.
    pub dropped: usize,
    /// Largest distance left.
    pub worst: f64,
}

impl Agreement {
    pub fn reserve(&mut self, most: usize) {
        for list in [&mut self.doomed, &mut self.group, &mut self.queue] {
            list.clear();
            list.reserve(most);
        }
        self.off.clear();
        self.off.reserve(most);
    }

    /// Drops markers until all that are left agree: each lies where its neighbours say, no cell folds over, and no empty place
    /// is seen where a marker with another place stands. Keeps the largest part in one piece.
    pub fn prune(&mut self, points: &[DVec2], grid: &Grid, canvas: &mut Canvas) {
        self.dropped = 0;
        for _ in 0..ROUNDS {
            self.measure(points, canvas);
            self.doomed.clear();
            self.find_worst(canvas);
            self.find_folds(points, canvas);
            self.find_seams(points, grid, canvas);
            if self.doomed.is_empty() {
                break;
            }
            for &m in &self.doomed {
                self.dropped += usize::from(canvas.places[m as usize].is_some());
                canvas.drop(m as usize);
            }
        }
        if self.dropped > 0 {
            self.keep_largest(canvas);
            self.measure(points, canvas);
        }
        self.worst = self.off.iter().copied().fold(0.0, f64::max);
    }

    fn measure(&mut self, points: &[DVec2], canvas: &Canvas) {
        self.off.clear();
        self.off.resize(points.len(), 0.0);
        for (m, place) in placed(canvas) {
            if let Some(predicted) = predict(canvas, points, place) {
                let step2 = shortest_step2(points, canvas, m, place);
                self.off[m] = sqrt(predicted.at.distance_squared(points[m]) / step2);
            }
        }
    }

    /// A wrong marker pulls at the predictions of its neighbours as well: only the worst around goes.
    fn find_worst(&mut self, canvas: &Canvas) {
        for (m, place) in placed(canvas) {
            let off = self.off[m];
            let worst_around = || {
                STEPS.into_iter().filter_map(|step| canvas.at(place.step(step))).all(|n| self.off[n] <= off)
            };
            if !(off < MOST_OFF) && worst_around() {
                self.doomed.push(m as u32);
            }
        }
    }

    fn find_folds(&mut self, points: &[DVec2], canvas: &Canvas) {
        for (m, place) in placed(canvas) {
            let corner = |step| canvas.at(place.step(step));
            let cell = [Some(m), corner((0, 1)), corner((1, 1)), corner((1, 0))];
            if super::folds(cell.map(|n| n.map(|n| points[n]))) {
                self.doomed.extend(cell.iter().flatten().map(|&n| n as u32));
            }
        }
    }

    /// Two sheets that met with different labels.
    fn find_seams(&mut self, points: &[DVec2], grid: &Grid, canvas: &Canvas) {
        for (m, place) in placed(canvas) {
            for step in STEPS {
                let beyond = place.step(step);
                if canvas.at(beyond).is_some() {
                    continue;
                }
                let Some(predicted) = predict(canvas, points, beyond) else { continue };
                let radius_px = MOST_OFF * predicted.at.distance(points[m]);
                let other = grid.nearest(points, predicted.at, radius_px, |n| canvas.places[n].is_some());
                if let Some(n) = other {
                    self.doomed.extend([m as u32, n as u32]);
                }
            }
        }
    }

    /// What hangs together by places that touch, corners included.
    fn keep_largest(&mut self, canvas: &mut Canvas) {
        self.group.clear();
        self.group.resize(canvas.places.len(), 0);
        let (mut groups, mut largest) = (0, (0, 0));
        for start in 0..canvas.places.len() {
            if canvas.places[start].is_none() || self.group[start] != 0 {
                continue;
            }
            groups += 1;
            let size = self.flood(canvas, start, groups);
            if size > largest.0 {
                largest = (size, groups);
            }
        }
        for m in 0..canvas.places.len() {
            if canvas.places[m].is_some() && self.group[m] != largest.1 {
                canvas.drop(m);
                self.dropped += 1;
            }
        }
    }

    fn flood(&mut self, canvas: &Canvas, start: usize, group: u32) -> usize {
        self.queue.clear();
        self.queue.push(start as u32);
        self.group[start] = group;
        let mut next = 0;
        while let Some(&m) = self.queue.get(next) {
            next += 1;
            let Some(place) = canvas.places[m as usize] else { continue };
            for step in (-1..=1).flat_map(|dr| (-1..=1).map(move |dc| (dr, dc))) {
                if let Some(n) = canvas.at(place.step(step))
                    && self.group[n] == 0
                {
                    self.group[n] = group;
                    self.queue.push(n as u32);
                }
            }
        }
        self.queue.len()
    }
}

/// The detections with a place.
pub(super) fn placed(canvas: &Canvas) -> impl Iterator<Item = (usize, Place)> {
    canvas.places.iter().enumerate().filter_map(|(m, place)| Some((m, (*place)?)))
}

fn shortest_step2(points: &[DVec2], canvas: &Canvas, m: usize, place: Place) -> f64 {
    let near = STEPS.into_iter().filter_map(|step| canvas.position(points, place.step(step)));
    near.map(|p| p.distance_squared(points[m])).fold(f64::INFINITY, f64::min)
}
