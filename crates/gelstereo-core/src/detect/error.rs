//! Errors of marker detection.

/// Why no markers were detected in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectError {
    /// Too small for the smallest marker with one pixel of gel on each side.
    TooSmall {
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
        /// Least side, pixels.
        min_side_px: usize,
    },
    /// The region of interest reaches beyond the image.
    Region {
        /// First column and row, width and height of `detect.roi`, pixels.
        roi_px: [usize; 4],
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
    },
    /// No contrast: no pixel can differ from its background by the threshold.
    Flat {
        /// Darkest grey level found.
        low: u8,
        /// Brightest grey level found.
        high: u8,
        /// `detect.threshold_levels`, or the least threshold of `detect.threshold = "auto"`.
        threshold_levels: u8,
    },
    /// More markers, components or pixel runs than any image of markers has.
    TooMany {
        /// Number found before the search stopped.
        found: usize,
        /// Largest allowed number.
        max: usize,
    },
}

impl DetectError {
    /// The error of a region of interest that is not within an image of this size (width, height), or `None`.
    pub(crate) fn beyond(roi_px: [usize; 4], (width, height): (usize, usize)) -> Option<Self> {
        let [x, y, columns, rows] = roi_px;
        let fits = |first: usize, count: usize, size: usize| {
            count > 0 && first.checked_add(count).is_some_and(|end| end <= size)
        };
        (!fits(x, columns, width) || !fits(y, rows, height)).then_some(Self::Region { roi_px, width, height })
    }
}

impl core::fmt::Display for DetectError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::TooSmall { width, height, min_side_px } => write!(
                f,
                "the image is {width} x {height} pixels; a marker of detect.min_area_px2 with gel around it \
                 needs {min_side_px} x {min_side_px}"
            ),
            Self::Region { roi_px: [x, y, columns, rows], width, height } => write!(
                f,
                "detect.roi begins at ({x}, {y}) and is {columns} x {rows} pixels, but the image is {width} \
                 x {height}; set it within the image"
            ),
            Self::Flat { low, high, threshold_levels } => {
                write!(
                    f,
                    "all grey levels lie from {low} to {high}, but markers must differ from their background \
                     by {threshold_levels} or more (detect.threshold)"
                )?;
                if high < threshold_levels {
                    write!(f, ": the image is black, check the light and the exposure")?;
                } else if low > u8::MAX - threshold_levels {
                    write!(f, ": the image is saturated, shorten the exposure")?;
                }
                Ok(())
            }
            Self::TooMany { found, max } => write!(
                f,
                "{found} components or more differ from their background, but an image of this size may have \
                 {max}: the image is noise, or detect.threshold_levels is too low"
            ),
        }
    }
}

impl core::error::Error for DetectError {}
