//! Why an image has no markers to offer.

/// Why an image has no markers to offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectError {
    /// Too small for the smallest marker and a pixel of gel on each side of it.
    TooSmall {
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
        /// Least side, pixels.
        least: usize,
    },
    /// No contrast: no pixel can differ from its surround by the threshold.
    Flat {
        /// Darkest grey level found.
        low: u8,
        /// Brightest grey level found.
        high: u8,
        /// `detect.threshold_levels`, or the least that `detect.threshold = "auto"` goes down to.
        threshold_levels: u8,
    },
    /// More markers, pieces or runs of pixels than any image of markers has.
    TooMany {
        /// How many there are, up to where the search stopped.
        found: usize,
        /// How many there may be.
        most: usize,
    },
}

impl core::fmt::Display for DetectError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::TooSmall { width, height, least } => write!(
                f,
                "the image is {width} x {height} pixels; a marker of detect.min_area_px2 with gel around it needs \
                 {least} x {least}"
            ),
            Self::Flat { low, high, threshold_levels } => {
                write!(
                    f,
                    "all grey levels lie from {low} to {high}, but markers must differ from their surround by \
                     {threshold_levels} or more (detect.threshold)"
                )?;
                if high < threshold_levels {
                    write!(f, ": the image is black, check the light and the exposure")?;
                } else if low > u8::MAX - threshold_levels {
                    write!(f, ": the image is saturated, shorten the exposure")?;
                }
                Ok(())
            }
            Self::TooMany { found, most } => write!(
                f,
                "{found} pieces or more differ from their surround, but an image of this size may have {most}: the image is \
                 noise, or detect.threshold_levels is too low"
            ),
        }
    }
}

impl core::error::Error for DetectError {}
