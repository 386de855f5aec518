//! Where in the images markers are.

use super::{ParamsError, check};
use crate::rig::View;
use alloc::vec::Vec;

/// The parts of the images in which markers are.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct RoiParams {
    /// First column and row, width and height of the part of the left image; absent: all of it. Valid: sides
    /// of 1 px and more, within the image. Default: absent. Set it where a tray or a mount beside the gel has
    /// spots like markers, and to save time.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub left_px: Option<[usize; 4]>,
    /// The same of the right image. Default: absent. Set it as `left_px`.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub right_px: Option<[usize; 4]>,
    /// Corners (x, y) of a polygon around the gel in the left image. Spots outside it are not markers. The
    /// image is then searched at full size, and `detect.find_at` has no effect. Valid: 3 to 1000 corners
    /// within 100 000 px. Default: absent. Set it for a gel that is not rectangular, with spots in the
    /// background.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Vec::is_empty"))]
    pub left_outline_px: Vec<[f64; 2]>,
    /// The same of the right image. Default: absent. Set it as `left_outline_px`.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Vec::is_empty"))]
    pub right_outline_px: Vec<[f64; 2]>,
}

/// The part of one image in which markers are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Region<'a> {
    /// First column and row, width and height, pixels; `None` for the whole image.
    pub rect_px: Option<[usize; 4]>,
    /// Corners of a polygon in coordinates of the whole image, pixels; empty for no limit.
    pub outline_px: &'a [[f64; 2]],
}

impl RoiParams {
    /// Of one view.
    #[must_use]
    pub fn of(&self, view: View) -> Region<'_> {
        match view {
            View::Left => Region { rect_px: self.left_px, outline_px: &self.left_outline_px },
            View::Right => Region { rect_px: self.right_px, outline_px: &self.right_outline_px },
        }
    }

    pub(super) fn validate(&self) -> Result<(), ParamsError> {
        for (name, rect_px) in [("detect.roi.left_px", self.left_px), ("detect.roi.right_px", self.right_px)]
        {
            let side = rect_px.map_or(1, |[_, _, width, height]| width.min(height));
            check(side > 0, name, side as f64, "a width and a height of 1 px or more")?;
        }
        for (name, corners_px) in [
            ("detect.roi.left_outline_px", &self.left_outline_px),
            ("detect.roi.right_outline_px", &self.right_outline_px),
        ] {
            let count = corners_px.len();
            check(count == 0 || (3..=1000).contains(&count), name, count as f64, "3 to 1000 corners")?;
            for &x in corners_px.iter().flatten() {
                check((-1e5..=1e5).contains(&x), name, x, "corners within 100 000 px")?;
            }
        }
        Ok(())
    }
}
