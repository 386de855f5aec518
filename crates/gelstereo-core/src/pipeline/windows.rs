//! Detection in windows around predicted positions (`detect.search = windows`).

use crate::detect::glance::Kind;
use crate::detect::near::{Found, Sight};
use crate::detect::{DetectError, Detector, Markers};
use crate::image::GrayView;
use crate::math::DVec2;
use crate::track::{MarkerState, Tracks};
use alloc::vec::Vec;

/// Half a window's side: two windows then meet between their markers.
const REACH_PITCHES: f64 = 0.5;

/// One marker in so many may be missing from its window: a smear covers few, a motion that was not expected uncovers many.
const ONE_MISSING_IN: usize = 32;

/// One sentinel in so many may be unclear, by dirt or the gel's edge.
const ONE_UNCLEAR_IN: usize = 4;

/// Windows around the markers, and around sentinels: places one pitch outside the lattice, where nothing should be.
///
/// A lattice that moved by a pitch fills all windows but those along one side. A sentinel on the other side then sees a
/// marker.
#[derive(Clone, Debug, Default)]
pub(super) struct Windows {
    /// Markers row by row, then sentinels.
    places_px: Vec<DVec2>,
    pub found: Found,
    /// What markers look like, if that is enough to search each window by its own light.
    pub kind: Option<Kind>,
    /// The tracks of this frame, which stand only when they are certain.
    pub tracks: Tracks,
}

impl Windows {
    /// Starts from the markers of a rest frame of `lattice` (columns, pitch in pixels), and makes room for later frames.
    pub fn begin(
        &mut self,
        detector: &mut Detector,
        size_px: (usize, usize),
        (cols, pitch_px): (usize, f64),
        (markers, tracks): (&Markers, &Tracks),
    ) {
        self.kind = detector.kind_for_windows(usual_area_px2(markers), pitch_px);
        self.places_px.clear();
        self.places_px.extend_from_slice(&tracks.positions_px);
        add_sentinels(&tracks.positions_px, cols, &mut self.places_px);
        self.tracks.reserve_like(tracks);
        if let Some(kind) = &self.kind {
            detector.reserve_windows(self.places_px.len(), kind, size_px, &mut self.found);
        }
    }

    /// Looks around the predicted positions, row by row; whether what is seen there is as expected. No allocation after the
    /// first frame of a lattice.
    ///
    /// # Errors
    /// [`DetectError`].
    pub fn look(
        &mut self,
        detector: &mut Detector,
        image: GrayView<'_>,
        predicted_px: &[DVec2],
        (cols, pitch_px): (usize, f64),
        tracks: &Tracks,
    ) -> Result<bool, DetectError> {
        self.places_px.clear();
        self.places_px.extend_from_slice(predicted_px);
        add_sentinels(predicted_px, cols, &mut self.places_px);
        let reach_px = REACH_PITCHES * pitch_px;
        match &self.kind {
            Some(kind) => detector.run_windows(image, &self.places_px, (kind, reach_px), &mut self.found),
            None => detector.run_near(image, &self.places_px, reach_px, &mut self.found)?,
        }
        self.tracks.clone_from(tracks);
        Ok(self.is_as_expected(tracks, (image.width(), image.height())))
    }

    fn is_as_expected(&self, tracks: &Tracks, (width, height): (usize, usize)) -> bool {
        let markers = tracks.state.len();
        let (sights, sentinels) = self.found.sights.split_at(markers);
        let missing = sights
            .iter()
            .zip(&tracks.state)
            .filter(|&(sight, &state)| state == MarkerState::Seen && !matches!(sight, Sight::Marker(_)));
        let inside = |p: &DVec2| p.x >= 0.0 && p.y >= 0.0 && p.x < width as f64 && p.y < height as f64;
        let seen = sentinels.iter().zip(&self.places_px[markers..]).filter(|&(_, p)| inside(p));
        let alarm = seen.clone().any(|(sight, _)| matches!(sight, Sight::Marker(_) | Sight::Several));
        let unclear = seen.filter(|&(&sight, _)| sight == Sight::Unclear).count();
        !alarm && ONE_MISSING_IN * missing.count() <= markers && ONE_UNCLEAR_IN * unclear <= sentinels.len()
    }
}

/// Median area; 0 for none.
fn usual_area_px2(markers: &Markers) -> f64 {
    let mut areas: Vec<f64> = markers.area_px2.iter().map(|&area| f64::from(area)).collect();
    crate::math::median(&mut areas).unwrap_or(0.0)
}

/// Adds the places one pitch outside the lattice's four sides, each in line with its two nearest markers.
fn add_sentinels(lattice_px: &[DVec2], cols: usize, out: &mut Vec<DVec2>) {
    let rows = lattice_px.len().checked_div(cols).unwrap_or(0);
    if rows < 2 || cols < 2 {
        return;
    }
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
