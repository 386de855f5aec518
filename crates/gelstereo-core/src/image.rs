//! Borrowed 8-bit grey images.

/// A borrowed grey image: `height` rows of `width` bytes, `stride` bytes apart.
///
/// A view of the left half of a side-by-side frame is the same buffer with the whole frame's stride.
#[derive(Clone, Copy, Debug)]
pub struct GrayView<'a> {
    data: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
}

/// Largest width and height of an image; both fit 16 bits.
pub const MAX_SIDE_PX: usize = u16::MAX as usize;

/// Why a buffer is not an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageError {
    /// Width or height is zero.
    Empty {
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
    },
    /// More columns or rows than any camera has.
    TooLarge {
        /// Width found, pixels.
        width: usize,
        /// Height found, pixels.
        height: usize,
    },
    /// Rows would overlap.
    StrideTooSmall {
        /// Width, pixels.
        width: usize,
        /// Stride found, bytes.
        stride: usize,
    },
    /// The buffer ends before the last row ends.
    BufferTooShort {
        /// Bytes that the shape needs.
        needed: usize,
        /// Bytes found.
        found: usize,
    },
    /// A part extends beyond the image.
    Outside {
        /// One past the part's last column.
        right: usize,
        /// One past the part's last row.
        bottom: usize,
        /// Width of the image, pixels.
        width: usize,
        /// Height of the image, pixels.
        height: usize,
    },
}

impl core::fmt::Display for ImageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Empty { width, height } => {
                write!(f, "the image is {width} x {height} pixels; both sides must be at least 1")
            }
            Self::TooLarge { width, height } => {
                write!(f, "the image is {width} x {height} pixels; valid is up to {MAX_SIDE_PX} on each side")
            }
            Self::StrideTooSmall { width, stride } => {
                write!(f, "the stride is {stride} bytes for rows of {width}; it must be at least the width")
            }
            Self::BufferTooShort { needed, found } => {
                write!(f, "the buffer holds {found} bytes, but the shape and stride need {needed}")
            }
            Self::Outside { right, bottom, width, height } => write!(
                f,
                "the part ends at column {right}, row {bottom}; the image has {width} columns and {height} \
                rows"
            ),
        }
    }
}

impl core::error::Error for ImageError {}

impl<'a> GrayView<'a> {
    /// A view of rows that are `stride` bytes apart.
    ///
    /// # Errors
    /// [`ImageError`] when the shape is empty, larger than [`MAX_SIDE_PX`] on a side, or does not fit the
    /// buffer.
    pub fn new(data: &'a [u8], width: usize, height: usize, stride: usize) -> Result<Self, ImageError> {
        if width == 0 || height == 0 {
            return Err(ImageError::Empty { width, height });
        }
        if width.max(height) > MAX_SIDE_PX {
            return Err(ImageError::TooLarge { width, height });
        }
        if stride < width {
            return Err(ImageError::StrideTooSmall { width, stride });
        }
        let needed = stride.saturating_mul(height - 1).saturating_add(width);
        if data.len() < needed {
            return Err(ImageError::BufferTooShort { needed, found: data.len() });
        }
        Ok(Self { data, width, height, stride })
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// The bytes of row `y`, which must be below [`Self::height`].
    #[must_use]
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride..y * self.stride + self.width]
    }

    /// Copies `L` bytes per row, from column `x`, of rows `y` onwards into `rows`. Does nothing unless
    /// all lie within the image.
    pub(crate) fn copy_lanes<const L: usize>(&self, (x, y): (usize, usize), rows: &mut [[u8; L]]) {
        let inside = x + L <= self.width && y + rows.len() <= self.height;
        if !inside {
            return;
        }
        // `chunks` of the stride would compute their number first, with a division.
        let mut first = y * self.stride + x;
        for row in rows {
            let Some(levels) = self.data.get(first..).and_then(<[u8]>::first_chunk) else { return };
            *row = *levels;
            first += self.stride;
        }
    }

    /// The part of `width` x `height` pixels whose first pixel is (`x`, `y`), without copying.
    ///
    /// # Errors
    /// [`ImageError`] when the part is empty or reaches beyond the image.
    pub fn crop(&self, x: usize, y: usize, width: usize, height: usize) -> Result<Self, ImageError> {
        if width == 0 || height == 0 {
            return Err(ImageError::Empty { width, height });
        }
        let (right, bottom) = (x.saturating_add(width), y.saturating_add(height));
        if right > self.width || bottom > self.height {
            return Err(ImageError::Outside { right, bottom, width: self.width, height: self.height });
        }
        Self::new(&self.data[y * self.stride + x..], width, height, self.stride)
    }

    /// Whether the brightest value is at least `levels` above the darkest. For most images a few rows
    /// suffice.
    pub(crate) fn spans(&self, levels: u8) -> bool {
        let (mut low, mut high) = (u8::MAX, 0);
        (0..self.height).map(|y| self.row(y)).any(|row| {
            low = row.iter().fold(low, |low, &v| low.min(v));
            high = row.iter().fold(high, |high, &v| high.max(v));
            high - low >= levels
        })
    }

    /// Whether any pixel is at least this bright.
    pub(crate) fn reaches(&self, level: u8) -> bool {
        (0..self.height).any(|y| reaches(self.row(y), level))
    }

    /// The darkest and brightest value.
    #[must_use]
    pub fn range(&self) -> (u8, u8) {
        // The compiler vectorises one fold per row and per extreme.
        (0..self.height).map(|y| self.row(y)).fold((u8::MAX, 0), |(low, high), row| {
            (row.iter().fold(low, |low, &v| low.min(v)), row.iter().fold(high, |high, &v| high.max(v)))
        })
    }
}
/// Whether any of these pixels is at least this bright. The compiler vectorises a fold.
pub(crate) fn reaches(pixels: &[u8], level: u8) -> bool {
    pixels.iter().fold(0, |high: u8, &pixel| high.max(pixel)) >= level
}
