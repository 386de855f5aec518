//! Tabulated function of the distance, evaluated at whole steps from any position.

use alloc::vec::Vec;

/// Steps of the table per pixel. Linear interpolation is off by at most an eighth of the second
/// derivative times a squared step: 5e-6 for a lens of 0.8 px.
const STEPS: usize = 1 << LOG_STEPS;
const LOG_STEPS: u32 = 7;

/// Adding this to an image coordinate leaves it in whole steps, rounded, in the lowest bits: 1.5 · 2^52
/// / 2^7.
const WHOLE_STEPS: f64 = 52_776_558_133_248.0;

/// Values that are computed at once, for vectorisation.
pub(crate) const BLOCK: usize = 4;

pub(crate) type Block = [f32; BLOCK];

/// Table of the function, from `reach` before a position to `reach` behind it.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    reach: usize,
    /// Values in a row: twice the reach, in whole blocks.
    taps: usize,
    /// `STEPS + 1` rows.
    values: Vec<f32>,
}

/// The function around one position.
#[derive(Clone, Copy, Debug)]
pub(crate) struct About<'a> {
    /// Two rows of `taps` each, followed by the rest of the table.
    rows: &'a [f32],
    taps: usize,
    /// Interpolation weight of the second row.
    share: f32,
}

impl Profile {
    pub(crate) fn new(reach: usize, at: impl Fn(f64) -> f64) -> Self {
        let taps = (2 * reach).next_multiple_of(BLOCK);
        let distances = (0..=STEPS).flat_map(|step| {
            let share = step as f64 / STEPS as f64;
            (0..taps).map(move |k| (k < 2 * reach).then(|| (k + 1) as f64 - reach as f64 - share))
        });
        Self { reach, taps, values: distances.map(|x| x.map_or(0.0, |x| at(x) as f32)).collect() }
    }

    /// Values in a row, including padding of its last block.
    pub(crate) fn taps(&self) -> usize {
        self.taps
    }

    /// Values at whole positions around `x`, which may be whole itself. The first position is `x`
    /// rounded up minus the reach, and is returned too; there are twice the reach of them. `x` is a
    /// position in or near an image.
    #[inline]
    pub(crate) fn about(&self, x: f64) -> (About<'_>, i32) {
        // Subtracting half a step turns rounding into rounding down.
        let shifted = x - 0.5 / STEPS as f64 + WHOLE_STEPS;
        let below = shifted.to_bits() as i32;
        let share = ((x - (shifted - WHOLE_STEPS)) * STEPS as f64) as f32;
        let (whole, step) = (below >> LOG_STEPS, below as usize & (STEPS - 1));
        let rows = &self.values[step * self.taps..];
        (About { rows, taps: self.taps, share }, whole + 1 - self.reach as i32)
    }
}

impl About<'_> {
    /// The values from index `first` on, in whole blocks; the table must have as many.
    #[inline(always)]
    pub(crate) fn blocks<const BLOCKS: usize>(self, first: usize) -> [Block; BLOCKS] {
        let mut values = [Block::default(); BLOCKS];
        let before = &self.rows[first..][..BLOCKS * BLOCK];
        let after = &self.rows[first + self.taps..][..BLOCKS * BLOCK];
        let rows = before.as_chunks::<BLOCK>().0.iter().zip(after.as_chunks::<BLOCK>().0);
        for (values, (before, after)) in values.iter_mut().zip(rows) {
            for (value, (a, b)) in values.iter_mut().zip(before.iter().zip(after)) {
                *value = a + self.share * (b - a);
            }
        }
        values
    }

    /// All values times `scale`; `out` has room for them in whole blocks.
    #[inline]
    pub(crate) fn weigh(self, scale: f32, out: &mut [f32]) {
        let [before, after] = [0, self.taps].map(|start| self.rows[start..].as_chunks::<BLOCK>().0);
        for (out, (before, after)) in out.as_chunks_mut().0.iter_mut().zip(before.iter().zip(after)) {
            let mut weights = *before; // by value: written data is not read again
            for (weight, next) in weights.iter_mut().zip(after) {
                *weight = scale * (*weight + self.share * (next - *weight));
            }
            *out = weights;
        }
    }
}
