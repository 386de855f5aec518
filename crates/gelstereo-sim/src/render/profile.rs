//! A function of the distance, wanted at whole steps from anywhere.

use alloc::vec::Vec;

/// Steps of the table per pixel. Between them the function is linear: off by at most an eighth of its second derivative
/// and a squared step, 5e-6 for a lens of 0.8 px.
const STEPS: usize = 128;

/// Values that are worked out at once: vectors, with luck.
pub(crate) const BLOCK: usize = 4;

pub(crate) type Block = [f32; BLOCK];

/// A table of it, from so far before a place to as far behind it.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    reach: usize,
    /// `STEPS + 1` rows of twice the reach.
    values: Vec<f32>,
}

/// The function about one place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct About<'a> {
    rows: [&'a [f32]; 2],
    /// Of the second row.
    share: f32,
}

impl Profile {
    pub(crate) fn new(reach: usize, at: impl Fn(f64) -> f64) -> Self {
        let distances = (0..=STEPS).flat_map(|step| {
            let share = step as f64 / STEPS as f64;
            (0..2 * reach).map(move |k| (k + 1) as f64 - reach as f64 - share)
        });
        Self { reach, values: distances.map(|x| at(x) as f32).collect() }
    }

    /// At whole places from `x` on, whole ones included: the first is `x` rounded up and less the reach, which is returned
    /// as well, and there are twice the reach of them.
    #[inline]
    pub(crate) fn about(&self, x: f64) -> (About<'_>, i32) {
        // Rounded downwards; numbers that are no i32 have no place in an image.
        let truncated = x as i32;
        let whole = truncated - i32::from(f64::from(truncated) > x);
        let steps = (x - f64::from(whole)) * STEPS as f64;
        let step = (steps as i32).clamp(0, STEPS as i32 - 1);
        let (taps, share) = (2 * self.reach, (steps - f64::from(step)) as f32);
        let (before, after) = self.values[step as usize * taps..][..2 * taps].split_at(taps);
        (About { rows: [before, after], share }, whole + 1 - self.reach as i32)
    }
}

impl<'a> About<'a> {
    /// The values from the `first` on, in whole blocks; `None` when there are not so many.
    #[inline(always)]
    pub(crate) fn blocks<const BLOCKS: usize>(self, first: usize) -> Option<[Block; BLOCKS]> {
        let [before, after] =
            self.rows.map(|row| row.get(first..)?.as_chunks::<BLOCK>().0.first_chunk::<BLOCKS>());
        let (before, after) = (before?, after?);
        let mut values = *before;
        for (values, (before, after)) in values.iter_mut().zip(before.iter().zip(after)) {
            for (value, (a, b)) in values.iter_mut().zip(before.iter().zip(after)) {
                *value = a + self.share * (b - a);
            }
        }
        Some(values)
    }

    /// All values, times `scale`.
    #[inline]
    pub(crate) fn weigh(self, scale: f32, out: &mut [f32]) {
        let [before, after] = self.rows;
        for (out, (a, b)) in out.iter_mut().zip(before.iter().zip(after)) {
            *out = scale * (a + self.share * (b - a));
        }
    }
}
