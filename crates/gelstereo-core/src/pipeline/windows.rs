//! Detection in windows around predicted positions (`detect.search = windows`).

use crate::detect::MarkerSize;
use crate::detect::{Detector, Markers};
use crate::detect::{Found, WindowObservation};
use crate::image::GrayView;
use crate::math::DVec2;
use crate::track::{MarkerState, Tracks};
use alloc::vec::Vec;

/// Half a window's side: adjacent windows then meet between their markers.
const REACH_PITCHES: f64 = 0.5;

/// At most one previously seen marker in this many may be missing from its window: a smear covers few,
/// unexpected motion exposes many. Where parts turn or lift within a frame, 8 to 10 of 625 are missing,
/// all in the contact (path-traced); with 32 that was accepted, and F1 of these frames fell from 0.8 to
/// 0.2.
const ONE_MISSING_IN: usize = 200;

/// At most one sentinel of a side in this many may be unclear, from dirt or the gel's edge. With more,
/// such as along a tray's wall, at most one marker in this many of the opposite border may be missing.
const ONE_UNCLEAR_IN: usize = 4;

/// Columns of a view's lattice, and its pitch in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeScale {
    pub cols: usize,
    pub pitch_px: f64,
}

/// Windows around the markers, and around sentinels: places one step outside the lattice, which should
/// be empty. Beyond a row of a hexagonal print, they are places of its next row too: a marker's step from its
/// neighbour of the row inside leads to one.
///
/// A lattice that moved by a pitch fills all windows except those along one side. On the other side, a
/// sentinel then detects a marker, or the surroundings of the gel hide it.
#[derive(Clone, Debug, Default)]
pub(super) struct Windows {
    /// Markers row by row, then sentinels.
    places_px: Vec<DVec2>,
    pub found: Found,
    /// Appearance of the markers, if it suffices to threshold each window locally. Otherwise whole images are
    /// searched.
    marker_size: Option<MarkerSize>,
    /// The tracks of this frame, valid only when they are certain.
    pub tracks: Tracks,
}

impl Windows {
    /// Starts from the markers of a rest frame, and reserves memory for later frames.
    pub fn begin(
        &mut self,
        detector: &mut Detector,
        size_px: (usize, usize),
        lattice: LatticeScale,
        markers: &Markers,
        tracks: &Tracks,
    ) {
        let LatticeScale { cols, pitch_px } = lattice;
        self.marker_size = detector.size_for_windows(usual_area_px2(markers), pitch_px);
        self.places_px.clear();
        self.places_px.extend_from_slice(&tracks.positions_px);
        add_sentinels(&tracks.positions_px, cols, &mut self.places_px);
        self.tracks.reserve_like(tracks);
        if let Some(marker_size) = &self.marker_size {
            detector.reserve_windows(self.places_px.len(), marker_size, size_px, &mut self.found);
        }
    }

    /// Whether these markers suit windows, and memory is reserved.
    pub const fn are_ready(&self) -> bool {
        self.marker_size.is_some()
    }

    /// Searches around the predicted positions, row by row; returns whether the observations are as
    /// expected. Never so if these markers do not suit windows.
    pub fn look(
        &mut self,
        detector: &mut Detector,
        image: GrayView<'_>,
        predicted_px: &[DVec2],
        lattice: LatticeScale,
        tracks: &Tracks,
    ) -> bool {
        let Some(marker_size) = &self.marker_size else { return false };
        let LatticeScale { cols, pitch_px } = lattice;
        self.places_px.clear();
        self.places_px.extend_from_slice(predicted_px);
        add_sentinels(predicted_px, cols, &mut self.places_px);
        let reach_px = REACH_PITCHES * pitch_px;
        detector.run_windows(image, &self.places_px, reach_px, marker_size, &mut self.found);
        self.tracks.clone_from(tracks);
        self.is_as_expected(tracks, cols, reach_px, (image.width(), image.height()))
    }

    fn is_as_expected(
        &self,
        tracks: &Tracks,
        cols: usize,
        reach_px: f64,
        (width, height): (usize, usize),
    ) -> bool {
        let markers = tracks.state.len();
        let (sights, sentinels) = self.found.sights.split_at(markers);
        let is_missing = |k: usize| !matches!(sights[k], WindowObservation::Marker(_));
        let is_inside = |k: usize, by_px: f64| {
            let (p, end) = (self.places_px[k], DVec2::new(width as f64, height as f64) - by_px);
            p.x >= by_px && p.y >= by_px && p.x < end.x && p.y < end.y
        };
        // Markers may leave the view.
        let is_news = |k: &usize| tracks.state[*k] == MarkerState::Seen && is_inside(*k, reach_px);
        let missing = (0..markers).filter(is_news).filter(|&k| is_missing(k)).count();
        let seen = |k: usize| is_inside(markers + k, 0.0).then_some(sentinels[k]);
        let alarm = (0..sentinels.len())
            .any(|k| matches!(seen(k), Some(WindowObservation::Marker(_) | WindowObservation::Several)));
        let is_told = || {
            sides(markers, cols).into_iter().flatten().all(|side| {
                let unclear =
                    side.sentinels().filter(|&k| seen(k) == Some(WindowObservation::Unclear)).count();
                ONE_UNCLEAR_IN * unclear <= side.count
                    || ONE_UNCLEAR_IN * side.opposite().filter(|&k| is_missing(k)).count() <= side.count
            })
        };
        !alarm && ONE_MISSING_IN * missing <= markers && is_told()
    }
}

/// Sentinels along one side of the lattice, and the markers of the opposite border.
#[derive(Clone, Copy, Debug)]
struct Side {
    count: usize,
    first_sentinel: usize,
    first_opposite: usize,
    /// From one marker of a border to the next.
    stride: usize,
}

impl Side {
    fn sentinels(&self) -> impl Iterator<Item = usize> {
        (self.first_sentinel..).step_by(2).take(self.count)
    }

    fn opposite(&self) -> impl Iterator<Item = usize> {
        (self.first_opposite..).step_by(self.stride).take(self.count)
    }
}

/// First and last row, first and last column, in the order of [`add_sentinels`]; `None` for a single row
/// or column.
fn sides(markers: usize, cols: usize) -> Option<[Side; 4]> {
    let rows = lattice_rows(markers, cols)?;
    let side = |count, first_sentinel, first_opposite, stride| Side {
        count,
        first_sentinel,
        first_opposite,
        stride,
    };
    Some([
        side(cols, 0, (rows - 1) * cols, 1),
        side(cols, 1, 0, 1),
        side(rows, 2 * cols, cols - 1, cols),
        side(rows, 2 * cols + 1, 0, cols),
    ])
}

/// Rows of a lattice that has sentinels.
fn lattice_rows(markers: usize, cols: usize) -> Option<usize> {
    let rows = markers.checked_div(cols)?;
    (rows >= 2 && cols >= 2).then_some(rows)
}

/// Median area; 0 for none.
fn usual_area_px2(markers: &Markers) -> f64 {
    let mut areas: Vec<f64> = markers.area_px2.iter().map(|&area| f64::from(area)).collect();
    crate::math::median(&mut areas).unwrap_or(0.0)
}

/// Adds the places one pitch outside the lattice's four sides, extrapolated from the two nearest markers.
fn add_sentinels(lattice_px: &[DVec2], cols: usize, out: &mut Vec<DVec2>) {
    let Some(rows) = lattice_rows(lattice_px.len(), cols) else { return };
    let at = |row: usize, col: usize| lattice_px[row * cols + col];
    let beyond = |border: DVec2, inner: DVec2| border + (border - inner);
    for col in 0..cols {
        out.push(beyond(at(0, col), at(1, col)));
        out.push(beyond(at(rows - 1, col), at(rows - 2, col)));
    }
    for row in 0..rows {
        out.push(beyond(at(row, 0), at(row, 1)));
        out.push(beyond(at(row, cols - 1), at(row, cols - 2)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    const COLS: usize = 205;
    const ROWS: usize = 36;

    /// Window observations of a lattice that has moved by `moved_cols` columns: gel in its former place,
    /// and gel or a wall beside it.
    fn seen(moved_cols: usize, is_walled: bool) -> (Windows, Tracks) {
        let lattice_px: Vec<DVec2> = (0..ROWS * COLS)
            .map(|k| DVec2::new(20.0 + 3.0 * (k % COLS) as f64, 20.0 + 3.0 * (k / COLS) as f64))
            .collect();
        let mut windows = Windows { places_px: lattice_px.clone(), ..Windows::default() };
        add_sentinels(&lattice_px, COLS, &mut windows.places_px);
        let col = |p: &DVec2| crate::math::round((p.x - 20.0) / 3.0) as i32;
        let row = |p: &DVec2| crate::math::round((p.y - 20.0) / 3.0) as i32;
        windows.found.sights = windows
            .places_px
            .iter()
            .map(|p| {
                let (col, row) = (col(p) - moved_cols as i32, row(p));
                let is_beside = !(0..COLS as i32).contains(&(col + moved_cols as i32))
                    || !(0..ROWS as i32).contains(&row);
                match (0..COLS as i32).contains(&col) && (0..ROWS as i32).contains(&row) {
                    _ if is_walled && is_beside => WindowObservation::Unclear,
                    true => WindowObservation::Marker(0),
                    false => WindowObservation::Nothing,
                }
            })
            .collect();
        let mut tracks = Tracks::default();
        tracks.state = vec![MarkerState::Seen; ROWS * COLS];
        (windows, tracks)
    }

    /// The 36 markers of a border are a small share of 7380.
    #[test]
    fn a_lattice_that_moved_by_a_pitch_is_told_from_one_beside_a_wall() {
        for is_walled in [false, true] {
            for (moved_cols, expected) in [(0, true), (1, false), (2, false)] {
                let (windows, tracks) = seen(moved_cols, is_walled);
                assert_eq!(
                    windows.is_as_expected(&tracks, COLS, 1.5, (640, 480)),
                    expected,
                    "{moved_cols} {is_walled}"
                );
            }
        }
    }

    /// Markers that leave the view do not count as missing; as many inside it do.
    #[test]
    fn markers_may_leave_the_view() {
        for (y_px, expected) in [(479.5, true), (470.0, false)] {
            let (mut windows, tracks) = seen(0, false);
            for col in 0..COLS {
                let k = (ROWS - 1) * COLS + col;
                windows.places_px[k].y = y_px;
                windows.found.sights[k] = WindowObservation::Nothing;
            }
            assert_eq!(windows.is_as_expected(&tracks, COLS, 1.5, (640, 480)), expected, "{y_px}");
        }
    }
}
