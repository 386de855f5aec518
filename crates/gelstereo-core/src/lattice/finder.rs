//! Grows a lattice from seeds by predicted steps.

use super::LabelError;
use super::bounds::{View, mean_steps, upright_turns};
use super::consistency::{Consistency, placed};
use super::detection_grid::{DetectionGrid, STEPS};
use super::extrapolate::{predict, predict_at};
use super::found::{FoundLattice, Place};
use super::seed::{Around, Seed, neighbour_distance, seed_at};
use crate::detect::Markers;
use crate::math::{DVec2, round, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Largest coordinate of a detection, pixels: keeps squares and areas far from overflow.
const FARTHEST_PX: f64 = 1e6;

/// Most detections of one frame.
const MAX_DETECTIONS: usize = 1 << 20;

/// Largest share of detections that may lose their place again; above it the result is unreliable.
const MAX_DROPPED: f64 = 0.1;

/// Steps of a lattice are rarely shorter than this share of the neighbour distance. It bounds the number
/// of steps between the two farthest markers.
const SHORTEST_STEP: f64 = 0.5;

/// Number of seed candidates from which the best is taken.
const SEED_SAMPLE: usize = 48;

/// Most seeds to grow from.
const MAX_SEEDS: usize = 8;

/// Number of detections sampled for the median neighbour distance.
const NEAR_SAMPLE: usize = 128;

/// Per pass: largest distance of a marker from its prediction, in steps, and the number of estimates that
/// must agree.
///
/// Reliable steps come first: a false detection or the midpoint of two merged dots, once placed, would
/// mislead later steps. The first pass places every marker of an undisturbed frame; it follows straight
/// rows but hardly turns.
const PASSES: [(f64, u32); 4] = [(0.12, 1), (0.2, 2), (0.2, 1), (0.33, 1)];

/// Radius around an unplaced detection in which the walk continues, in neighbour distances.
const AROUND_LEFT_OVER: f64 = 2.5;

/// A seed this regular is taken without comparing others.
const REGULAR: f64 = 0.02;

/// Largest ratio of a marker's area to its neighbour's.
const MAX_AREA: f64 = 1.7;

/// Largest mean squared distance of the estimates from their mean, in squared steps.
const MAX_SPREAD2: f64 = 0.06;

/// Slant of hexagonal cells beyond that of square ones. The cosine of 60 degrees is 0.5, and a view aslant
/// makes cells sharper; not swept.
const MORE_SLANT: f64 = 0.35;

/// Finds the lattice in the detections of one frame, at any rotation and with bent rows, without history.
///
/// The lattice grows along rows and columns from a marker with regular surroundings. Each step is
/// predicted from the steps around it, which follows curved rows, and is taken when exactly one detection
/// lies near the prediction. Unplaced detections are then matched to the places predicted from the
/// nearest placed markers. Finally every marker that does not lie at its prediction by its neighbours
/// loses its place.
///
/// The cost is linear in the detections. No memory is allocated after [`Self::reserve`], or after a frame
/// with as many detections.
#[derive(Clone, Debug, Default)]
pub struct LatticeFinder {
    grid: Grid,
    detection_grid: DetectionGrid,
    near_px: f64,
    /// Most places of a row or column.
    longest: usize,
    /// Area of each detection, or empty.
    areas_px2: Vec<u32>,
    distances: Vec<f64>,
    /// Detections without a place, and placed ones around them.
    left_over: Vec<u32>,
    around: Vec<u32>,
    best: Vec<Option<Place>>,
    /// Whether `detection_grid` holds `best`.
    best_is_laid: bool,
    /// Markers dropped and largest remaining distance, in steps, of `best`.
    best_evidence: (usize, f64),
    agreement: Consistency,
}

impl LatticeFinder {
    /// Reserves memory for frames of up to `size_px` (width, height) with up to `most_detections`
    /// detections, of a lattice whose rows and columns have up to `longest` markers. Markers farther than
    /// that from the seed get no place.
    pub fn reserve(&mut self, size_px: (usize, usize), most_detections: usize, longest: usize) {
        let most = most_detections.min(MAX_DETECTIONS);
        let area = (size_px.0 * size_px.1) as f64;
        self.grid.reserve(most, size_px, sqrt(area / most.max(1) as f64).max(1.0));
        self.detection_grid.reserve(most, longest);
        self.areas_px2.reserve(most);
        self.distances.reserve(2 * most);
        for list in [&mut self.left_over, &mut self.around] {
            list.clear();
            list.reserve(most);
        }
        self.best.reserve(most);
        self.agreement.reserve(most);
    }

    /// Finds the lattice; the lists of `out` are reused.
    ///
    /// `detected_px` are pixels in any order; `size_px` is the image's width and height, if known.
    /// Without it, no side can be identified as an end of the print.
    ///
    /// # Errors
    /// [`LabelError::NotFinite`], [`LabelError::NoLattice`] when fewer than 3 x 3 markers are in a
    /// lattice, and [`LabelError::Torn`] when too many neighbours disagree for a reliable result.
    pub fn run(
        &mut self,
        detected_px: &[DVec2],
        size_px: Option<(usize, usize)>,
        out: &mut FoundLattice,
    ) -> Result<(), LabelError> {
        self.areas_px2.clear();
        self.find(detected_px, size_px, false, out)
    }

    /// As [`Self::run`] for detected markers. A marker with more than 1.7 times the area of its neighbour
    /// is two merged markers or a smear, and gets no place.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn run_markers(
        &mut self,
        detected: &Markers,
        size_px: Option<(usize, usize)>,
        out: &mut FoundLattice,
    ) -> Result<(), LabelError> {
        self.areas_px2.clone_from(&detected.area_px2);
        self.find(&detected.centres_px, size_px, false, out)
    }

    /// As [`Self::run`], keeping outer rows and columns of which only a marker or two were detected.
    pub(super) fn run_with_specks(
        &mut self,
        detected_px: &[DVec2],
        out: &mut FoundLattice,
    ) -> Result<(), LabelError> {
        self.areas_px2.clear();
        self.find(detected_px, None, true, out)
    }

    /// As [`Self::run_with_specks`] for a lattice that may be hexagonal: its cells are slanted.
    pub(super) fn run_slanted(
        &mut self,
        detected_px: &[DVec2],
        out: &mut FoundLattice,
    ) -> Result<(), LabelError> {
        self.agreement.more_slant = MORE_SLANT;
        let found = self.run_with_specks(detected_px, out);
        self.agreement.more_slant = 0.0;
        found
    }

    fn find(
        &mut self,
        detected_px: &[DVec2],
        size_px: Option<(usize, usize)>,
        with_specks: bool,
        out: &mut FoundLattice,
    ) -> Result<(), LabelError> {
        let none = LabelError::NoLattice { found: detected_px.len() };
        if let Some(index) = detected_px.iter().position(|p| !p.is_finite()) {
            return Err(LabelError::NotFinite { index });
        }
        let far = detected_px.iter().any(|p| p.abs().max_element() > FARTHEST_PX);
        if far || detected_px.len() > MAX_DETECTIONS {
            return Err(none);
        }
        self.place_all(detected_px).ok_or(none.clone())?;
        let (row_step_px, col_step_px, pitch_px) = self.turn_upright(detected_px).ok_or(none.clone())?;
        (out.row_step_px, out.col_step_px, out.pitch_px) = (row_step_px, col_step_px, pitch_px);
        let size_px = size_px.map(|(width, height)| DVec2::new(width as f64, height as f64) - 1.0);
        View { points: detected_px, grid: &self.grid, size_px, pitch_px, with_specks }
            .write(&self.detection_grid, out);
        (out.dropped, out.worst_pitches) = self.best_evidence;
        if out.dropped as f64 > MAX_DROPPED * detected_px.len() as f64 {
            return Err(LabelError::Torn { placed: out.placed, dropped: out.dropped });
        }
        if out.placed < 9 || out.rows.min(out.cols) < 3 { Err(none) } else { Ok(()) }
    }

    /// Grows from successive seeds until one lattice holds most of the detections or the limit is
    /// reached; keeps the largest.
    fn place_all(&mut self, points: &[DVec2]) -> Option<()> {
        let (spread_px, spacing_px) = self.sort_into_grid(points)?;
        self.near_px = neighbour_distance(points, &self.grid, spacing_px, NEAR_SAMPLE, &mut self.distances)?;
        self.longest = (spread_px / (SHORTEST_STEP * self.near_px)) as usize + 1;
        self.best.clear();
        self.best.resize(points.len(), None);
        let (mut most, mut start, mut needed) = (0, 0, Around::All);
        for _ in 0..MAX_SEEDS {
            let mut seed = self.next_seed(points, &mut start, needed);
            if seed.is_none() && most < 9 && needed == Around::All {
                (needed, start) = (Around::Half, 0);
                seed = self.next_seed(points, &mut start, needed);
            }
            let Some(seed) = seed else { break };
            self.detection_grid.start(points.len(), self.longest);
            self.grow(points, &seed);
            self.agreement.prune(points, &self.grid, self.near_px, &mut self.detection_grid);
            let count = placed(&self.detection_grid).count();
            self.best_is_laid = count > most;
            if self.best_is_laid {
                most = count;
                self.best.copy_from_slice(&self.detection_grid.places);
                self.best_evidence = (self.agreement.dropped, self.agreement.worst);
            }
            if 4 * most > 3 * points.len() {
                break;
            }
        }
        (most >= 9).then_some(())
    }

    /// Restores the best places, turned so that rows run most nearly from left to right. Returns the mean
    /// steps and the pitch.
    fn turn_upright(&mut self, points: &[DVec2]) -> Option<(DVec2, DVec2, f64)> {
        if !self.best_is_laid {
            self.put_turned(0);
        }
        let steps = mean_steps(points, &self.detection_grid, &mut self.distances)?;
        let turns = upright_turns(steps.0, steps.1);
        if turns == 0 {
            return Some(steps);
        }
        self.put_turned(turns);
        mean_steps(points, &self.detection_grid, &mut self.distances)
    }

    fn put_turned(&mut self, turns: u8) {
        self.detection_grid.start(self.best.len(), self.longest);
        for (m, place) in self.best.iter().enumerate() {
            if let Some(place) = *place {
                self.detection_grid.put(place.turned(turns), m, [DVec2::ZERO; 2]);
            }
        }
    }

    /// Sorts the detections into the grid. Returns the diagonal of their bounding box and the side of the
    /// square area per detection.
    fn sort_into_grid(&mut self, points: &[DVec2]) -> Option<(f64, f64)> {
        let first = *points.first()?;
        let (low, high) = points.iter().fold((first, first), |(l, h), &p| (l.min(p), h.max(p)));
        let spread = high - low;
        let side = sqrt(spread.x.max(1e-3) * spread.y.max(1e-3) / points.len() as f64);
        self.grid.build(points, side);
        Some((spread.length(), side))
    }

    /// Most regular of the next few seeds; `start` is the position in the list at which to continue.
    fn next_seed(&self, points: &[DVec2], start: &mut usize, needed: Around) -> Option<Seed> {
        // Neighbours in the list are often neighbours in the image, so a stride spreads the sample.
        let len = points.len();
        let stride = (len / SEED_SAMPLE).max(1) | 1;
        let mut best: Option<Seed> = None;
        let mut seen = 0;
        while *start < stride * len.div_ceil(stride) {
            let index = (*start % len.div_ceil(stride)) * stride + *start / len.div_ceil(stride);
            *start += 1;
            if index >= len || self.best[index].is_some() {
                continue;
            }
            seen += 1;
            if let Some(seed) = seed_at(points, &self.grid, index, self.near_px, needed)
                && best.is_none_or(|b| seed.irregularity < b.irregularity)
            {
                best = Some(seed);
            }
            if best.is_some_and(|b| seen >= SEED_SAMPLE || b.irregularity < REGULAR) {
                break;
            }
        }
        best
    }

    /// Grows outwards from the seed, then places the remaining detections.
    fn grow(&mut self, points: &[DVec2], seed: &Seed) {
        let steps = [seed.row_step, seed.col_step];
        self.detection_grid.put(Place::default(), seed.centre, steps);
        let tolerance_px = 0.25 * seed.row_step.length().min(seed.col_step.length());
        // All but the centre, which is placed already; a false detection beside it must not take its
        // place.
        for n in (0..9).filter(|&n| n != 4) {
            let (row, col) = (n / 3 - 1, n % 3 - 1);
            let at = points[seed.centre] + seed.row_step * f64::from(col) + seed.col_step * f64::from(row);
            let marker =
                self.grid.nearest(points, at, tolerance_px, |m| self.detection_grid.places[m].is_none());
            if let Some(m) = marker {
                self.detection_grid.put(Place::new(row, col), m, steps);
            }
        }
        self.around.clear();
        self.left_over.clear();
        self.left_over.extend(0..points.len() as u32);
        let mut walked = 0;
        for (tolerance, sources) in PASSES {
            loop {
                let before = self.detection_grid.order.len();
                walked = self.walk(points, walked, tolerance, sources);
                self.ask_left_over(points, tolerance);
                if self.left_over.is_empty() {
                    return;
                }
                self.find_around_left_over(points);
                if self.detection_grid.order.len() == before {
                    break;
                }
            }
        }
    }

    /// Places detections one step from the markers in `around`, or from those placed since `walked`,
    /// until nothing new is found. Returns the number of placed markers visited.
    fn walk(&mut self, points: &[DVec2], walked: usize, tolerance: f64, sources: u32) -> usize {
        for n in 0..self.around.len() {
            self.step_from(points, self.around[n] as usize, tolerance, sources);
        }
        let mut next = walked;
        while let Some(&from) = self.detection_grid.order.get(next) {
            self.step_from(points, from as usize, tolerance, sources);
            next += 1;
        }
        next
    }

    fn step_from(&mut self, points: &[DVec2], from: usize, tolerance: f64, sources: u32) {
        let Some(place) = self.detection_grid.places[from] else { return };
        let Some(here) = self.detection_grid.cell(place) else { return };
        for step in STEPS {
            if self.detection_grid.at_offset(here, step.0, step.1).is_some() {
                continue;
            }
            let to = place.step(step);
            let Some(cell) = self.detection_grid.cell(to) else { continue };
            let Some(predicted) = predict_at(&self.detection_grid, points, cell) else { continue };
            let length = predicted.at.distance(points[from]);
            let agree = predicted.spread2 < MAX_SPREAD2 * length * length;
            if predicted.sources >= sources && agree {
                self.take(points, from, to, predicted.at, tolerance * length);
            }
        }
    }

    /// Lists the placed markers near unplaced detections; only there can anything new be placed.
    fn find_around_left_over(&mut self, points: &[DVec2]) {
        self.around.clear();
        for &m in &self.left_over {
            self.grid.visit(points[m as usize], AROUND_LEFT_OVER * self.near_px, |n| {
                if self.detection_grid.places[n].is_some() {
                    self.around.push(n as u32);
                }
            });
        }
        self.around.sort_unstable();
        self.around.dedup();
    }

    /// Gives a place to the detection near `at`, if it is the only one and has none yet.
    fn take(&mut self, points: &[DVec2], from: usize, to: Place, at: DVec2, radius_px: f64) {
        let mut nearest = (f64::INFINITY, usize::MAX);
        let mut second2 = f64::INFINITY;
        self.grid.visit(at, radius_px, |m| {
            let key = (points[m].distance_squared(at), m);
            if key < nearest {
                second2 = nearest.0;
                nearest = key;
            } else {
                second2 = second2.min(key.0);
            }
        });
        let (distance2, m) = nearest;
        let alone = second2 > radius_px * radius_px;
        let near = distance2 < radius_px * radius_px && alone;
        if near && self.detection_grid.places[m].is_none() && self.is_like(from, m) {
            let Some(place) = self.detection_grid.places[from] else { return };
            let steps = self.detection_grid.steps_at(points, from, place);
            self.detection_grid.put(to, m, steps);
        }
    }

    /// Whether a detection is not much larger than a neighbour, if areas are known.
    fn is_like(&self, neighbour: usize, m: usize) -> bool {
        let area = |n: usize| self.areas_px2.get(n).copied().map(f64::from);
        area(neighbour).zip(area(m)).is_none_or(|(one, other)| other <= MAX_AREA * one)
    }

    /// Places each remaining detection at the place predicted from the nearest placed one, if it lies
    /// near enough.
    fn ask_left_over(&mut self, points: &[DVec2], tolerance: f64) {
        self.left_over.retain(|&m| self.detection_grid.places[m as usize].is_none());
        for n in 0..self.left_over.len() {
            let m = self.left_over[n] as usize;
            if let Some((from, to, length, at)) = self.place_from_nearest(points, m)
                && points[m].distance(at) < tolerance * length
            {
                self.take(points, from, to, at, tolerance * length);
            }
        }
        self.left_over.retain(|&m| self.detection_grid.places[m as usize].is_none());
    }

    /// Empty place of a detection relative to the nearest placed one. Returns that detection, the place,
    /// the length of a step and the predicted position.
    fn place_from_nearest(&self, points: &[DVec2], m: usize) -> Option<(usize, Place, f64, DVec2)> {
        let from = self
            .grid
            .nearest(points, points[m], 2.5 * self.near_px, |n| self.detection_grid.places[n].is_some())?;
        let place = self.detection_grid.places[from]?;
        let [row_step, col_step] = self.detection_grid.steps_at(points, from, place);
        let area = row_step.perp_dot(col_step);
        let away = points[m] - points[from];
        let (col, row) = (away.perp_dot(col_step) / area, row_step.perp_dot(away) / area);
        if !(row.abs() < 2.5 && col.abs() < 2.5) {
            return None;
        }
        let (row, col) = (round(row), round(col));
        let to = place.step((row as i32, col as i32));
        let at = match predict(&self.detection_grid, points, to) {
            Some(predicted) => predicted.at,
            None => points[from] + row_step * col + col_step * row,
        };
        let length = row_step.length().min(col_step.length());
        self.detection_grid.at(to).is_none().then_some((from, to, length, at))
    }
}
