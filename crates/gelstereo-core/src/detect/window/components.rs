//! Connected components of a small window's mask, one row per 64-bit word.

use super::roi::{MAX_ROI_PX, Window};
use crate::detect::mask::bit_rows::bits;
use crate::detect::mask::components::{Blob, Run};
use alloc::vec::Vec;

/// Mask of one window and its components.
#[derive(Clone, Debug, Default)]
pub struct WindowComponents {
    /// One bit per pixel, the first column in the lowest bit.
    rows: Vec<u64>,
    component: Vec<u64>,
    runs: Vec<Run>,
}

impl WindowComponents {
    /// Reserves memory for any window.
    pub fn reserve(&mut self) {
        for rows in [&mut self.rows, &mut self.component] {
            rows.clear();
            rows.reserve(MAX_ROI_PX);
        }
        self.runs.clear();
        self.runs.reserve(MAX_ROI_PX * MAX_ROI_PX / 2);
    }

    /// Starts a window.
    pub fn start(&mut self) {
        self.rows.clear();
    }

    /// Adds the next row: at most [`MAX_ROI_PX`] bytes of 0 or 255.
    pub fn push(&mut self, row: &[u8]) {
        let (words, rest) = row.as_chunks::<8>();
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        let words = words.iter().chain((!rest.is_empty()).then_some(&last));
        let row = (0..).step_by(8).zip(words).fold(0, |all, (at, &word)| all | u64::from(bits(word)) << at);
        self.rows.push(row);
    }

    /// Removes the next 8-connected component from the mask: its sums, and whether it may extend beyond
    /// the window. Its runs are then [`Self::runs`].
    pub fn next(&mut self, window: &Window) -> Option<(Blob, bool)> {
        let seed = self.rows.iter().position(|&bits| bits != 0)?;
        self.flood(seed);
        let last_column = window.end.0 - window.first.0 - 1;
        let sides = 1_u64 | 1 << last_column;
        let last_row = self.rows.len() - 1;
        let partial = self.component.iter().any(|bits| bits & sides != 0)
            || self.component[0] != 0
            || self.component[last_row] != 0;
        self.runs.clear();
        let mut blob = Blob::EMPTY;
        for (y, (row, component)) in (window.first.1 as u16..).zip(self.rows.iter_mut().zip(&self.component))
        {
            *row &= !component;
            let mut rest = *component;
            while rest != 0 {
                let start = rest.trailing_zeros();
                let len = (!(rest >> start)).trailing_zeros();
                let left = window.first.0 as u16 + start as u16;
                let run = Run::alone(y, left, left + len as u16);
                blob.add(&run);
                self.runs.push(run);
                rest = rest.checked_shr(start + len).map_or(0, |high| high << (start + len));
            }
        }
        Some((blob, partial))
    }

    /// Runs of the last component, in raster order.
    #[must_use]
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Fills `piece` with the component of the first pixel of row `seed`, sweeping down and up until
    /// nothing is added.
    fn flood(&mut self, seed: usize) {
        let Self { rows, component, .. } = self;
        component.clear();
        component.resize(rows.len(), 0);
        component[seed] = rows[seed] & rows[seed].wrapping_neg();
        loop {
            let mut end = seed;
            while end < rows.len() {
                grow(rows, component, end, end.checked_sub(1));
                if component[end] == 0 {
                    break;
                }
                end += 1;
            }
            // Every row now includes its connections from above. If none grows from the row below, the
            // component is complete.
            let mut grown = false;
            for y in (seed..end).rev() {
                grown |= grow(rows, component, y, Some(y + 1));
            }
            if !grown {
                break;
            }
        }
    }
}

/// Adds to a row of the component the pixels connected along the row or to row `from`; whether it grew.
fn grow(rows: &[u64], component: &mut [u64], y: usize, from: Option<usize>) -> bool {
    let before = component[y];
    let mut here =
        before | from.and_then(|row| component.get(row)).map_or(0, |&bits| widened(bits) & rows[y]);
    loop {
        let wider = widened(here) & rows[y];
        if wider == here {
            break;
        }
        here = wider;
    }
    component[y] = here;
    here != before
}

const fn widened(bits: u64) -> u64 {
    bits | bits << 1 | bits >> 1
}
