//! Lattices as a frame may show them: bent, thinned out, merged, specked; with the label of each detection.
#![allow(dead_code, reason = "each test crate uses its own part of this")]
use crate::support::lattice;
use gelstereo_core::detect::Markers;
use gelstereo_core::lattice::{Anchor, FoundLattice, Place, RestLattice};
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;

pub const PITCH: f64 = 17.56;
pub const SIZE: (usize, usize) = (640, 480);
pub const MIDDLE: DVec2 = DVec2::new(319.5, 239.5);

/// Detections and the label of each; none for specks and merged dots.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub points: Vec<DVec2>,
    pub labels: Vec<Option<usize>>,
    /// Where all markers are, detected or not.
    pub truth: Vec<DVec2>,
    pub rows: usize,
    pub cols: usize,
    pub smear: Option<DVec2>,
    /// Merged pairs that are as large as two markers.
    pub pairs: Vec<DVec2>,
}

impl Scene {
    pub fn new(rows: usize, cols: usize, turn_deg: f64) -> Self {
        // At 45 degrees a lattice of 19 markers a side fits into the image.
        let truth = lattice(rows, cols, PITCH, MIDDLE, turn_deg, 0.0);
        Self {
            points: truth.clone(),
            labels: (0..rows * cols).map(Some).collect(),
            truth,
            rows,
            cols,
            smear: None,
            pairs: Vec::new(),
        }
    }

    pub fn moved(mut self, by: impl Fn(DVec2) -> DVec2) -> Self {
        for p in self.points.iter_mut().chain(&mut self.truth) {
            *p = by(*p - MIDDLE) + MIDDLE;
        }
        self
    }

    pub fn shaken(mut self, sigma_px: f64, stream: &mut Stream) -> Self {
        for p in &mut self.points {
            let (x, y) = stream.normal_pair();
            *p += DVec2::new(x, y) * sigma_px;
        }
        self
    }

    /// Without a share of the markers that `may` go.
    pub fn thinned(mut self, share: f64, stream: &mut Stream, may: impl Fn(usize, usize) -> bool) -> Self {
        for n in (0..self.points.len()).rev() {
            let goes = self.labels[n].is_none_or(|l| may(l / self.cols, l % self.cols));
            if goes && stream.uniform() < share {
                self.points.swap_remove(n);
                self.labels.swap_remove(n);
            }
        }
        self
    }

    /// So many pairs of neighbours seen as one dot midway.
    pub fn merged(mut self, pairs: usize, stream: &mut Stream) -> Self {
        let mut left = pairs;
        while left > 0 {
            let n = stream.below(self.points.len());
            let Some(label) = self.labels[n] else { continue };
            let next = if stream.uniform() < 0.5 { 1 } else { self.cols };
            if next == 1 && label % self.cols == self.cols - 1 {
                continue;
            }
            let Some(m) = self.labels.iter().position(|&l| l == Some(label + next)) else { continue };
            self.points[n] = (self.points[n] + self.points[m]) * 0.5;
            self.labels[n] = None;
            self.points.swap_remove(m);
            self.labels.swap_remove(m);
            left -= 1;
        }
        self
    }

    /// As [`Self::merged`], where the dots show by their areas that they are two.
    pub fn joined(mut self, pairs: usize, stream: &mut Stream) -> Self {
        let before = self.labels.iter().filter(|l| l.is_none()).count();
        self = self.merged(pairs, stream);
        let unlabelled = self.points.iter().zip(&self.labels).filter(|(_, label)| label.is_none());
        self.pairs = unlabelled.skip(before).map(|(&p, _)| p).collect();
        self
    }

    /// Specks anywhere in the image, but none where a marker could be, seen or not.
    pub fn speckled(mut self, specks: usize, stream: &mut Stream) -> Self {
        for _ in 0..specks {
            loop {
                let at = DVec2::new(stream.uniform() * 640.0, stream.uniform() * 480.0);
                if self.truth.iter().all(|t| t.distance(at) > 0.45 * PITCH) {
                    self.points.push(at);
                    self.labels.push(None);
                    break;
                }
            }
        }
        self
    }

    /// What lies in the image, with room for a whole dot.
    pub fn cut(mut self) -> Self {
        let inside = |p: DVec2| (p.x - MIDDLE.x).abs() < 314.0 && (p.y - MIDDLE.y).abs() < 234.0;
        for n in (0..self.points.len()).rev() {
            if !inside(self.points[n]) {
                self.points.swap_remove(n);
                self.labels.swap_remove(n);
            }
        }
        self
    }

    pub fn shuffled(mut self, stream: &mut Stream) -> Self {
        for i in (1..self.points.len()).rev() {
            let j = stream.below(i + 1);
            self.points.swap(i, j);
            self.labels.swap(i, j);
        }
        self
    }

    pub fn markers(&self) -> Markers {
        Markers { area_px2: self.areas(), ..Markers::at(self.points.clone(), 0.1) }
    }

    /// A smear is larger than a dot, and so are two.
    pub fn areas(&self) -> Vec<u32> {
        let area = |&p: &DVec2| match p {
            p if Some(p) == self.smear => 300,
            p if self.pairs.contains(&p) => 120,
            _ => 60,
        };
        self.points.iter().map(area).collect()
    }

    /// Wrong places, right ones, and markers that have none.
    pub fn judge(&self, found: &FoundLattice) -> (usize, usize, usize) {
        let place = |label: usize| Place { row: (label / self.cols) as i32, col: (label % self.cols) as i32 };
        let pairs = || self.labels.iter().zip(&found.places);
        let best = (0..4)
            .map(|turns| {
                // The shift that most agree on.
                let mut shifts: Vec<(i32, i32)> = pairs()
                    .filter_map(|(label, found)| {
                        let (at, to) = ((*found)?.turned(turns), place((*label)?));
                        Some((to.row - at.row, to.col - at.col))
                    })
                    .collect();
                shifts.sort_unstable();
                shifts.chunk_by(|a, b| a == b).map(<[_]>::len).max().unwrap_or(0)
            })
            .max()
            .unwrap_or(0);
        let placed = found.places.iter().flatten().count();
        (placed - best, best, self.labels.iter().flatten().count() - best)
    }
    /// Markers that an anchor gives another label than their own, or none.
    pub fn wrong_labels(&self, found: &FoundLattice, anchor: &Anchor) -> usize {
        let wrong = |(place, truth): &(&Option<Place>, &Option<usize>)| {
            truth.is_some() && place.is_some_and(|p| anchor.label(p, self.rows, self.cols) != **truth)
        };
        found.places.iter().zip(&self.labels).filter(wrong).count()
    }

    /// Whether a rest lattice is a rectangle of this one, in one of the four turns: every detected marker
    /// within half a pitch of the one with its label.
    pub fn is_part(&self, rest: &RestLattice) -> bool {
        (0..4).any(|turns| {
            let rest = rest.turned(turns);
            let detected = || (0..rest.detection.len()).filter(|&n| rest.detection[n].is_some());
            let Some(first) = detected().next() else { return false };
            let off = |n: usize| rest.positions_px[first].distance_squared(self.truth[n]);
            let Some(label) = (0..self.truth.len()).min_by(|&a, &b| off(a).total_cmp(&off(b))) else {
                return false;
            };
            let (top, left) = (first / rest.cols, first % rest.cols);
            let near = |n: usize| {
                let (row, col) = (label / self.cols + n / rest.cols - top, label % self.cols + n % rest.cols);
                let (Some(col), true) = (col.checked_sub(left), row < self.rows) else { return false };
                col < self.cols
                    && rest.positions_px[n].distance(self.truth[row * self.cols + col]) < 0.5 * PITCH
            };
            detected().all(near)
        })
    }
}
