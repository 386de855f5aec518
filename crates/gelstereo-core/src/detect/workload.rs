//! What an image shows of the work that later ones like it take.

use crate::params::FindAt;

/// What the last whole image showed of the work of later ones, beyond its size and its markers.
///
/// [`Detector::workload`](super::Detector::workload) returns it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Workload {
    /// Image scale at which the markers were found.
    pub found_at: FindAt,
    /// Pixels of the image, counted each time that they were closed around reflections.
    pub closed_px: usize,
    /// Rows in which noise was looked for, counted each time. Where markers are close, few rows have enough
    /// gel, and all are tried.
    pub noise_rows: usize,
    /// Rows whose markers were left out for that, counted for each of those rows.
    pub rows_beside_noise: usize,
    /// Groups of pixels in the window of the usual marker that is fitted; 0 for other rungs.
    pub fit_groups: usize,
    /// Whether every step of a fit sums over these pixels, since the marker is too small for an integral
    /// along its outline.
    pub sums_pixels: bool,
}

impl Workload {
    /// That of an image which takes as much as the larger of two in every respect.
    #[must_use]
    pub fn larger(self, other: Self) -> Self {
        let is_whole = [self, other].iter().any(|one| one.found_at == FindAt::FullSize);
        Self {
            found_at: if is_whole { FindAt::FullSize } else { FindAt::HalfSize },
            closed_px: self.closed_px.max(other.closed_px),
            noise_rows: self.noise_rows.max(other.noise_rows),
            rows_beside_noise: self.rows_beside_noise.max(other.rows_beside_noise),
            fit_groups: self.fit_groups.max(other.fit_groups),
            sums_pixels: self.sums_pixels || other.sums_pixels,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::{Detector, Markers};
    use crate::image::GrayView;
    use crate::math::{DVec2, exp};
    use crate::params::Params;
    use alloc::vec::Vec;

    const SIDE: usize = 192;
    const PITCH_PX: f64 = 16.0;

    /// Smooth dark dots; columns up to `bright` are those of a reflection.
    fn image(radius_px: f64, bright: usize) -> Vec<u8> {
        let level = |x: usize, y: usize| {
            let off = |at: usize| at as f64 % PITCH_PX - 0.5 * PITCH_PX;
            let far_px = DVec2::new(off(x), off(y)).length() - radius_px;
            if x < bright { 255 } else { (170.0 - 120.0 / (1.0 + exp(2.0 * far_px))) as u8 }
        };
        (0..SIDE * SIDE).map(|n| level(n % SIDE, n / SIDE)).collect()
    }

    fn shown(preset: &str, radius_px: f64, bright: usize) -> Workload {
        let mut detector = Detector::new(&Params::preset(preset).unwrap().detect);
        let levels = image(radius_px, bright);
        let view = GrayView::new(&levels, SIDE, SIDE, SIDE).unwrap();
        detector.run(view, &mut Markers::default()).unwrap();
        detector.workload()
    }

    #[test]
    fn reflections_are_closed_and_counted() {
        for preset in ["fast", "balanced", "exact"] {
            assert_eq!(shown(preset, 4.0, 0).closed_px, 0, "{preset}");
            // Around each row of blocks, of 8 rows: itself, its neighbours, and what lies within a square.
            let closed_px = shown(preset, 4.0, 24).closed_px;
            assert!((3 * SIDE * SIDE..12 * SIDE * SIDE).contains(&closed_px), "{preset}: {closed_px}");
        }
    }

    /// A window of radius r has about π r² pixels in groups of 32.
    #[test]
    fn larger_markers_are_fitted_in_more_groups() {
        let groups = [2.0, 4.0, 5.0].map(|radius_px| shown("balanced", radius_px, 0).fit_groups);
        assert!(groups.is_sorted() && groups[0] < groups[2], "{groups:?}");
        assert!((5..=8).contains(&groups[1]), "{groups:?}");
        assert!(!shown("exact", 5.0, 0).sums_pixels && shown("exact", 1.8, 0).sums_pixels);
        assert_eq!(shown("fast", 4.0, 0).fit_groups, 0);
    }

    #[test]
    fn rows_with_too_little_gel_are_looked_at_again() {
        let [wide, narrow] = [3.0, 5.5].map(|radius_px| shown("balanced", radius_px, 0));
        assert!(wide.noise_rows > 0 && narrow.noise_rows >= wide.noise_rows, "{wide:?} {narrow:?}");
        assert!(wide.rows_beside_noise >= 5 * wide.noise_rows);
    }
}
