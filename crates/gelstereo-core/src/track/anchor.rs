//! By how many whole pitches a lattice has moved, told by its border.

use super::canvas::{Canvas, NONE};
use crate::math::DVec2;
use alloc::vec::Vec;

/// What a marker outside the lattice, or at a place that was never printed, costs against one that is not found.
const STRAY: u32 = 3;

/// Within so many pitches of the image's border a marker may be cut off: neither presence nor absence is expected.
const BORDER_PITCHES: f64 = 0.6;

/// A detection that belongs to no place is seen at one so near, in pitches.
const AT_PLACE: f64 = 0.5;

/// What is known of a marker beforehand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expectation {
    /// Found lately.
    Present,
    /// Hidden for some time.
    Unknown,
    /// Never found: not printed.
    Absent,
}

/// Compares the shifts that a labelled patch can have.
///
/// The inside of a lattice looks the same after a step of a pitch; what differs is its border, and places
/// without a print. A shift costs 1 for each marker that was expected in view and is not there, and [`STRAY`] for each
/// detection where nothing can be, besides what the jump costs. The best is certain when all others cost clearly more.
///
/// Every detection counts, whether it was matched or not: whether it is this marker or another one, or two in one, it is no
/// empty gel. Matches alone would be biased, since a border row in poor sight is matched less easily where it is not expected.
#[derive(Clone, Debug, Default)]
pub(super) struct Anchor {
    taken: Vec<bool>,
    present: Vec<u8>,
    visible: Vec<u8>,
    expected: Vec<u8>,
    unprinted: Vec<u8>,
}

/// Whether a marker at a position is whole in the image.
pub(super) fn in_view(size_px: (usize, usize), pitch_px: f64) -> impl Fn(DVec2) -> bool {
    let border = DVec2::splat(BORDER_PITCHES * pitch_px);
    let far = DVec2::new(size_px.0 as f64 - 1.0, size_px.1 as f64 - 1.0) - border;
    move |p| p.cmpge(border).all() && p.cmple(far).all()
}

/// What a jump costs: up to a row of markers, from a pitch on. A border that disappears at once may have moved on, or be
/// hidden.
fn surprise(canvas: &Canvas, shift: [isize; 2], pitch_px: f64) -> u32 {
    let side = canvas.rows.min(canvas.cols) as f64;
    let middle = canvas.rows / 2 * canvas.cols + canvas.cols / 2;
    let (Some(from), Some(to)) = (canvas.site(middle, [0, 0]), canvas.site(middle, shift)) else { return 0 };
    let moved_px = canvas.position_px(to).distance(canvas.predicted_px[from]);
    (side * (moved_px / pitch_px).min(1.0)) as u32
}

/// The cheapest shift and what the next one costs.
#[derive(Clone, Copy, Debug)]
struct Rank {
    best: u32,
    second: u32,
    shift: [isize; 2],
}

impl Default for Rank {
    fn default() -> Self {
        Self { best: u32::MAX, second: u32::MAX, shift: [0, 0] }
    }
}

impl Rank {
    fn add(&mut self, cost: u32, shift: [isize; 2]) {
        if cost < self.best {
            *self = Self { best: cost, second: self.best, shift };
        } else {
            self.second = self.second.min(cost);
        }
    }
}

/// The answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Anchored {
    /// Marker (row, col) stands at place (row, col) + shift.
    pub shift: [isize; 2],
    /// No other shift comes near.
    pub certain: bool,
}

impl Anchor {
    /// Makes room for a lattice with so many places on its canvas, and for so many detections.
    pub fn reserve(&mut self, markers: usize, sites: usize, detections: usize) {
        self.taken.clear();
        self.taken.reserve(detections);
        for list in [&mut self.present, &mut self.visible] {
            list.clear();
            list.reserve(sites);
        }
        for list in [&mut self.expected, &mut self.unprinted] {
            list.clear();
            list.reserve(markers);
        }
    }

    /// The cheapest shift of at most the canvas's rings along rows and columns.
    pub fn run(
        &mut self,
        canvas: &Canvas,
        detected_px: &[DVec2],
        expectations: impl Iterator<Item = Expectation> + Clone,
        size_px: (usize, usize),
        pitch_px: f64,
    ) -> Anchored {
        let in_view = in_view(size_px, pitch_px);
        let fill = |list: &mut Vec<u8>, values: &mut dyn Iterator<Item = bool>| {
            list.clear();
            list.extend(values.map(u8::from));
        };
        fill(&mut self.present, &mut canvas.found.iter().map(|&m| m != NONE));
        self.add_unmatched(canvas, detected_px, pitch_px);
        fill(
            &mut self.visible,
            &mut (0..canvas.found.len()).map(|s| canvas.located[s] && in_view(canvas.position_px(s))),
        );
        fill(&mut self.expected, &mut expectations.clone().map(|e| e == Expectation::Present));
        fill(&mut self.unprinted, &mut expectations.map(|e| e == Expectation::Absent));
        let most = canvas.rings as isize;
        // With what a jump costs and without: both must give the same answer.
        let mut ranks = [Rank::default(); 2];
        let all = self.present.iter().map(|&p| u32::from(p)).sum();
        for shift in (-most..=most).flat_map(|row| (-most..=most).map(move |col| [row, col])) {
            let cost = self.cost(canvas, shift, all);
            ranks[0].add(cost, shift);
            ranks[1].add(cost + surprise(canvas, shift, pitch_px), shift);
        }
        // Half a border row tells two shifts apart; a few specks do not.
        let margin = (canvas.rows.min(canvas.cols) as u32 / 2).max(6);
        let clear = ranks.iter().all(|rank| rank.second - rank.best >= margin);
        // The best of all tried, at the end of what was tried, may be second to one that was not.
        let inside = ranks[1].shift.iter().all(|along| along.abs() < most);
        let certain =
            clear && inside && ranks[0].shift == ranks[1].shift && self.on_edge(canvas) <= margin / 2;
        Anchored { shift: ranks[1].shift, certain }
    }

    /// Something is present where a detection without a place lies.
    fn add_unmatched(&mut self, canvas: &Canvas, detected_px: &[DVec2], pitch_px: f64) {
        self.taken.clear();
        self.taken.resize(detected_px.len(), false);
        for &m in canvas.found.iter().filter(|&&m| m != NONE) {
            self.taken[m as usize] = true;
        }
        let reach_px = AT_PLACE * pitch_px;
        for (&at, _) in detected_px.iter().zip(&self.taken).filter(|&(_, &taken)| !taken) {
            let mut nearest = (reach_px * reach_px, None);
            for site in (0..canvas.found.len()).filter(|&s| canvas.located[s]) {
                let distance2 = canvas.position_px(site).distance_squared(at);
                if distance2 < nearest.0 {
                    nearest = (distance2, Some(site));
                }
            }
            if let Some(site) = nearest.1 {
                self.present[site] = 1;
            }
        }
    }

    /// Of a shift, among `all` detections of the canvas.
    fn cost(&self, canvas: &Canvas, shift: [isize; 2], all: u32) -> u32 {
        let (rows, cols, width) = (canvas.rows, canvas.cols, canvas.width());
        let (mut missing, mut inside, mut misprinted) = (0, 0, 0);
        for row in 0..rows {
            let first = (row as isize + canvas.rings as isize + shift[0]) as usize * width
                + (canvas.rings as isize + shift[1]) as usize;
            let (present, visible) = (&self.present[first..][..cols], &self.visible[first..][..cols]);
            let (expected, unprinted) =
                (&self.expected[row * cols..][..cols], &self.unprinted[row * cols..][..cols]);
            for ((&p, &v), (&e, &u)) in present.iter().zip(visible).zip(expected.iter().zip(unprinted)) {
                missing += u32::from(e & v & (1 - p));
                misprinted += u32::from(u & p);
                inside += u32::from(p);
            }
        }
        missing + STRAY * (all - inside + misprinted)
    }

    /// Detections on the outermost ring: where there are some, the lattice may go on beyond.
    fn on_edge(&self, canvas: &Canvas) -> u32 {
        let width = canvas.width();
        let line = |line: &[u8]| line.iter().map(|&p| u32::from(p)).sum::<u32>();
        let height = self.present.len() / width;
        self.present.chunks_exact(width).enumerate().fold(0, |sum, (row, places)| {
            sum + if row == 0 || row + 1 == height {
                line(places)
            } else {
                u32::from(places[0]) + u32::from(places[width - 1])
            }
        })
    }
}
