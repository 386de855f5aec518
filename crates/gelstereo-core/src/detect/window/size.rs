//! Window dimensions for markers of one size.

use crate::detect::mask::usual_area::SHARES_OF_AREA;

/// Largest number of rows and columns of a window.
pub const MAX_WINDOW_PX: usize = 32;

/// Width of the blurred edge outside a marker's outline that contributes to its centre.
const EDGE_PX: f64 = 2.5;

/// Room for a marker's offset from its expected position, pixels, both sides together.
const SLACK_PX: f64 = 3.0;

/// Smaller markers stand closer together and get less of both. Weights end where a fifth of the contrast
/// is left ([`BAND`]), within a pixel of the outline.
const SMALL_RADIUS_PX: f64 = 1.8;
const SMALL_EDGE_AND_SLACK_PX: (f64, f64) = (1.25, 2.0);

/// Markers of one size, and the windows around them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerSize {
    /// Rows and columns of a window.
    pub side_px: usize,
    /// Radius of the usual marker.
    pub radius_px: f64,
    /// Least and largest area of a marker.
    pub area_px2: (u32, u32),
}

impl MarkerSize {
    /// Dimensions for markers of a usual area; `None` if they are too large for a window.
    #[must_use]
    pub fn of(usual_area_px2: f64) -> Option<Self> {
        let radius_px = crate::math::sqrt(usual_area_px2.max(0.0) * core::f64::consts::FRAC_1_PI);
        let (edge_px, slack_px) = edge_and_slack_px(radius_px);
        let side_px = crate::math::floor(2.0 * (radius_px + edge_px) + slack_px);
        if !(usual_area_px2 > 0.0 && side_px <= MAX_WINDOW_PX as f64) {
            return None;
        }
        let area = |share: f64| (share * usual_area_px2) as u32;
        let area_px2 = (area(SHARES_OF_AREA.0).max(1), area(SHARES_OF_AREA.1));
        Some(Self { side_px: side_px as usize, radius_px, area_px2 })
    }

    /// Whether a window around one marker ends before the edges of neighbours at this pitch.
    #[must_use]
    pub fn fits(&self, pitch_px: f64) -> bool {
        let (edge_px, _) = edge_and_slack_px(self.radius_px);
        self.side_px as f64 <= 2.0 * (pitch_px - self.radius_px) - edge_px
    }

    /// Whether windows are at most 16 pixels wide.
    pub(in crate::detect) const fn is_small(&self) -> bool {
        self.side_px <= 16
    }

    /// Rows of 16 pixels of a window, in which it is read.
    pub(crate) const fn rows_of_16(&self) -> usize {
        if self.is_small() { self.side_px } else { 2 * self.side_px }
    }

    pub(in crate::detect) fn usual_area_px2(&self) -> f64 {
        core::f64::consts::PI * self.radius_px * self.radius_px
    }

    /// Side of a square that holds at most one marker centre: two would overlap by half.
    pub(in crate::detect) const fn cell_px(&self) -> f64 {
        self.radius_px.max(1.0)
    }

    /// Side of the corner squares where the gel's level is measured.
    pub(super) const fn corner_px(&self) -> usize {
        if self.side_px < 15 { 2 } else { self.side_px / 5 }
    }
}

fn edge_and_slack_px(radius_px: f64) -> (f64, f64) {
    if radius_px < SMALL_RADIUS_PX { SMALL_EDGE_AND_SLACK_PX } else { (EDGE_PX, SLACK_PX) }
}
