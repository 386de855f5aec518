//! Sums over the rows of a window, with its columns in vector lanes: loops of fixed length compile to
//! vector code.

use super::size::MAX_WINDOW_PX;

/// Sums of a window's weights by column and by row: at most 32 values of at most 255.
pub(super) struct Weights<const L: usize> {
    pub columns: [i16; L],
    pub rows: [i16; L],
}

/// Darkest level of the lanes that are on.
#[inline(never)]
pub(super) fn darkest<const L: usize>(rows: &[[u8; L]], on: &[u8; L]) -> u8 {
    let mut darkest = [u8::MAX; L];
    for row in rows {
        darkest = core::array::from_fn(|x| darkest[x].min(row[x]));
    }
    darkest.iter().zip(on).fold(u8::MAX, |low, (&level, &on)| low.min(level | !on))
}

/// Converts levels to weights: how far level plus row offset is below the limit, at most `band`. The
/// offset `added` decreases by `less` per row; both in 1 / 512 level.
#[inline(never)]
pub(super) fn weigh<const L: usize>(
    rows: &mut [[u8; L]],
    limit: &[u8; L],
    mut added: i32,
    less: i32,
    band: u8,
) {
    for row in rows {
        // Opaque to the compiler, which would otherwise vectorise across rows, whose pixels are not adjacent.
        let more = core::hint::black_box((added >> 9) as u8);
        *row = core::array::from_fn(|x| limit[x].saturating_sub(row[x].saturating_add(more)).min(band));
        added -= less;
    }
}

impl<const L: usize> Weights<L> {
    /// Sums for a window of at most `L` rows. Separate from `weigh`: combined, neither is fully vectorised.
    #[inline(never)]
    pub fn of(rows: &[[u8; L]]) -> Self {
        let [mut columns, mut sums] = [[0_i16; L]; 2];
        for (row, total) in rows.iter().zip(&mut sums) {
            columns = core::array::from_fn(|x| columns[x] + i16::from(row[x]));
            *total = row.iter().map(|&w| u32::from(w)).sum::<u32>() as i16;
        }
        Self { columns, rows: sums }
    }
}

#[inline(never)]
pub(super) fn sum_columns<const L: usize>(rows: &[[u8; L]]) -> [i16; L] {
    let mut columns = [0; L];
    for row in rows {
        columns = core::array::from_fn(|x| columns[x] + i16::from(row[x]));
    }
    columns
}

/// Sum of products. The compiler uses the multiply-add instruction for eight of them only if neither list
/// is constant.
#[inline(never)]
pub(super) fn products<const L: usize>(a: &[i16; L], b: &[i16; L]) -> i32 {
    a.iter().zip(b).map(|(&a, &b)| i32::from(a) * i32::from(b)).sum()
}

/// Mean and variance of weights along a line; `per` is one over their sum.
pub(super) fn moments<const L: usize>(line: &[i16; L], per: f64) -> (f64, f64) {
    let first = products(line, &const { powers(1) });
    let second = products(line, &const { powers(2) });
    let mean = f64::from(first) * per;
    (mean, f64::from(second) * per - mean * mean)
}

/// Powers of the lane indices.
const fn powers<const L: usize>(exponent: u32) -> [i16; L] {
    let mut powers = [0; L];
    let mut at = 0;
    while at < L {
        powers[at] = (at as i16).pow(exponent);
        at += 1;
    }
    powers
}

/// Zeros, then all ones from a lane on.
pub(super) fn step_up<const L: usize>(lane: usize) -> [u8; L] {
    const STEP: [u8; 2 * MAX_WINDOW_PX] = {
        let mut step = [0; 2 * MAX_WINDOW_PX];
        let mut at = MAX_WINDOW_PX;
        while at < step.len() {
            step[at] = u8::MAX;
            at += 1;
        }
        step
    };
    *STEP[MAX_WINDOW_PX - lane..].first_chunk::<L>().unwrap_or(&[0; L])
}
