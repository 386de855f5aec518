//! Bit mask of one image row.

use crate::image::reaches;
use alloc::vec::Vec;
use core::ops::Range;

/// Bits per word.
const WORD: usize = u64::BITS as usize;

/// Set pixels of a row, 64 per word; no bit is set beyond the row's end.
#[derive(Clone, Debug, Default)]
pub struct BitRow {
    words: Vec<u64>,
    width: usize,
}

impl BitRow {
    /// Starts a row of this width with no pixel set. Does not allocate if an earlier row was as wide.
    pub fn start(&mut self, width: usize) {
        self.width = width;
        self.words.clear();
        self.words.resize(width.div_ceil(WORD), 0);
    }

    /// Sets a range of pixels.
    pub fn set(&mut self, pixels: Range<usize>) {
        if pixels.is_empty() {
            return;
        }
        let (first, last) = (pixels.start / WORD, (pixels.end - 1) / WORD);
        let from = u64::MAX << (pixels.start % WORD);
        let up_to = u64::MAX >> (WORD - 1 - (pixels.end - 1) % WORD);
        if first == last {
            self.words[first] |= from & up_to;
        } else {
            self.words[first] |= from;
            self.words[first + 1..last].fill(u64::MAX);
            self.words[last] |= up_to;
        }
    }

    /// Sets the pixels whose byte is 255 (bytes are 0 or 255).
    pub fn set_where(&mut self, row: &[u8]) {
        let (wholes, rest) = row[..self.width].as_chunks::<8>();
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        for (at, &bytes) in (0..).step_by(8).zip(wholes.iter().chain((!rest.is_empty()).then_some(&last))) {
            self.words[at / WORD] |= u64::from(bits(bytes)) << (at % WORD);
        }
    }

    /// Sets the pixels whose level is at least `level`.
    pub fn set_bright(&mut self, row: &[u8], level: u8) {
        let row = &row[..self.width];
        // Few rows contain such pixels, and few words of those rows.
        if !reaches(row, level) {
            return;
        }
        for (word, pixels) in
            self.words.iter_mut().zip(row.chunks(WORD)).filter(|(_, pixels)| reaches(pixels, level))
        {
            for (bit, &pixel) in pixels.iter().enumerate() {
                *word |= u64::from(pixel >= level) << bit;
            }
        }
    }

    /// Dilates by `by` pixels to both sides.
    pub fn widen(&mut self, by: usize) {
        let mut reached = 0;
        while reached < by {
            // A step of at most one pixel more than reached so far leaves no holes, also at the row's end.
            let step = (reached + 1).min(by - reached).min(WORD - 1);
            let mut before = 0;
            for word in 0..self.words.len() {
                let here = self.words[word];
                let after = self.words.get(word + 1).copied().unwrap_or(0);
                let upwards = here << step | before >> (WORD - step);
                let downwards = here >> step | after << (WORD - step);
                self.words[word] = here | upwards | downwards;
                before = here;
            }
            reached += step;
        }
    }

    /// Ranges of pixels that are not set, from left to right.
    pub fn clear_stretches(&self) -> impl Iterator<Item = Range<usize>> {
        let mut from = 0;
        core::iter::from_fn(move || {
            let start = self.next(from, u64::MAX)?;
            let end = self.next(start, 0).unwrap_or(self.width);
            from = end;
            Some(start..end)
        })
    }

    /// First pixel at or after `from` that is set; with all ones for `flip`, the first that is not set.
    #[inline]
    fn next(&self, from: usize, flip: u64) -> Option<usize> {
        let mut mask = u64::MAX << (from % WORD);
        for (word, &bits) in self.words.iter().enumerate().skip(from / WORD) {
            let found = (bits ^ flip) & mask;
            if found != 0 {
                let at = word * WORD + found.trailing_zeros() as usize;
                return (at < self.width).then_some(at);
            }
            mask = u64::MAX;
        }
        None
    }
}

/// Packs bytes of 0 or 255 into one bit each, the first byte into the lowest bit.
pub(in crate::detect) const fn bits(bytes: [u8; 8]) -> u32 {
    // Byte n keeps its bit n; the highest byte of the product is the sum of all bytes.
    let kept = u64::from_le_bytes(bytes) & 0x8040_2010_0804_0201;
    (kept.wrapping_mul(0x0101_0101_0101_0101) >> 56) as u32
}

#[cfg(test)]
mod tests {
    use super::BitRow;
    use alloc::vec::Vec;
    use core::ops::Range;
    use proptest::prelude::*;

    /// Half of the dilated range lies beyond the row's end.
    #[test]
    fn a_pixel_at_the_end_of_a_row_widens_without_holes() {
        let mut row = BitRow::default();
        row.start(130);
        row.set(0..1);
        row.set(129..130);
        row.widen(6);
        assert!(row.clear_stretches().eq(core::iter::once(7..123)));
    }

    proptest! {
        /// Agrees with a pixel-by-pixel scan for both ways of setting pixels.
        #[test]
        fn stretches_lie_between_set_pixels(
            runs in prop::collection::vec((any::<bool>(), 1..90_usize), 1..9), by in 0..20_usize
        ) {
            let level = |set: bool| if set { u8::MAX } else { 0 };
            let row: Vec<u8> =
                runs.iter().flat_map(|&(set, length)| (0..length).map(move |_| level(set))).collect();
            let mut expected: Vec<Range<usize>> = Vec::new();
            for x in (0..row.len()).filter(|&x| row[x] == 0) {
                match expected.last_mut() {
                    Some(stretch) if stretch.end == x => stretch.end = x + 1,
                    _ => expected.push(x..x + 1),
                }
            }
            let (mut of_bytes, mut of_runs) = (BitRow::default(), BitRow::default());
            of_bytes.start(row.len());
            of_bytes.set_where(&row);
            of_runs.start(row.len());
            let mut x = 0;
            for &(set, length) in &runs {
                of_runs.set(x..if set { x + length } else { x });
                x += length;
            }
            prop_assert_eq!(of_bytes.clear_stretches().collect::<Vec<_>>(), expected.clone());
            prop_assert_eq!(of_runs.clear_stretches().collect::<Vec<_>>(), expected.clone());
            // After dilation, clear ranges are `by` pixels shorter at each end that borders a set pixel.
            of_runs.widen(by);
            let narrower = |stretch: &Range<usize>| {
                let start = if stretch.start == 0 { 0 } else { stretch.start + by };
                let end = if stretch.end == row.len() { row.len() } else { stretch.end.saturating_sub(by) };
                (start < end).then_some(start..end)
            };
            let expected: Vec<Range<usize>> = expected.iter().filter_map(narrower).collect();
            prop_assert_eq!(of_runs.clear_stretches().collect::<Vec<_>>(), expected);
        }
    }
}
