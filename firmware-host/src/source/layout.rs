//! Splits the frames of one stereo device into two views.

use super::{Gray, StereoLayout};
use gelstereo_core::image::GrayView;

/// A frame width that cannot be split into two views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OddWidth {
    /// Width of the frame, pixels.
    pub width: usize,
}

impl std::fmt::Display for OddWidth {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the stereo frame is {} pixels wide; two views of one size need an even width", self.width)
    }
}

impl std::error::Error for OddWidth {}

impl StereoLayout {
    /// Copies both views out of `frame`, each half as wide. The views' buffers are reused.
    ///
    /// # Errors
    /// [`OddWidth`].
    pub fn split(self, frame: GrayView<'_>, left: &mut Gray, right: &mut Gray) -> Result<(), OddWidth> {
        if frame.width() % 2 != 0 {
            return Err(OddWidth { width: frame.width() });
        }
        let (first, second) = match self {
            Self::SideBySide | Self::Interleaved => (left, right),
            Self::SideBySideSwapped | Self::InterleavedSwapped => (right, left),
        };
        let width = frame.width() / 2;
        for view in [&mut *first, &mut *second] {
            (view.width, view.height) = (width, frame.height());
            view.pixels.clear();
            view.pixels.reserve(width * frame.height());
        }
        for row in (0..frame.height()).map(|y| frame.row(y)) {
            match self {
                Self::SideBySide | Self::SideBySideSwapped => {
                    first.pixels.extend_from_slice(&row[..width]);
                    second.pixels.extend_from_slice(&row[width..]);
                }
                Self::Interleaved | Self::InterleavedSwapped => {
                    first.pixels.extend(row.iter().step_by(2));
                    second.pixels.extend(row.iter().skip(1).step_by(2));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_layout_finds_its_views() {
        // Two rows with one byte of padding each.
        let bytes = [1, 2, 3, 4, 99, 5, 6, 7, 8, 99];
        let frame = GrayView::new(&bytes, 4, 2, 5).unwrap();
        let halves = ([1, 2, 5, 6], [3, 4, 7, 8]);
        let bytewise = ([1, 3, 5, 7], [2, 4, 6, 8]);
        let cases = [
            (StereoLayout::SideBySide, halves),
            (StereoLayout::SideBySideSwapped, (halves.1, halves.0)),
            (StereoLayout::Interleaved, bytewise),
            (StereoLayout::InterleavedSwapped, (bytewise.1, bytewise.0)),
        ];
        let mut views = (Gray { width: 9, height: 9, pixels: vec![7; 81] }, Gray::default());
        for (layout, (left, right)) in cases {
            layout.split(frame, &mut views.0, &mut views.1).unwrap();
            let expected = |pixels: [u8; 4]| Gray { width: 2, height: 2, pixels: pixels.to_vec() };
            assert_eq!(views, (expected(left), expected(right)), "{layout:?}");
        }
        let odd = GrayView::new(&bytes, 3, 2, 5).unwrap();
        let refused = StereoLayout::SideBySide.split(odd, &mut views.0, &mut views.1);
        assert_eq!(refused, Err(OddWidth { width: 3 }));
    }
}
